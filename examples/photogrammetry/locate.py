"""A COLMAP model in, images placed in it, a model out: ``python locate.py MODEL DETECTIONS.csv… --output FOLDER``

MODEL holds cameras.txt and points3D.txt; each table of detections has columns x,y[,sigma] in COLMAP's pixels. If the
model has several cameras, ``--camera ID`` says which one took the images.
"""

import argparse
from pathlib import Path

import numpy as np

import rootmatch as rm
from rootmatch.report.colmap import write_colmap


def size_of(path, camera):
    """Width and height of the images of a camera, in pixels."""
    rows = [line.split() for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")]
    return next((int(row[2]), int(row[3])) for row in rows if row[0] == camera)


def main():
    """Match each image to the points of the model, and write those that can be trusted."""
    ask = argparse.ArgumentParser()
    ask.add_argument("model", type=Path)
    ask.add_argument("detections", type=Path, nargs="+")
    ask.add_argument("--output", type=Path, required=True)
    ask.add_argument("--noise", type=float, default=0.5)
    ask.add_argument("--camera", help="id of the images' camera, if the model has several")
    asked = ask.parse_args()

    cameras = rm.read_cameras(asked.model / "cameras.txt")
    chosen = asked.camera if asked.camera is not None or len(cameras) > 1 else next(iter(cameras))
    if chosen not in cameras:
        ask.error(f"--camera: the cameras of the model are {', '.join(cameras)}; say which one took the images")
    camera, size = cameras[chosen], size_of(asked.model / "cameras.txt", chosen)
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
