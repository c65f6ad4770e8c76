//! Speed of least squares on the size of DiLiGenT's cat full-frame mask: 57,721 pixels × 10 lights, one core.
//!
//! `cargo bench --bench least_squares`; `python3 benchmarks/speed/least_squares.py` times numpy's matrix form on the
//! same sizes for the ratio.

use coil_ps::light::fibonacci_cap;
use coil_ps::rng::Rng;
use coil_ps::solve::least_squares::NormalEquations;
use coil_ps::solve::{LeastSquares, Measurements, Solver};
use divan::{Bencher, black_box};

const PIXELS: usize = 57_721;
const LIGHTS: usize = 10;

fn main() {
    divan::main();
}

fn images() -> Vec<Vec<f32>> {
    let mut rng = Rng::new(1);
    (0..LIGHTS).map(|_| (0..PIXELS).map(|_| rng.uniform()).collect()).collect()
}

/// All ten images to normals and albedo.
#[divan::bench]
fn solve(bencher: Bencher) {
    let images = images();
    let measurements = Measurements {
        lights: fibonacci_cap(LIGHTS, 0.75),
        images: images.iter().map(Vec::as_slice).collect(),
        ..Measurements::default()
    };
    bencher.bench(|| LeastSquares.solve(black_box(&measurements)));
}

/// An eleventh light, added to a stack that is solved: one pass over the pixels.
#[divan::bench]
fn add_a_light(bencher: Bencher) {
    let (images, lights) = (images(), fibonacci_cap(LIGHTS, 0.75));
    let mut equations = NormalEquations::new(PIXELS);
    for (l, i) in lights.iter().zip(&images) {
        equations.add(*l, i);
    }
    bencher.bench_local(|| equations.add(black_box(lights[0]), black_box(&images[0])));
}

/// Normals from running normal equations.
#[divan::bench]
fn solve_again(bencher: Bencher) {
    let (images, lights) = (images(), fibonacci_cap(LIGHTS, 0.75));
    let mut equations = NormalEquations::new(PIXELS);
    for (l, i) in lights.iter().zip(&images) {
        equations.add(*l, i);
    }
    bencher.bench(|| black_box(&equations).solve());
}
