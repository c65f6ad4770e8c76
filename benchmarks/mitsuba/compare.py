"""Renders the same meshes with coil-ps and with Mitsuba 3 and compares the pictures.

    pip install mitsuba numpy
    cargo build --release
    python benchmarks/mitsuba/compare.py [--coil target/release/coil] [--out DIR] [--picture docs/mitsuba.png]

Same mesh (with normals), pose, directional light of irradiance pi, orthographic camera, material. coil-ps samples pixel
centres, Mitsuba integrates over the pixel: coil-ps therefore renders at four times the size and is averaged down.
Prints the RMS difference over the RMS of Mitsuba's picture; exits with 1 where it is above the limit of the case.
"""

import argparse
import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
SIZE, OVER = 128, 4


def grid(rings, spokes, point):
    """A closed-in-u surface as vertices, normals by central differences, and triangles."""
    v = np.array([[point(i / rings, j / spokes) for j in range(spokes)] for i in range(rings + 1)])
    e = 1e-5
    n = np.empty_like(v)
    for i in range(rings + 1):
        for j in range(spokes):
            s = min(max(i / rings, 2 * e), 1 - 2 * e)
            du = np.subtract(point(s + e, j / spokes), point(s - e, j / spokes))
            dv = np.subtract(point(s, j / spokes + e), point(s, j / spokes - e))
            n[i, j] = np.cross(du, dv) / max(np.linalg.norm(np.cross(du, dv)), 1e-30)
    at = lambda i, j: i * spokes + j % spokes
    faces = [f for i in range(rings) for j in range(spokes)
             for f in ([at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)])]
    return v.reshape(-1, 3), n.reshape(-1, 3), np.array(faces)


def sphere_direction(s, t):
    a, b = math.pi * s, 2 * math.pi * t
    return np.array([math.sin(a) * math.cos(b), math.sin(a) * math.sin(b), math.cos(a)])


def knobbly(s, t):
    """A ball with deep lumps that throw shadows."""
    d = sphere_direction(s, t)
    return d * (1 + 0.16 * math.sin(5 * d[0]) * math.sin(5 * d[1] + 1) * math.cos(4 * d[2]))


def bowl(s, t):
    """A thick bowl open towards +z: outside, rim, inside."""
    # From the outer pole to the rim, over it, and back to the inner pole.
    d = sphere_direction(1 - min(s, 1 - s), t)
    inside = 0.5 - 0.5 * math.cos(math.pi * min(max((s - 0.45) / 0.1, 0), 1))
    return d * (1 - 0.15 * inside)


def write_obj(path, v, n, f):
    with open(path, "w") as out:
        out.writelines("v %.7g %.7g %.7g\n" % tuple(p) for p in v)
        out.writelines("vn %.7g %.7g %.7g\n" % tuple(p) for p in n)
        out.writelines("f %d//%d %d//%d %d//%d\n" % (a, a, b, b, c, c) for a, b, c in f + 1)


def linear_png(path, white):
    """Code values of a 16-bit PNG as linear values: Mitsuba would undo a gamma that is not there."""
    bitmap = mi.Bitmap(str(path))
    return np.array(bitmap, dtype=np.float64)[..., :3] / 65535 * white


