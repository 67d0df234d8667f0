"""How often an answer with some margin is right, from the scenes that `accuracy.py --csv` wrote; table, picture.

Beside it is the probability 1 / (2 − margin) that the margin tells.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import math
from pathlib import Path

import numpy as np

EDGES = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0]
"""Bounds of the bins of the margin."""


def interval(right: int, count: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927)."""
    z = 1.96
    middle = (right + z * z / 2) / (count + z * z)
    half = z / (count + z * z) * math.sqrt(right * (count - right) / count + z * z / 4)
    return middle - half, middle + half


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("csv", type=Path, nargs="+")
    parser.add_argument("--picture", type=Path, help="where the reliability plot goes")
    options = parser.parse_args()
    rows = [row for path in options.csv for row in csv.DictReader(path.open(newline=""))]
    # with several motions the margin is that of the doubtful one; a prior that does not hold is the user's
    rows = [row for row in rows if row["status"] != "untrusted" and row["rand"] == "nan" and "prior" not in row["case"]]
    margin = np.array([float(row["margin"]) for row in rows])
    right = np.array([float(row["right"]) for row in rows])
    shown = np.array([float(row["shown"]) for row in rows])
    print(
        f"{len(rows)} scenes\n\n| margin | scenes | probability | right | 95 % interval | truth shown |\n"
        "| --- | --- | --- | --- | --- | --- |"
    )
    drawn = []
    for low, high in itertools.pairwise(EDGES):
        inside = (margin >= low) & ((margin < high) | (high == EDGES[-1]))
        count = int(inside.sum())
        if count:
            least, most = interval(int(right[inside].sum()), count)
            drawn.append((float(margin[inside].mean()), float(right[inside].mean()), least, most))
            print(
                f"| {low:g} – {high:g} | {count} | {(1.0 / (2.0 - margin[inside])).mean():.3f} |"
                f" {right[inside].mean():.3f} | {least:.3f} – {most:.3f} | {shown[inside].mean():.3f} |"
            )
    print("\n| least margin | matched | right | ambiguous | truth shown |\n| --- | --- | --- | --- | --- |")
    for least in (0.2, 0.4, 0.6, 0.7, 0.8, 0.85, 0.889, 0.9, 0.95, 0.98):
        told, doubtful = margin >= least, margin < least
        print(
            f"| {least:g} | {told.sum()} | {right[told].mean():.4f} | {doubtful.sum()} |"
            f" {shown[doubtful].mean() if doubtful.any() else math.nan:.4f} |"
        )
    if options.picture is not None:
        import matplotlib

        matplotlib.use("Agg")
        import matplotlib.pyplot as plt

        x, y, below, above = np.array(drawn).T
        figure, axes = plt.subplots(figsize=(5.0, 3.6), layout="constrained")
        axes.errorbar(x, y, yerr=[y - below, above - y], marker="o", capsize=3)
        told = np.linspace(0.0, 1.0, 101)
        axes.plot(told, 1.0 / (2.0 - told), color="grey", linestyle=":", label="1 / (2 − margin)")
        axes.set(xlabel="margin", ylabel="part of the answers that are right", ylim=(0.0, 1.02), xlim=(0.0, 1.0))
        axes.legend()
        figure.savefig(options.picture, dpi=120)


if __name__ == "__main__":
    main()
