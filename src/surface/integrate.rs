//! Depth from normals: bilateral normal integration (Cao, Santo, Shi, Okura & Matsushita, ECCV 2022),
//! orthographic.
//!
//! At each pixel the slope to the right and the slope to the left each should be −n_x/n_z; which of the two is
//! believed is decided by the depths themselves, so the surface may break on one side of a pixel
//! without being bent: `min Σ w_r (n_z ∂_r z + n_x)² + (1−w_r)(n_z ∂_l z + n_x)²` and alike for up and down, with
//! `w_r = σ(k((n_z ∂_l z)² − (n_z ∂_r z)²))`, reweighted until the energy settles. Both rows of an edge between two
//! pixels act on the same difference, so each round is a weighted Laplace equation over the mask, solved by
//! conjugate gradients that start from the last round.

use crate::stack::Mask;
use glam::Vec3;

/// How depth is integrated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Integration {
    /// Stiffness k: how sharply one side is preferred (the paper's 2).
    pub stiffness: f64,
    /// Most rounds of reweighting.
    pub rounds: usize,
    /// Relative change of the energy at which it has settled.
    pub tolerance: f64,
    /// Most steps of conjugate gradients in a round.
    pub steps: usize,
}

impl Default for Integration {
    fn default() -> Self {
        Self { stiffness: 2.0, rounds: 60, tolerance: 1e-4, steps: 2000 }
    }
}

/// Depth of the mask pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Depth {
    /// Height towards the camera in pixels; mean 0 over each connected part of the mask.
    pub heights: Vec<f32>,
    /// Rounds of reweighting that were needed.
    pub rounds: usize,
}

/// Why normals can't be integrated.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum IntegrationError {
    /// Another number of normals than pixels.
    #[error("{normals} normals for a mask of {pixels} pixels: there must be one for each")]
    Count {
        /// Number of normals.
        normals: usize,
        /// Number of pixels.
        pixels: usize,
    },
    /// A normal is NaN or infinite.
    #[error("the normal of mask pixel {0} is not finite")]
    NotFinite(usize),
}

/// Slopes steeper than this are not trusted: a normal (nearly) across the view says nothing of depth.
const LEAST_Z: f64 = 0.02;

/// Two neighbouring pixels; the height of `to` minus that of `from` is what both ends make a demand on.
struct Edge {
    from: usize,
    to: usize,
    /// Demands of the two ends: `(n_z, −n_t)` with n_t the normal's component along the edge.
    demands: [(f64, f64); 2],
    /// The edge on the other side of each end, if there is one.
    opposite: [Option<usize>; 2],
    /// Weights w of the demands.
    weights: [f64; 2],
    /// `Σ w n_z²` and `Σ w n_z (−n_t)`.
    stiffness: f64,
    flux: f64,
}

/// Integrates unit normals (x right, y up, z to the camera) over the mask.
///
/// `cancelled` is asked after every round; where it says yes, the depth so far is returned.
///
/// # Errors
/// [`IntegrationError`].
pub fn integrate(
    mask: &Mask,
    normals: &[Vec3],
    options: &Integration,
    mut cancelled: impl FnMut() -> bool,
) -> Result<Depth, IntegrationError> {
    let pixels = mask.len();
    if normals.len() != pixels {
        return Err(IntegrationError::Count { normals: normals.len(), pixels });
    }
    if let Some(p) = normals.iter().position(|n| !n.is_finite()) {
        return Err(IntegrationError::NotFinite(p));
    }
    let mut edges = edges(mask, normals);
    let mut heights = vec![0.0f64; pixels];
    let mut energy = f64::INFINITY;
    let mut rounds = 0;
    for round in 0..options.rounds.max(1) {
        weigh(&mut edges, &heights, if round == 0 { 0.0 } else { options.stiffness });
        relax(&edges, &mut heights, options.steps);
        let now = total_energy(&edges, &heights);
        rounds = round + 1;
        let settled = round > 0 && (energy - now).abs() <= options.tolerance * energy;
        if settled || cancelled() {
            break;
        }
        energy = now;
    }
    centre(&edges, &mut heights);
    Ok(Depth { heights: heights.into_iter().map(|h| h as f32).collect(), rounds })
}

/// All pairs of neighbours, those along x first.
fn edges(mask: &Mask, normals: &[Vec3]) -> Vec<Edge> {
    let width = mask.width() as usize;
    let numbers: Vec<u32> = (0..mask.len() as u32).collect();
    let number = mask.scatter(&numbers, u32::MAX);
    let at = |i: usize| (number[i] != u32::MAX).then(|| number[i] as usize);
    let mut edges = Vec::with_capacity(2 * mask.len());
    for along_x in [true, false] {
        // The edge that arrives at and the one that leaves each pixel in this direction.
        let mut arriving: Vec<Option<usize>> = vec![None; mask.len()];
        let mut leaving = arriving.clone();
        let first = edges.len();
        for (p, &i) in mask.indices().iter().enumerate() {
            let i = i as usize;
            let neighbour = if along_x {
                if (i + 1).is_multiple_of(width) { None } else { at(i + 1) }
            } else {
                i.checked_sub(width).and_then(at) // the row above: y is up
            };
            let Some(q) = neighbour else { continue };
            let demand = |n: Vec3| {
                let along = f64::from(if along_x { n.x } else { n.y });
                (f64::from(n.z).max(LEAST_Z), -along)
            };
            leaving[p] = Some(edges.len());
            arriving[q] = Some(edges.len());
            edges.push(Edge {
                from: p,
                to: q,
                demands: [demand(normals[p]), demand(normals[q])],
                opposite: [None; 2],
                weights: [0.0; 2],
                stiffness: 0.0,
                flux: 0.0,
            });
        }
        for edge in &mut edges[first..] {
            edge.opposite = [arriving[edge.from], leaving[edge.to]];
        }
    }
    edges
}

