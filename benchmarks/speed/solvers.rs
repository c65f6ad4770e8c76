//! Speed of the solvers on the size of DiLiGenT's cat full-frame mask: 57,721 pixels × 10 lights, one core.
//!
//! `cargo bench --bench solvers`; `python3 benchmarks/speed/solvers.py` times numpy on trimmed least squares and
//! onnxruntime on the pixel network, for the ratios.

use coil_ps::light::fibonacci_cap;
use coil_ps::rng::Rng;
use coil_ps::solve::{self, Measurements};
use divan::{Bencher, black_box};

const PIXELS: usize = 57_721;
const LIGHTS: usize = 10;

fn main() {
    divan::main();
}

#[divan::bench(args = ["ls", "trimmed", "l1", "huber", "cauchy", "sbr", "pixel"], sample_count = 10)]
fn solve(bencher: Bencher, name: &str) {
    let mut rng = Rng::new(1);
    let images: Vec<Vec<f32>> = (0..LIGHTS).map(|_| (0..PIXELS).map(|_| rng.uniform()).collect()).collect();
    let measurements = Measurements {
        lights: fibonacci_cap(LIGHTS, 0.75),
        images: images.iter().map(Vec::as_slice).collect(),
        ..Measurements::default()
    };
    let solver = solve::by_name(name).expect("a solver's name");
    bencher.bench_local(|| solver.solve(black_box(&measurements)));
}
