//! The pixel network gives what onnxruntime gives on the same file (benchmarks/speed/pixel_parity.py).

use coil_ps::solve::pixel::network::{INPUTS, Tape, WIDTH, Wide};
use coil_ps::solve::pixel::{SHIPPED, onnx};

#[test]
fn own_arithmetic_agrees_with_onnxruntime() {
    let golden: serde_json::Value = serde_json::from_str(include_str!("golden/pixel-onnxruntime.json"))
        .expect("the committed file is valid");
    let network = onnx::read(SHIPPED).expect("the committed file is valid").network;
    for (lights, rows) in golden["corrections"].as_object().expect("one entry for each number of lights") {
        let tokens: usize = lights.parse().expect("a number of lights");
        let mut inputs = vec![Wide::ZERO; tokens * INPUTS];
        for (at, wide) in inputs.iter_mut().enumerate() {
            let (t, i) = ((at / INPUTS) as f64, (at % INPUTS) as f64);
            *wide = Wide(std::array::from_fn(|p| (1.3 * p as f64 + 2.1 * t + 0.7 * i * i).sin() as f32));
        }
        let outputs = network.forward(&mut Tape::default(), &inputs, tokens);
        let rows: Vec<Vec<f32>> = serde_json::from_value(rows.clone()).expect("rows of numbers");
        assert_eq!(rows.len(), WIDTH);
        for (lane, row) in rows.iter().enumerate() {
            for (found, expected) in outputs.iter().map(|o| o.0[lane]).zip(row) {
                assert!(
                    (found - expected).abs() < 1e-4,
                    "T = {lights}, pixel {lane}: {found}, not {expected}"
                );
            }
        }
    }
}
