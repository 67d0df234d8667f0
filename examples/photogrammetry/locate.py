"""A COLMAP model in, images placed in it, a model out: ``python locate.py MODEL DETECTIONS.csv… --output FOLDER``

MODEL holds cameras.txt and points3D.txt; each table of detections has columns x,y[,sigma] in COLMAP's pixels.
"""

import argparse
from pathlib import Path

import numpy as np

import rootmatch as rm
from rootmatch.report.colmap import write_colmap


def main():
    """Match each image to the points of the model, and write those that can be trusted."""
    ask = argparse.ArgumentParser()
    ask.add_argument("model", type=Path)
    ask.add_argument("detections", type=Path, nargs="+")
    ask.add_argument("--output", type=Path, required=True)
    ask.add_argument("--noise", type=float, default=0.5)
    asked = ask.parse_args()

    (camera,) = rm.read_cameras(asked.model / "cameras.txt").values()
    size = tuple(int(cell) for cell in (asked.model / "cameras.txt").read_text().split("\n")[0].split()[2:4])
    table = np.loadtxt(asked.model / "points3D.txt", usecols=(0, 1, 2, 3), ndmin=2)
    ids, points = table[:, 0].astype(int), table[:, 1:]
    matcher = rm.Matcher(points, rm.P3P(camera), noise=asked.noise)
    placed = {}
    for path in asked.detections:
        rows = np.genfromtxt(path, delimiter=",", names=True)
        sigma = rows["sigma"] if "sigma" in rows.dtype.names else None
        match = matcher.match(np.column_stack([rows["x"], rows["y"]]), noise=sigma)
        print(f"{path.stem}: {len(match.pairs)} targets, {match.advice}")
        if match:
            placed[f"{path.stem}.jpg"] = match
    write_colmap(asked.output, placed, ids=ids, size=size)
    print(f"{len(placed)} of {len(asked.detections)} images in {asked.output}")


if __name__ == "__main__":
    main()
