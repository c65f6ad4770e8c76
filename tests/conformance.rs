//! What every planner must do: unit length, z ≥ 0, T distinct lights, the same for the same
//! seed, and defined behaviour on black and saturated frames, a one-pixel mask and too few candidates.

use coil_ps::camera::{Camera, CameraError, Domain, Observation};
use coil_ps::light::{self, fibonacci_cap};
use coil_ps::planner::{self, Choice, Learned, PLANNERS, PlanError, Setup};
use coil_ps::session::{Session, SessionError, Step};
use coil_ps::stack::Mask;
use glam::Vec3;
use std::f32::consts::FRAC_PI_2;

/// The learned planners with a network that was never trained: what is tested here holds for any weights.
#[cfg(feature = "train")]
fn learned() -> Option<&'static dyn Learned> {
    use coil_ps::planner::coil::Policies;
    use coil_ps::policy::{Config, Policy};
    use coil_ps::train::{export::export, weights::Weights};
    static MODELS: std::sync::OnceLock<Policies> = std::sync::OnceLock::new();
    Some(MODELS.get_or_init(|| {
        let files = export(&Weights::new(&Config::compact(), 1), "untrained");
        let policy = Policy::load(&files).expect("what the exporter writes can be loaded");
        let mut policies = Policies::default();
        for info in PLANNERS.iter().filter(|info| info.name.starts_with("coil")) {
            policies.insert(info.name, policy.clone());
        }
        policies
    }))
}

#[cfg(not(feature = "train"))]
fn learned() -> Option<&'static dyn Learned> {
    None
}

/// A cap of a sphere whose pictures are computed, or constant.
struct Cap {
    mask: Mask,
    normals: Vec<Vec3>,
    constant: Option<f32>,
}

impl Cap {
    fn new(side: u32, constant: Option<f32>) -> Self {
        let mask = Mask::full(side, side).unwrap();
        let normals = fibonacci_cap(mask.len(), 1.2);
        Self { mask, normals, constant }
    }
}

impl Camera for Cap {
    fn mask(&self) -> &Mask {
        &self.mask
    }

    fn capture(&self, direction: Vec3, _: &[Observation]) -> Result<Observation, CameraError> {
        let shade = |n: &Vec3| self.constant.unwrap_or_else(|| n.dot(direction).max(0.0));
        let grey: Vec<f32> = self.normals.iter().map(shade).collect();
        let rgb = grey.iter().map(|&v| [v; 3]).collect();
        Ok(Observation::new(direction, direction, grey, rgb))
    }
}

fn directions(
    cap: &Cap,
    name: &str,
    domain: &Domain,
    lights: usize,
    draw: usize,
) -> Result<Vec<Vec3>, SessionError> {
    let setup =
        Setup { lights, seed: 7, draw, camera: Some(cap), truth: Some(&cap.normals), learned: learned() };
    let planner = planner::build(name, &setup)?;
    let mut session = Session::new(cap.mask.clone(), domain.clone(), planner, lights);
    while let Step::Capture(direction) = session.step()? {
        let picture = cap.capture(direction, session.seen())?;
        session.observe(picture)?;
    }
    Ok(session.seen().iter().map(|o| o.requested).collect())
}

/// Planner names and the light counts they are defined for.
fn cases() -> impl Iterator<Item = (&'static str, usize)> {
    let names = PLANNERS.iter().map(|p| p.name).chain(["ring:40"]);
    names.flat_map(|name| [3, 5, 10, 20].map(|t| (name, t))).filter(|&(name, t)| match name {
        "dc05v" => t >= 4,
        "lipids" => t <= 10,
        name if name.starts_with("coil") => learned().is_some(),
        "oraclec" => t <= 5, // slow, and the same code at every count
        _ => true,
    })
}