def mitsuba_picture(mesh, bsdf, light, bounces, scale, spp):
    travel = [-c for c in light]
    camera = mi.ScalarTransform4f().look_at(origin=[0, 0, 5], target=[0, 0, 0], up=[0, 1, 0])
    scene = mi.load_dict({
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2 + bounces, "rr_depth": 100},
        "sensor": {"type": "orthographic", "to_world": camera, "near_clip": 0.1, "far_clip": 20,
                   "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"},
                            "pixel_format": "rgb"},
                   "sampler": {"type": "multijitter", "sample_count": spp}},
        "light": {"type": "directional", "direction": travel, "irradiance": {"type": "rgb", "value": [math.pi] * 3}},
        "mesh": {"type": "obj", "filename": str(mesh), "to_world": mi.ScalarTransform4f().scale(scale),
                 "bsdf": {"type": "twosided", "bsdf": bsdf}},
    })
    return np.array(mi.render(scene))[..., :3].astype(np.float64)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--coil", default="target/release/coil")
    parser.add_argument("--picture")
    parser.add_argument("--json")
    args = parser.parse_args()
    shapes = {"knobbly": grid(220, 440, knobbly), "bowl": grid(400, 360, bowl)}
    diffuse = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.8}}
    rough = lambda a: {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": a}
    cases = [
        # name, shape, coil material, Mitsuba material, light, bounces, limit, samples a pixel
        ("direct, diffuse", "knobbly", "lambert:0.8", diffuse, [0.5, 0.3, 0.81], 0, 0.01, 256),
        ("direct, diffuse, low light", "knobbly", "lambert:0.8", diffuse, [-0.8, 0.4, 0.45], 0, 0.01, 256),
        ("direct, rough conductor 0.3", "knobbly", "ggx:0.3", rough(0.3), [0.5, 0.3, 0.81], 0, 0.01, 256),
        ("direct, rough conductor 0.15", "knobbly", "ggx:0.15", rough(0.15), [-0.3, 0.6, 0.74], 0, 0.01, 256),
        ("direct, diffuse, concave", "bowl", "lambert:0.8", diffuse, [0.5, 0.3, 0.81], 0, 0.01, 256),
        ("one bounce, concave", "bowl", "lambert:0.8", diffuse, [0.5, 0.3, 0.81], 1, 0.03, 1024),
        ("one bounce, concave, frontal", "bowl", "lambert:0.8", diffuse, [0.0, 0.0, 1.0], 1, 0.03, 1024),
        ("four bounces, concave", "bowl", "lambert:0.8", diffuse, [0.5, 0.3, 0.81], 4, 0.03, 1024),
    ]
    scale, results, strips = 0.8, [], []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        pose = {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "scale": scale, "translation": [0, 0, 0]}
        (folder / "pose.json").write_text(json.dumps(pose))
        for name, shape in shapes.items():
            write_obj(folder / f"{name}.obj", *shape)
        for name, shape, material, bsdf, light, bounces, limit, spp in cases:
            light = [c / math.dist((0, 0, 0), light) for c in light]
            mesh, white = folder / f"{shape}.obj", 16.0
            subprocess.run([args.coil, "render", str(mesh), "--material", material, "--pose", str(folder / "pose.json"),
                            "--lights", ",".join(map(str, light)), "--size", str(SIZE * OVER), "--bounces",
                            str(bounces), "--white", str(white), "--out", str(folder / "coil")],
                           check=True, stdout=subprocess.DEVNULL)
            fine = linear_png(folder / "coil" / shape / "001.png", white)
            ours = fine.reshape(SIZE, OVER, SIZE, OVER, 3).mean(axis=(1, 3))
            theirs = mitsuba_picture(mesh, bsdf, light, bounces, scale, spp)
            if name.startswith("direct, diffuse") and np.abs(ours[:, ::-1] - theirs).mean() < np.abs(ours - theirs).mean():
                sys.exit("the camera is mirrored")
            rms = math.sqrt(((ours - theirs) ** 2).mean() / (theirs ** 2).mean())
            results.append({"case": name, "rms": rms, "limit": limit})
            print(f"{name:32} {100 * rms:6.2f} %  (limit {100 * limit:.0f} %)", flush=True)
            difference = np.clip(0.5 + 5 * (ours - theirs), 0, 1)
            strips.append(np.concatenate([np.clip(ours, 0, 1) ** (1 / 2.2), np.clip(theirs, 0, 1) ** (1 / 2.2), difference], axis=0))
    if args.picture:
        sheet = np.concatenate(strips, axis=1).astype(np.float32)
        mi.Bitmap((255 * sheet + 0.5).astype(np.uint8)).write(args.picture)
    if args.json:
        Path(args.json).write_text(json.dumps({"mitsuba": mi.__version__, "results": results}, indent=2) + "\n")
    sys.exit(any(r["rms"] > r["limit"] for r in results))


if __name__ == "__main__":
    main()
