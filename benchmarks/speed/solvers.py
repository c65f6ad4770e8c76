#!/usr/bin/env python3
"""Times peers of the solvers on 57,721 pixels x 10 lights, one thread (CPU time, so that a
busy machine matters less): numpy for trimmed least squares,
onnxruntime for the pixel network (models/pixel.onnx, the same file coil-ps runs; its time leaves out describing the
observations). That both agree is tests/pixel_parity.rs.

pip install numpy onnxruntime; python3 benchmarks/speed/solvers.py
"""
import os
import time

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"
import numpy as np

PIXELS, LIGHTS, REPEATS = 57_721, 10, 7
rng = np.random.default_rng(1)
images = rng.random((LIGHTS, PIXELS), dtype=np.float32)
golden = np.pi * (3 - 5**0.5)
z = 1 - (1 - np.cos(0.75)) * (np.arange(LIGHTS) + 0.5) / LIGHTS
r, phi = np.sqrt(1 - z * z), golden * np.arange(LIGHTS)
lights = np.stack([r * np.cos(phi), r * np.sin(phi), z], 1).astype(np.float32)


def trimmed(dark=1, bright=1):
    order = np.argsort(images, axis=0, kind="stable")[dark : LIGHTS - bright]
    values = np.take_along_axis(images, order, 0)  # kept, pixels
    L = lights[order]  # kept, pixels, 3
    gram = np.einsum("kpi,kpj->pij", L, L)
    g = np.linalg.solve(gram, np.einsum("kpi,kp->pi", L, values)[..., None])[..., 0]
    return g / np.linalg.norm(g, axis=1, keepdims=True)


def best(run):
    times = []
    for _ in range(REPEATS):
        begun = time.process_time()
        run()
        times.append(time.process_time() - begun)
    return min(times)


print(f"numpy {np.__version__}, trimmed least squares: {1e3 * best(trimmed):.1f} ms")
try:
    import onnxruntime as ort
except ImportError:
    raise SystemExit("onnxruntime is not installed")
options = ort.SessionOptions()
options.intra_op_num_threads = options.inter_op_num_threads = 1
path = os.path.join(os.path.dirname(__file__), "../../models/pixel.onnx")
session = ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])
for tile in (256, 1024, 4096):
    observations = rng.standard_normal((tile, LIGHTS, 18), dtype=np.float32)
    seconds = best(lambda: session.run(None, {"observations": observations}))
    print(f"onnxruntime {ort.__version__}, tiles of {tile}: {seconds * PIXELS / tile:.2f} s")
