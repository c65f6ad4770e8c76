//! `coil tune`: the robust solvers' parameters and the calibration of their uncertainty, from synthetic pixels.

use coil_ps::pixels::Generator;
use coil_ps::pixels::tune::{Score, bench, power_law, rendered, score};
use coil_ps::render::worlds::Split;
use coil_ps::solve::uncertainty::Calibration;
use coil_ps::solve::{self, Irls, Loss, Solver, SparseBayes, Thresholds, Trimmed};
use std::process::ExitCode;

/// Prints, for every solver without training, the mean angular error on synthetic pixels over a grid of its
/// parameters, and the calibration of its uncertainty.
#[derive(clap::Args)]
pub struct Args {
    /// Seed of the pixels.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Light sets for each number of lights (64 pixels each).
    #[arg(long, default_value_t = 200)]
    sets: usize,
    /// Rendered training objects that the uncertainty is calibrated on.
    #[arg(long, default_value_t = 60)]
    objects: usize,
    /// Their size in pixels.
    #[arg(long, default_value_t = 64)]
    size: u32,
    /// Only the uncertainty, not the grids of parameters.
    #[arg(long)]
    uncertainty: bool,
}

/// Numbers of lights that count alike.
const LIGHTS: [usize; 4] = [5, 10, 20, 60];

pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let generator = Generator::new(Split::Train);
    let benches: Vec<_> = LIGHTS.iter().map(|&t| bench(&generator, args.seed, t, args.sets, 64)).collect();
    println!(
        "mean angular error in degrees at T = {LIGHTS:?} and over all; seed {}, {} sets",
        args.seed, args.sets
    );
    for (family, candidates) in if args.uncertainty { Vec::new() } else { grid() } {
        println!("\n{family}");
        let mut best: Option<(f64, String)> = None;
        for (text, solver) in candidates {
            let scores = benches.iter().map(|b| score(&*solver, b)).collect::<Result<Vec<_>, _>>()?;
            let means: Vec<f64> = scores.iter().map(Score::mean).collect();
            let all = means.iter().sum::<f64>() / means.len() as f64;
            let cells: String = means.iter().map(|m| format!("{m:7.2}")).collect();
            println!("  {text:44}{cells}{all:9.3}");
            if best.as_ref().is_none_or(|(b, _)| all < *b) {
                best = Some((all, text));
            }
        }
        if let Some((all, text)) = best {
            println!("  best: {text} ({all:.3})");
        }
    }
    println!(
        "\nuncertainty of the solvers as they are, on synthetic pixels and then on {} rendered",
        args.objects
    );
    println!(
        "training objects: mean error, mean expected, rank correlation at each T; the calibration they ask for"
    );
    let objects = LIGHTS.iter().map(|&t| rendered(args.objects, t, args.size)).collect::<Result<Vec<_>, _>>();
    let objects = objects.map_err(anyhow::Error::msg)?;
    for (name, _) in solve::SOLVERS {
        let Some(now) = Calibration::of(name) else { continue };
        let solver = solve::by_name(name)?;
        for (of_objects, benches) in [(false, &benches), (true, &objects)] {
            let scores = benches.iter().map(|b| score(&*solver, b)).collect::<Result<Vec<_>, _>>()?;
            let cells: String = scores
                .iter()
                .map(|s| format!("  {:5.2} {:5.2} {:.2}", s.mean(), s.mean_expected(), s.rank_correlation()))
                .collect();
            let mut all = Score::default();
            for s in scores {
                all.errors.extend(s.errors);
                all.expected.extend(s.expected);
            }
            let (factor, exponent) = power_law(&all.expected, &all.errors);
            let (factor, exponent) = (factor * now.factor.powf(exponent), exponent * now.exponent);
            let asked = if of_objects {
                format!("   factor: {factor:.1}, exponent: {exponent:.3}")
            } else {
                String::new()
            };
            println!("  {name:8}{cells}{asked}");
        }
    }
    Ok(ExitCode::SUCCESS)
}

type Candidates = Vec<(String, Box<dyn Solver>)>;

fn grid() -> Vec<(&'static str, Candidates)> {
    let thresholds = |shadow| Thresholds { shadow, ..Thresholds::default() };
    let mut trimmed: Candidates = Vec::new();
    for shadow in [0.0, 0.02, 0.05] {
        for dark in [0.0, 0.1, 0.2, 0.3, 0.4, 0.5] {
            for bright in [0.0, 0.1, 0.2] {
                let solver = Trimmed { dark, bright, thresholds: thresholds(shadow) };
                trimmed.push((format!("shadow {shadow} dark {dark} bright {bright}"), Box::new(solver)));
            }
        }
    }
    let mut out = vec![("trimmed", trimmed)];
    for (name, loss, scales) in [
        ("l1", Loss::L1, [1e-4, 1e-3, 3e-3, 0.01]),
        ("huber", Loss::Huber, [3e-3, 0.01, 0.02, 0.05]),
        ("cauchy", Loss::Cauchy, [0.01, 0.02, 0.05, 0.1]),
    ] {
        let mut candidates: Candidates = Vec::new();
        for shadow in [0.0, 0.02, 0.05, 0.1] {
            for scale in scales {
                for iterations in [6, 12, 24] {
                    let solver = Irls { loss, scale, iterations, thresholds: thresholds(shadow) };
                    candidates.push((
                        format!("shadow {shadow} scale {scale} iterations {iterations}"),
                        Box::new(solver),
                    ));
                }
            }
        }
        out.push((name, candidates));
    }
    let mut bayes: Candidates = Vec::new();
    for shadow in [0.0, 0.02, 0.05, 0.1] {
        for noise in [1e-3, 3e-3, 0.01, 0.03] {
            for iterations in [15, 40, 100] {
                let solver = SparseBayes { noise, iterations, thresholds: thresholds(shadow) };
                bayes.push((
                    format!("shadow {shadow} noise {noise} iterations {iterations}"),
                    Box::new(solver),
                ));
            }
        }
    }
    out.push(("sbr", bayes));
    let mut conditioning: Candidates = Vec::new();
    for c in [0.0, 1e-3, 0.01, 0.03, 0.1] {
        let bayes = SparseBayes::default();
        let thresholds = Thresholds { conditioning: c, ..bayes.thresholds };
        conditioning.push((format!("sbr, conditioning {c}"), Box::new(SparseBayes { thresholds, ..bayes })));
        let t = Trimmed::default();
        let thresholds = Thresholds { conditioning: c, ..t.thresholds };
        conditioning.push((format!("trimmed, conditioning {c}"), Box::new(Trimmed { thresholds, ..t })));
    }
    out.push(("conditioning (compare within a solver)", conditioning));
    out
}
