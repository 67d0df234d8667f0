"""Guided against exhaustive search: information found, evaluations spent, and how the work grows with the points.

The information of a scene is the sum of the weights of its true hyper-edges; these are evaluated directly, so the
exhaustive search need not run to know what it would find. ``--data`` (or ROOTMATCH_DATA) names a folder with
``vive_hmd_lighthouse.npz``: a headset of 32 sensors of which 7 to 12 are visible.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

import rootmatch as rm
from rootmatch.backends import cpu
from rootmatch.hypergraph.affinity import affinity
from rootmatch.hypergraph.enumeration import exhaustive_count, farthest_point_order
from rootmatch.simulation import SCENES, Scene

FIRST_SEED = 1000
"""Lower seeds were used to tune the defaults."""
SIZES = (10, 20, 40, 70, 100)
LISTED = 30
"""Points up to which every true hyper-edge is evaluated."""
NOISE = 1.0
HEADSET_NOISE = 0.15


@dataclass(frozen=True)
class Row:
    """Medians over seeds, except for the least information."""

    scene: str
    seconds: float
    evaluations: float
    saving: float
    """Hyper-edges of the exhaustive search per evaluation."""
    information: float | None
    """Fraction of the true information in the tensor, the minimum over seeds."""
    accuracy: float


def true_information(scene: Scene) -> float:
    """Sum of the weights of the true hyper-edges below the gate."""
    problem, weigh = scene.problem, affinity("joint")
    order = farthest_point_order(scene.source)
    tables = problem.prepare(scene.source[order], scene.target, scene.noise)
    source = np.array(list(combinations(np.flatnonzero(scene.truth[order] >= 0), problem.order)))
    kind = weigh.residual.kernel_kind(problem.pair_count)
    residuals = cpu.residuals(tables, kind, source, scene.truth[order][source])
    return float(weigh.weights(residuals[residuals <= weigh.gate]).sum())


def measure(name: str, n: int, outliers: int, hidden: int, seeds: range) -> Row:
    """One kind of scene."""
    seconds, evaluations, information, accuracy = [], [], [], []
    for turn, seed in enumerate([seeds[0], *seeds]):
        scene = SCENES[name](n, outliers, noise=NOISE, seed=seed, hidden=hidden)
        started = time.process_time()
        match = rm.match(scene.source, scene.target, scene.problem, noise=NOISE, seed=seed, sampler="guided")
        if turn == 0:  # compiles
            continue
        seconds.append(time.process_time() - started)
        evaluations.append(match.evaluated)
        accuracy.append(scene.accuracy(match.assignment))
        if n <= LISTED:
            information.append(match.tensor.score(scene.truth) / true_information(scene))
    count = exhaustive_count(n + hidden, n + outliers, scene.problem.order)
    return Row(
        f"{name} {n} + {outliers}" + (f", {hidden} unseen" if hidden else ""),
        float(np.median(seconds)), float(np.median(evaluations)), count / float(np.median(evaluations)),
        min(information) if information else None, float(np.mean(accuracy)),
    )  # fmt: skip


def headset(folder: Path) -> list[Row]:
    """Every view of the headset, with and without normals."""
    data = np.load(folder / "vive_hmd_lighthouse.npz", allow_pickle=False)
    rows = []
    for normals in (data["normals3d"], None):
        for view in range(len(data["points2d"])):
            visible = np.flatnonzero(np.isfinite(data["points2d"][view, :, 0]))
            seen = np.random.default_rng(view).permutation(visible)
            truth = np.full(len(data["points3d"]), -1)
            truth[seen] = np.arange(len(seen))
            started = time.process_time()
            match = rm.match(
                data["points3d"],
                data["points2d"][view][seen],
                rm.P3P(rm.Camera.from_matrix(data["K"][view])),
                noise=HEADSET_NOISE,
                normals=normals,
                sampler="guided",
            )
            spent = time.process_time() - started
            name = f"headset, view {view}, {len(seen)} of 32{'' if normals is None else ', normals'}"
            right = float(np.mean(match.assignment[seen] == truth[seen]))
            saving = exhaustive_count(32, len(seen), 4) / match.evaluated
            rows.append(Row(name, spent, float(match.evaluated), saving, None, right))
    return rows


def growth(rows: list[Row]) -> dict[str, float]:
    """Exponents of evaluations and seconds over the number of points, by least squares on logarithms."""
    sizes = np.log([int(row.scene.split()[1]) for row in rows])
    return {
        name: float(np.polyfit(sizes, np.log([getattr(row, name) for row in rows]), 1)[0])
        for name in ("evaluations", "seconds")
    }


def line(row: Row) -> str:
    """One row of the table."""
    information = "      " if row.information is None else f"{row.information:.4f}"
    return (
        f"{row.scene:38s} {1e3 * row.seconds:9.1f} ms  {row.evaluations:9.3g}  1/{row.saving:<9.3g}  {information}"
        f"  {row.accuracy:.4f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10, help="scenes of each kind")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="points, with as many outliers")
    parser.add_argument("--data", default=os.environ.get("ROOTMATCH_DATA"), help="folder of the measured data")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
    rows: list[Row] = []
    exponents: dict[str, dict[str, float]] = {}

    def report(row: Row) -> None:
        rows.append(row)
        if not options.json:
            print(line(row), flush=True)

    if not options.json:
        print("median time, evaluations, their part of exhaustion's, least information found, accuracy")
    for name in ("p3p", "up2p"):
        first = len(rows)
        for n in options.sizes:
            report(measure(name, n, n, 0, seeds))
        if len(options.sizes) > 1:
            exponents[name] = growth(rows[first:])
        report(measure(name, 10, 10, 10, seeds))
    if options.data is None:
        print("no headset: name the folder of the data by --data or ROOTMATCH_DATA", file=sys.stderr)
    else:
        for row in headset(Path(options.data)):
            report(row)
    if options.json:
        print(json.dumps({"seeds": list(seeds), "rows": [asdict(row) for row in rows], "exponents": exponents}))
    else:
        for name, exponent in exponents.items():
            grown = f"evaluations grow as n^{exponent['evaluations']:.1f}, time as n^{exponent['seconds']:.1f}"
            print(f"{name}: {grown} (n points, n outliers)")


if __name__ == "__main__":
    main()
