//! Real objects: published numbers (the golden test of least squares, protocol 128), and how well errors are foreseen.

mod support;

use coil_ps::error::error_map;
use coil_ps::eval::run::run;
use coil_ps::eval::table::{Row, evaluate};
use coil_ps::eval::{Protocol, RunSpec, Settings, Subject};
use coil_ps::pixels::tune::rank_correlation;
use coil_ps::relight::Lookup;
use coil_ps::solve::{self, Measurements, near, uncertainty};
use coil_ps::stack::{BitDepth, RawStack};

fn table(object: &str, protocol: Protocol, planners: &[&str], draws: usize) -> Option<Vec<Row>> {
    Some(table_of(&support::diligent(object)?, protocol, planners, draws))
}

fn table_of(raw: &RawStack, protocol: Protocol, planners: &[&str], draws: usize) -> Vec<Row> {
    let stack = protocol.apply(raw).unwrap();
    let settings = Settings {
        planners: planners.iter().map(|&p| p.into()).collect(),
        solvers: vec!["ls".into()],
        lights: vec![10],
        protocol,
        lookups: vec!["nearest".into()],
        draws,
        seed: 1,
        stop_at: None,
    };
    evaluate(&Subject::Stack(&stack), &settings).unwrap()
}

/// Least squares over all 96 lights, official protocol (docs/evaluation.md).
#[test]
fn least_squares_on_all_lights_is_as_published() {
    for (object, published, tolerance) in [
        ("ball", 4.10, 0.02),
        ("bear", 8.39, 0.02),
        ("cat", 8.41, 0.02),
        ("reading", 19.80, 0.02),
        ("cow", 25.99, 0.05),
        ("pot1", 9.11, 0.05),
    ] {
        let Some(rows) = table(object, Protocol::Official, &["all"], 1) else { return };
        let mae = rows[0].mae.unwrap();
        println!("{object}: {mae:.3} (published {published})");
        assert!((mae - published).abs() <= tolerance, "{object}: {mae:.3}, published {published}");
    }
}

/// Protocol 128, T = 10: within 0.8° of the paper's entries (docs/evaluation.md), and within 1.1° on cow, whose copy here has
/// 8 bits. 300 draws, because one draw of Random has a standard deviation of 1.1° on reading.
#[test]
fn protocol_128_lands_near_the_papers_entries() {
    let planners = ["random", "dc05", "tk22", "lipids"];
    for (object, published) in [
        ("ball", [3.30, 4.49, 3.61, 3.70]),
        ("bear", [9.24, 9.02, 8.99, 8.75]),
        ("cat", [8.13, 8.27, 8.16, 8.09]),
        ("reading", [17.03, 16.97, 16.55, 16.76]),
        ("cow", [26.25, 23.46, 24.40, 23.98]),
        ("pot1", [8.46, 8.17, 7.98, 8.07]),
    ] {
        let tolerance = if object == "cow" { 1.1 } else { 0.8 };
        let Some(rows) = table(object, Protocol::P128, &planners, 300) else { return };
        for (row, paper) in rows.iter().zip(published) {
            let (mae, first) = (row.mae.unwrap(), row.mae_as_published.unwrap());
            println!("{object} {}: {mae:.2}, draw 0 {first:.2} (paper {paper})", row.planner);
            assert!((mae - paper).abs() <= tolerance, "{object} {}: {mae:.2}, paper {paper}", row.planner);
        }
    }
}

/// Protocol 128 on copies cut to 8 bit, like those of cow and pot1, gives nearly what it gives on the originals.
#[test]
fn the_high_bytes_of_16_bit_codes_are_enough() {
    for object in ["ball", "bear", "cat", "reading"] {
        let Some(original) = support::diligent(object) else { return };
        let mut cut = RawStack { bits: BitDepth::Eight, ..original.clone() };
        cut.images.as_mut_slice().iter_mut().flatten().flatten().for_each(|code| *code >>= 8);
        let [whole, cut] =
            [&original, &cut].map(|raw| table_of(raw, Protocol::P128, &["random"], 10)[0].mae.unwrap());
        println!("{object}: 16 bit {whole:.2}, 8 bit {cut:.2}");
        assert!((whole - cut).abs() < 0.25, "{object}: 16 bit {whole:.2}, 8 bit {cut:.2}");
    }
}

/// For each of `solvers`, which begin alike: mean error in degrees, and rank correlation over the pixels of expected and true error; ten lights, DC05's ring and
/// vertical, official protocol.
fn solved<const N: usize>(object: &str, solvers: [&str; N]) -> Option<[(f64, f64); N]> {
    let stack = Protocol::Official.apply(&support::diligent(object)?).unwrap();
    let (planner, lookup) = ("dc05v".into(), Lookup::Nearest);
    let spec = RunSpec { planner, lights: 10, lookup, draw: 0, seed: 1, stop_at: None };
    let seen = run(&Subject::Stack(&stack), &spec, &[], None).unwrap().seen;
    let ready = solve::prepare(solvers[0], Measurements::of(&seen), &near::places(&stack.mask)).unwrap();
    let pictures = ready.measurements();
    let mut begun = solve::by_name(solvers[0]).unwrap().solve(&pictures).unwrap();
    uncertainty::complete(solvers[0], &pictures, &mut begun).unwrap();
    Some(solvers.map(|solver| {
        let mut solution = begun.clone();
        solve::finish(solver, &stack.mask, &mut solution).unwrap();
        let truth = error_map(&solution.normals, stack.truth.as_deref().unwrap());
        let rank = rank_correlation(&solution.uncertainty.unwrap(), &truth.degrees);
        println!("{solver} on {object}: {:.2}°, rank correlation {rank:.2}", truth.mae);
        (truth.mae, rank)
    }))
}

/// What docs/solvers.md says of real objects: expected errors rank pixels as the true ones do (those of the learned solvers don't reach 0.5 on every
/// object), and what is around a pixel corrects its normal.
#[test]
fn expected_errors_rank_pixels_and_context_corrects_normals() {
    for object in ["ball", "bear", "cat", "reading", "cow", "pot1"] {
        let Some([(_, rank)]) = solved(object, ["ls"]) else { return };
        assert!(rank >= 0.5, "{object}: {rank:.2}");
    }
    let (mut before, mut after) = (0.0, 0.0);
    for (object, least) in [
        ("ball", [-1.0, -1.0]),
        ("bear", [0.33, 0.38]),
        ("cat", [0.33, 0.37]),
        ("reading", [0.6, 0.6]),
        ("cow", [0.6, 0.45]),
        ("pot1", [0.55, 0.6]),
    ] {
        let Some([(pixel, rank), (context, rank_in_context)]) = solved(object, ["pixel", "context"]) else {
            return;
        };
        assert!(rank >= least[0] && rank_in_context >= least[1], "{object}: {rank:.2}, {rank_in_context:.2}");
        assert!(context < pixel, "{object}: pixel {pixel:.2}, context {context:.2}");
        (before, after) = (before + pixel, after + context);
    }
    assert!(after < 0.85 * before, "mean: pixel {:.2}, context {:.2}", before / 6.0, after / 6.0);
}
