#!/usr/bin/env python3
"""Runs a policy's ONNX files in onnxruntime and compares every direction with what coil (tract) computed.

    coil model trace models/compact > trace.json
    pip install onnx onnxruntime numpy
    python benchmarks/onnx/check.py models/compact trace.json

Fails where a file is not valid for onnx.checker, or a direction differs by more than 1e-4.
"""
import json
import sys
import time
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort

TOLERANCE = 1e-4


def main(folder: Path, trace_path: Path) -> int:
    trace = json.loads(trace_path.read_text())
    sessions = {}
    for part in ("encoder", "step"):
        path = folder / f"{part}.onnx"
        onnx.checker.check_model(onnx.load(path), full_check=True)
        options = ort.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        sessions[part] = ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    encoder, step = sessions["encoder"], sessions["step"]
    shapes = {i.name: i.shape for i in step.get_inputs()}
    frame_shape = encoder.get_inputs()[0].shape
    worst, times = 0.0, []
    for run in trace["runs"]:
        caches = {n: np.zeros(shapes[n], np.float32) for n in ("keys", "values") if n in shapes}
        for i, picture in enumerate(run["pictures"]):
            frame = np.array(picture["frame"], np.float32).reshape(frame_shape)
            start = time.perf_counter()
            features = encoder.run(["features"], {"frame": frame})[0]
            inputs = {
                "features": features,
                "light": np.array([picture["light"]], np.float32),
                "reach": np.array([[run["reach"]]], np.float32),
            }
            if "lights" in shapes:
                inputs["lights"] = np.array([len(run["pictures"])], np.int64)
            if "position" in shapes:
                inputs["position"] = np.array([i], np.int64)
            if caches:
                inputs |= caches
                direction, keys, values = step.run(["direction", "new_keys", "new_values"], inputs)
                caches["keys"][:, :, i] = keys
                caches["values"][:, :, i] = values
            else:
                (direction,) = step.run(["direction"], inputs)
            times.append((i, time.perf_counter() - start))
            worst = max(worst, float(np.abs(direction[0] - np.array(picture["next"])).max()))
    print(f"{len(trace['runs'])} sequences, largest difference from coil {worst:.2e} (allowed {TOLERANCE:.0e})")
    by_step = [sorted(t for j, t in times if j == i) for i in range(max(j for j, _ in times) + 1)]
    print("onnxruntime, one thread, median ms by step:", " ".join(f"{1e3 * t[len(t) // 2]:.2f}" for t in by_step))
    print("coil (tract), one thread, median ms by step:", " ".join(f"{ms:.2f}" for ms in trace["milliseconds"]))
    return int(worst > TOLERANCE)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2])))
