"""numpy, one thread, 57,721 pixels x 10 lights, 32-bit floats: the peer of `cargo bench --bench least_squares`.

Needs numpy. Prints median and smallest of 200 runs in milliseconds for the two usual forms: numpy's least-squares
solver (`numpy.linalg.lstsq`), and the product with the pseudo-inverse."""
import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
import time

import numpy as np

PIXELS, LIGHTS = 57_721, 10
rng = np.random.default_rng(1)
images = rng.random((LIGHTS, PIXELS), dtype=np.float32)
lights = rng.normal(size=(LIGHTS, 3)).astype(np.float32)
lights[:, 2] = np.abs(lights[:, 2]) + 1
lights /= np.linalg.norm(lights, axis=1, keepdims=True)


def split(g):
    albedo = np.linalg.norm(g, axis=0)
    return g / albedo, albedo


forms = {
    "lstsq": lambda: split(np.linalg.lstsq(lights, images, rcond=None)[0]),
    "pseudo-inverse": lambda: split(np.linalg.pinv(lights) @ images),
}
for name, solve in forms.items():
    times = []
    for _ in range(200):
        start = time.perf_counter()
        solve()
        times.append((time.perf_counter() - start) * 1e3)
    print(f"numpy {np.__version__} {name}: median {np.median(times):.2f} ms, fastest {min(times):.2f} ms")
