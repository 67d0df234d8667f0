"""How often an assignment of some probability is right, and a match of some confidence; tables, picture.

From the scenes that `accuracy.py --csv` and `constellations.py --csv` wrote. The probability of a match that is trusted
is that of the matches that it keeps, so it is right where none of them is wrong; that of another one is of the whole
assignment, which is right where it is the truth, point for point.

python benchmarks/accuracy.py --first-seed 20000 --seeds 100 --no-yardstick --csv accuracy.csv
python benchmarks/reliability.py accuracy.csv --picture docs/reliability.png
"""

from __future__ import annotations

import argparse
import csv
import itertools
import math
from pathlib import Path

import numpy as np

EDGES = [0.0, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 0.999, 1.0]
"""Bounds of the bins of the probability."""
BINS = np.linspace(0.0, 1.0, 11)
"""Bounds of the bins of the confidence."""
WITHIN = 0.03
"""Of the bin the share that is right is to be, or else the mean in its interval."""
LEAST = [0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99]
"""Thresholds of "matched" that are compared."""


def interval(right: float, count: float) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927); ``count`` may be effective, see `effective`."""
    z = 1.96
    middle = (right + z * z / 2) / (count + z * z)
    half = z / (count + z * z) * math.sqrt(max(right * (count - right) / count, 0.0) + z * z / 4)
    return middle - half, middle + half


def effective(counts: np.ndarray) -> float:
    """As many independent points as groups of so many tell that are right or wrong together (Kish 1965)."""
    return float(counts.sum() ** 2 / (counts**2).sum())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("csv", type=Path, nargs="+")
    parser.add_argument("--picture", type=Path, help="where the reliability plot goes")
    options = parser.parse_args()
    rows = [row for path in options.csv for row in csv.DictReader(path.open(newline=""))]
    points = confidences(rows)
    rows = [row for row in rows if "probability" in row]
    trusted = [row for row in rows if row["status"] != "untrusted"]
    rows = [row for row in trusted if row["probability"] != "nan"]
    probability = np.array([float(row["probability"]) for row in rows])
    right = np.array([is_as_told(row) for row in rows], dtype=float)
    shown = np.array([float(row["shown"]) for row in rows])
    print(
        f"{len(rows)} scenes with a probability, of {len(trusted)} matched or ambiguous ones\n\n"
        "| probability | scenes | mean | right | 95 % interval | truth listed |\n| --- | --- | --- | --- | --- | --- |"
    )
    drawn = []
    for low, high in itertools.pairwise(EDGES):
        inside = (probability >= low) & ((probability < high) | (high == EDGES[-1]))
        count = int(inside.sum())
        if count:
            least, most = interval(int(right[inside].sum()), count)
            drawn.append((float(probability[inside].mean()), float(right[inside].mean()), least, most))
            print(
                f"| {low:g} – {high:g} | {count} | {probability[inside].mean():.4f} |"
                f" {right[inside].mean():.4f} | {least:.3f} – {most:.3f} | {shown[inside].mean():.4f} |"
            )
    print("\n| matched from | matched | right | ambiguous | truth listed |\n| --- | --- | --- | --- | --- |")
    for least in LEAST:
        sure, doubtful = probability >= least, probability < least
        print(
            f"| {least:g} | {sure.sum()} | {right[sure].mean():.4f} | {doubtful.sum()} |"
            f" {shown[doubtful].mean() if doubtful.any() else math.nan:.4f} |"
        )
    print("\n| status | scenes | right | truth listed |\n| --- | --- | --- | --- |")
    for status in ("matched", "ambiguous"):
        some = [row for row in rows if row["status"] == status]
        if some:
            listed = np.mean([float(row["shown"]) for row in some])
            print(f"| {status} | {len(some)} | {np.mean([is_as_told(row) for row in some]):.4f} | {listed:.4f} |")
    if options.picture is not None:
        picture(np.array(drawn), points, options.picture)


def is_as_told(row: dict[str, str]) -> bool:
    """Whether that is right of a scene's match whose probability is told."""
    return float(row["precision"] if row["status"] == "matched" else row["whole"]) == 1.0


def confidences(rows: list[dict[str, str]]) -> np.ndarray:
    """Table of the points of all scenes by confidence; mean, share that is right and its interval, (B, 4).

    Points of one scene are right or wrong together where its pose is, so the interval is that of the scenes.
    """
    every = [(scene, pair.split("/")) for scene, row in enumerate(rows) for pair in row.get("points", "").split()]
    known = np.array([(float(c), float(good), scene) for scene, (c, good) in every if c != "nan"]).reshape(-1, 3)
    print(f"{len(known)} points with a confidence, of {len(every)} in {len(rows)} scenes of any status\n")
    print("| confidence | points | scenes | mean | right | 95 % interval | as told |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    drawn = []
    for low, high in itertools.pairwise(BINS):
        inside = known[(known[:, 0] >= low) & ((known[:, 0] < high) | (high == BINS[-1]))]
        if len(inside):
            mean, good, _ = inside.mean(axis=0)
            scenes = np.unique(inside[:, 2], return_counts=True)[1]
            count = effective(scenes)
            least, most = interval(good * count, count)
            drawn.append((mean, good, least, most))
            held = low - WITHIN <= good <= high + WITHIN or least <= mean <= most
            print(
                f"| {low:.1f} – {high:.1f} | {len(inside)} | {len(scenes)} | {mean:.4f} | {good:.4f} |"
                f" {least:.3f} – {most:.3f} | {'yes' if held else 'no'} |"
            )
    print()
    return np.array(drawn)


def picture(drawn: np.ndarray, points: np.ndarray, path: Path) -> None:
    """The reliability plot: mean of each bin against the share that is right, with its interval."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(5.0, 3.6), layout="constrained")
    axes.plot([0.0, 1.0], [0.0, 1.0], color="grey", linestyle=":", label="calibrated")
    curves = ((drawn.T, "o", "probability of a match"), (points.T, "s", "confidence of a point"))
    for (x, y, below, above), marker, label in curves:
        axes.errorbar(x, y, yerr=[y - below, above - y], marker=marker, capsize=3, label=label + ", 95 % interval")
    axes.axvline(0.9, color="grey", linewidth=0.8, label="matched from here on")
    axes.set(xlabel="probability or confidence", ylabel="share that is right", ylim=(0.0, 1.02), xlim=(0.0, 1.02))
    axes.legend(loc="lower right")
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main()
