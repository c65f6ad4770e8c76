#!/usr/bin/env python3
"""What onnxruntime makes of models/pixel.onnx, for tests/pixel_parity.rs to hold coil-ps's own arithmetic to.

pip install numpy onnxruntime onnx; python3 benchmarks/speed/pixel_parity.py > tests/golden/pixel-onnxruntime.json
"""
import json
import os

import numpy as np
import onnx
import onnxruntime as ort

path = os.path.join(os.path.dirname(__file__), "../../models/pixel.onnx")
onnx.checker.check_model(onnx.load(path), full_check=True)
session = ort.InferenceSession(path, providers=["CPUExecutionProvider"])
results = {}
for lights in (3, 10, 40):
    p, t, i = np.meshgrid(np.arange(16), np.arange(lights), np.arange(18), indexing="ij")
    observations = np.sin(1.3 * p + 2.1 * t + 0.7 * i * i).astype(np.float32)
    out = session.run(None, {"observations": observations})[0]
    results[str(lights)] = [[float(f"{v:.7g}") for v in row] for row in out]
print(json.dumps({"onnxruntime": ort.__version__, "corrections": results}))