/// The weights for the heights as they are.
fn weigh(edges: &mut [Edge], heights: &[f64], stiffness: f64) {
    let differences: Vec<f64> = edges.iter().map(|e| heights[e.to] - heights[e.from]).collect();
    for (edge, &difference) in edges.iter_mut().zip(&differences) {
        (edge.stiffness, edge.flux) = (0.0, 0.0);
        for (end, (nz, demand)) in edge.demands.into_iter().enumerate() {
            let weight = match edge.opposite[end] {
                Some(o) => {
                    let other = nz * differences[o];
                    let own = nz * difference;
                    1.0 / (1.0 + libm::exp((stiffness * (own * own - other * other)).clamp(-60.0, 60.0)))
                }
                None => 1.0, // nothing on the other side to choose
            };
            edge.weights[end] = weight;
            edge.stiffness += weight * nz * nz;
            edge.flux += weight * nz * demand;
        }
        // No pixel may fall off the sheet, however sure the weights are.
        edge.stiffness = edge.stiffness.max(1e-7);
    }
}

fn total_energy(edges: &[Edge], heights: &[f64]) -> f64 {
    // Demand by demand: the residual of an edge's two together lacks what the two disagree by, and that changes with
    // the weights.
    let of_edge = |e: &Edge| -> f64 {
        let difference = heights[e.to] - heights[e.from];
        let residual = |(nz, demand): (f64, f64)| nz * difference - demand;
        e.demands.into_iter().zip(e.weights).map(|(d, w)| w * residual(d) * residual(d)).sum()
    };
    edges.iter().map(of_edge).sum::<f64>().max(1e-12)
}

/// Conjugate gradients with the diagonal as preconditioner on `Σ_edges stiffness (z_to − z_from) = flux`.
fn relax(edges: &[Edge], heights: &mut [f64], steps: usize) {
    let count = heights.len();
    let mut diagonal = vec![0.0; count];
    let mut residual = vec![0.0; count];
    for e in edges {
        diagonal[e.from] += e.stiffness;
        diagonal[e.to] += e.stiffness;
        let r = e.flux - e.stiffness * (heights[e.to] - heights[e.from]);
        residual[e.to] += r;
        residual[e.from] -= r;
    }
    let inverse: Vec<f64> = diagonal.iter().map(|&d| if d > 0.0 { 1.0 / d } else { 0.0 }).collect();
    let scale: f64 = edges.iter().map(|e| e.flux * e.flux / e.stiffness).sum::<f64>().max(1e-30);
    let mut direction: Vec<f64> = residual.iter().zip(&inverse).map(|(r, i)| r * i).collect();
    let mut product = vec![0.0; count];
    let mut rho: f64 = residual.iter().zip(&direction).map(|(r, d)| r * d).sum();
    for _ in 0..steps {
        if rho <= 1e-10 * scale {
            break;
        }
        product.fill(0.0);
        for e in edges {
            let t = e.stiffness * (direction[e.to] - direction[e.from]);
            product[e.to] += t;
            product[e.from] -= t;
        }
        let curvature: f64 = direction.iter().zip(&product).map(|(d, q)| d * q).sum();
        if curvature <= 0.0 {
            break;
        }
        let step = rho / curvature;
        let mut next = 0.0;
        for p in 0..count {
            heights[p] += step * direction[p];
            residual[p] -= step * product[p];
            next += residual[p] * residual[p] * inverse[p];
        }
        let keep = next / rho;
        rho = next;
        for p in 0..count {
            direction[p] = residual[p] * inverse[p] + keep * direction[p];
        }
    }
}

