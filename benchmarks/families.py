#!/usr/bin/env python3
"""Mean errors by family of shapes, from the JSON of an evaluation of worlds-v1.

    coil eval worlds-v1 --size 64 --planner ring:15,coil,oracle --lights 10 --draws 2 --json worlds.json
    python benchmarks/families.py worlds.json [T]

A family is the part of an object's name after the number. Half of the objects are of families that training has not.
"""
import json
import sys
from collections import defaultdict
from pathlib import Path

UNSEEN = {"figure", "knot", "lattice", "stone"}


def main(path: Path, lights: int) -> None:
    errors = defaultdict(lambda: defaultdict(list))
    for row in json.loads(path.read_text())["results"]:
        if row["lights"] == lights:
            family = row["object"].split("-", 1)[1]
            for group in (family, "unseen families" if family in UNSEEN else "families of training"):
                errors[group][row["planner"]].append(row["mae"])
    planners = list(next(iter(errors.values())))
    print(f"T = {lights}{'':22}" + "".join(f"{p:>20}" for p in planners))
    for group in sorted(errors, key=lambda g: (" " in g, g in UNSEEN, g)):
        means = [sum(errors[group][p]) / len(errors[group][p]) for p in planners]
        print(f"{group:22}{len(errors[group][planners[0]]):6}" + "".join(f"{m:20.2f}" for m in means))


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 10)
