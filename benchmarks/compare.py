#!/usr/bin/env python3
"""Compares a planner with all others on the same objects, from the JSON of an evaluation of worlds-v1.

    coil eval worlds-v1 --size 64 --planner ring:15,coil,oracle --lights 3,5,10 --draws 2 --json worlds.json
    python benchmarks/compare.py worlds.json [PLANNER]

For each T: mean errors, and PLANNER's (coil's) less the other's, paired over objects, with the 95 % interval. Then means by
family of shapes, which is the part of an object's name after the number; half of the objects are of families that training has not.
"""
import json
import math
import sys
from collections import defaultdict
from pathlib import Path

UNSEEN = {"figure", "knot", "lattice", "stone"}


def mean(values) -> float:
    values = list(values)
    return sum(values) / len(values)


def differences(errors: dict, planner: str) -> None:
    for other, theirs in errors.items():
        line = f"{other:22}{mean(theirs.values()):8.2f}"
        if other != planner:
            less = [mae - theirs[name] for name, mae in errors[planner].items() if name in theirs]
            spread = math.sqrt(sum((d - mean(less)) ** 2 for d in less) / (len(less) - 1))
            # 1.984: Student's t for a hundred objects.
            interval = 1.984 * spread / math.sqrt(len(less))
            better = sum(d < 0 for d in less)
            line += f"{mean(less):+8.2f} ± {interval:.2f}   better on {better} of {len(less)}"
        print(line)


def families(errors: dict) -> None:
    groups = defaultdict(list)
    for name in next(iter(errors.values())):
        family = name.split("-", 1)[1]
        groups[family].append(name)
        groups["unseen families" if family in UNSEEN else "families of training"].append(name)
    print(f"{'':28}" + "".join(f"{p:>20}" for p in errors))
    for group, names in sorted(groups.items(), key=lambda g: (" " in g[0], g[0] in UNSEEN, g[0])):
        means = [mean(e[n] for n in names if n in e) for e in errors.values()]
        print(f"{group:22}{len(names):6}" + "".join(f"{m:20.2f}" for m in means))


def main(path: Path, planner: str) -> None:
    errors = defaultdict(lambda: defaultdict(dict))
    for row in json.loads(path.read_text())["results"]:
        if row.get("mae") is not None:
            errors[row["lights"]][row["planner"]][row["object"]] = row["mae"]
    for lights, of_planner in sorted(errors.items()):
        print(f"\nT = {lights}: mean error, {planner} less the other")
        differences(of_planner, planner)
    print(f"\nT = {lights}, by family")
    families(of_planner)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else "coil")