fn domains() -> [(&'static str, Domain); 3] {
    [
        ("candidates", Domain::Candidates(fibonacci_cap(60, 0.75))),
        ("cone", Domain::Hemisphere { reach: 0.75 }),
        ("hemisphere", Domain::Hemisphere { reach: FRAC_PI_2 }),
    ]
}

fn check(cap: &Cap, what: &str) {
    for (name, lights) in cases() {
        for (place, domain) in domains() {
            for draw in [0, 1] {
                let label = format!("{name}, {lights} lights, {place}, draw {draw}, {what}");
                let got =
                    directions(cap, name, &domain, lights, draw).unwrap_or_else(|e| panic!("{label}: {e}"));
                assert_eq!(got.len(), lights, "{label}");
                for (i, d) in got.iter().enumerate() {
                    assert!((d.length() - 1.0).abs() < 1e-5 && d.z >= 0.0, "{label}: {d}");
                    assert!(light::slant(*d) <= domain.reach() + 1e-4, "{label}: {d} beyond the reach");
                    assert!(!got[..i].contains(d), "{label}: {d} twice");
                    if let Some(candidates) = domain.candidates() {
                        assert!(candidates.contains(d), "{label}: {d} is no candidate");
                    }
                }
                let again = directions(cap, name, &domain, lights, draw).unwrap();
                assert_eq!(got, again, "{label}: not deterministic");
            }
        }
    }
}

#[test]
fn all_lights_are_within_a_narrow_reach_in_every_draw() {
    let cap = Cap::new(12, None);
    let domain = Domain::Hemisphere { reach: 0.07 };
    for (name, lights) in cases().filter(|&(name, lights)| lights == 5 && !name.starts_with("oracle")) {
        for draw in 0..4 {
            for d in directions(&cap, name, &domain, lights, draw).unwrap() {
                assert!(light::slant(d) <= domain.reach() + 1e-4, "{name}, draw {draw}: {d}");
            }
        }
    }
}

#[test]
fn on_an_ordinary_object() {
    check(&Cap::new(12, None), "sphere cap");
}

#[test]
fn on_black_frames() {
    check(&Cap::new(3, Some(0.0)), "black");
}

#[test]
fn on_saturated_frames() {
    check(&Cap::new(3, Some(1.0)), "saturated");
}

#[test]
fn on_a_one_pixel_mask() {
    check(&Cap::new(1, None), "one pixel");
}

#[test]
fn fewer_candidates_than_lights_is_a_clear_error() {
    let cap = Cap::new(3, None);
    let few = Domain::Candidates(fibonacci_cap(8, 0.75));
    for (name, lights) in cases().filter(|&(_, t)| t == 10) {
        let error = directions(&cap, name, &few, lights, 0).unwrap_err();
        assert!(
            matches!(error, SessionError::Plan(PlanError::TooFewCandidates { candidates: 8, lights: 10 })),
            "{name}: {error}"
        );
    }
}

#[test]
fn a_direction_photographed_twice_is_two_candidates() {
    let cap = Cap::new(3, None);
    let mut lights = fibonacci_cap(6, 0.75);
    lights.extend_from_within(..4);
    let domain = Domain::Candidates(lights.clone());
    for (name, count) in cases().filter(|&(_, t)| t == 10) {
        let chosen = directions(&cap, name, &domain, count, 0).unwrap_or_else(|e| panic!("{name}: {e}"));
        let times = |list: &[Vec3], d: Vec3| list.iter().filter(|c| **c == d).count();
        assert!(lights.iter().all(|&d| times(&chosen, d) == times(&lights, d)), "{name}: {chosen:?}");
    }
}

#[test]
fn draws_differ_where_the_planner_has_any_freedom() {
    let cap = Cap::new(6, None);
    let domain = Domain::Hemisphere { reach: FRAC_PI_2 };
    for (name, lights) in cases().filter(|&(_, t)| t == 5) {
        let a = directions(&cap, name, &domain, lights, 0).unwrap();
        let b = directions(&cap, name, &domain, lights, 1).unwrap();
        assert_ne!(a, b, "{name}");
    }
}

#[test]
fn an_oracle_without_truth_says_what_it_needs() {
    let setup = Setup { lights: 10, seed: 1, draw: 0, camera: None, truth: None, learned: None };
    for planner in PLANNERS {
        match planner::build(planner.name, &setup) {
            Ok(_) => assert!(!planner.oracle, "{}", planner.name),
            Err(e) => assert!(
                (planner.oracle || planner.name.starts_with("coil")) && e.to_string().contains("needs"),
                "{}: {e}",
                planner.name
            ),
        }
    }
    let error = planner::build("best", &setup).map(|_| ()).unwrap_err().to_string();
    assert!(PLANNERS.iter().all(|p| error.contains(p.name)), "{error}");
    assert!(PLANNERS.iter().any(|p| p.choice == Choice::Continuous));
}