/// Mean height 0 in each connected part.
fn centre(edges: &[Edge], heights: &mut [f64]) {
    let mut parent: Vec<usize> = (0..heights.len()).collect();
    fn root(parent: &mut [usize], mut p: usize) -> usize {
        while parent[p] != p {
            parent[p] = parent[parent[p]];
            p = parent[p];
        }
        p
    }
    for e in edges {
        let (a, b) = (root(&mut parent, e.from), root(&mut parent, e.to));
        parent[a.max(b)] = a.min(b);
    }
    let roots: Vec<usize> = (0..heights.len()).map(|p| root(&mut parent, p)).collect();
    let mut sums = vec![(0.0, 0usize); heights.len()];
    for (&r, &h) in roots.iter().zip(&*heights) {
        sums[r].0 += h;
        sums[r].1 += 1;
    }
    for (&r, h) in roots.iter().zip(heights) {
        *h -= sums[r].0 / sums[r].1 as f64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn never() -> bool {
        false
    }

    /// Heights and normals of a function of the picture plane over a square of `side` pixels.
    fn sample(side: u32, height: impl Fn(f32, f32) -> f32) -> (Mask, Vec<Vec3>, Vec<f32>) {
        let mask = Mask::full(side, side).unwrap();
        let middle = (side - 1) as f32 / 2.0;
        let (mut normals, mut heights) = (Vec::new(), Vec::new());
        for p in 0..mask.len() {
            let (column, row) = mask.position(p);
            let (x, y) = (column as f32 - middle, middle - row as f32);
            let slope = |dx: f32, dy: f32| (height(x + dx, y + dy) - height(x - dx, y - dy)) / 0.02;
            normals.push(Vec3::new(-slope(0.01, 0.0), -slope(0.0, 0.01), 1.0).normalize());
            heights.push(height(x, y));
        }
        (mask, normals, heights)
    }

    fn rms(found: &[f32], truth: &[f32]) -> f32 {
        let mean = |v: &[f32]| v.iter().sum::<f32>() / v.len() as f32;
        let (a, b) = (mean(found), mean(truth));
        let sum: f32 = found.iter().zip(truth).map(|(f, t)| (f - a - t + b) * (f - a - t + b)).sum();
        (sum / found.len() as f32).sqrt()
    }

    #[test]
    fn smooth_hills_come_back() {
        let hill = |x: f32, y: f32| 6.0 * (-(x * x + 2.0 * y * y) / 200.0).exp() + 0.1 * x - 0.2 * y;
        let (mask, normals, truth) = sample(48, hill);
        let depth = integrate(&mask, &normals, &Integration::default(), never).unwrap();
        assert!(rms(&depth.heights, &truth) < 0.05, "{}", rms(&depth.heights, &truth));
    }

    #[test]
    fn a_step_between_two_slopes_stays_a_step() {
        // Two halves that tilt apart: between them a cliff that no normal shows. How high each half stands
        // can't be known, but neither may be bent by the other.
        let roof = |x: f32, y: f32| if x < 0.0 { 0.3 * y } else { -0.3 * y };
        let (mask, mut normals, truth) = sample(48, roof);
        for (p, n) in normals.iter_mut().enumerate() {
            let x = mask.position(p).0 as f32 - 23.5;
            let slope = if x < 0.0 { 0.3 } else { -0.3 };
            *n = Vec3::new(0.0, -slope, 1.0).normalize();
        }
        let bilateral = integrate(&mask, &normals, &Integration::default(), never).unwrap();
        let plain = Integration { stiffness: 0.0, ..Integration::default() };
        let plain = integrate(&mask, &normals, &plain, never).unwrap();
        let off = |depth: &Depth| {
            let half = |left: bool, v: &[f32]| -> Vec<f32> {
                (0..v.len()).filter(|p| (p % 48 < 24) == left).map(|p| v[p]).collect()
            };
            rms(&half(true, &depth.heights), &half(true, &truth))
                .max(rms(&half(false, &depth.heights), &half(false, &truth)))
        };
        assert!(off(&bilateral) < 0.2 && off(&plain) > 1.0, "{} {}", off(&bilateral), off(&plain));
    }

    #[test]
    fn parts_are_integrated_apart() {
        let inside: Vec<bool> = (0..60).map(|i| i % 10 != 5).collect();
        let mask = Mask::new(10, 6, &inside).unwrap();
        let normals = vec![Vec3::new(-0.5, 0.0, 1.0).normalize(); mask.len()];
        let depth = integrate(&mask, &normals, &Integration::default(), never).unwrap();
        for part in [0..5u32, 6..10] {
            let of_part: Vec<f32> = (0..mask.len())
                .filter(|&p| part.contains(&mask.position(p).0))
                .map(|p| depth.heights[p] - 0.5 * mask.position(p).0 as f32)
                .collect();
            let (low, high) = of_part.iter().fold((f32::MAX, f32::MIN), |(l, h), &v| (l.min(v), h.max(v)));
            assert!(high - low < 0.01);
        }
    }

    #[test]
    fn bad_normals_are_named() {
        let mask = Mask::full(2, 1).unwrap();
        let run = |n: &[Vec3]| integrate(&mask, n, &Integration::default(), never).unwrap_err();
        assert_eq!(run(&[Vec3::Z]), IntegrationError::Count { normals: 1, pixels: 2 });
        assert_eq!(run(&[Vec3::Z, Vec3::NAN]), IntegrationError::NotFinite(1));
        // Normals that look away give some finite surface.
        let away = integrate(&mask, &[Vec3::X, -Vec3::Z], &Integration::default(), never).unwrap();
        assert!(away.heights.iter().all(|h| h.is_finite()));
    }
}
