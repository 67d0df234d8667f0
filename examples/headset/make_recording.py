"""A simulated recording of a headset and a hand controller: model, camera and detections of 600 frames as files.

    python examples/headset/make_recording.py recording            # a lens with OpenCV's distortion
    python examples/headset/make_recording.py recording --fisheye  # OpenCV's fisheye

The projection is OpenCV's own (the extra ``test``): the recording does not depend on the camera models that it is
tracked with.
"""

from __future__ import annotations

import argparse
import csv
import json
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

SIZE, FRAMES, RATE = np.array([1280, 960]), 600, 60.0
K = np.array([[700.0, 0.0, 640.0], [0.0, 700.0, 480.0], [0.0, 0.0, 1.0]])
BROWN = np.array([-0.18, 0.06, 0.0004, -0.0007, 0.0])
FISHEYE = np.array([0.06, -0.02, 0.007, -0.001])
NOISE, VIEW, CLUTTER, MISSED = 0.4, 65.0, 5, 0.05


def headset(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """26 LEDs on the front and the sides of a box with round edges, and their normals (metres)."""
    normals = rng.normal(size=(400, 3)) * (1.0, 0.8, 1.0)
    normals = normals[normals[:, 2] < 0.3]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    chosen = [0]
    while len(chosen) < 26:  # each as far as possible from those before
        far = np.linalg.norm(normals[:, None] - normals[chosen], axis=2).min(axis=1)
        chosen.append(int(far.argmax()))
    points = np.sign(normals[chosen]) * np.abs(normals[chosen]) ** 0.6 * (0.10, 0.06, 0.05)
    return points + rng.uniform(-0.004, 0.004, points.shape), normals[chosen]


def controller(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """22 LEDs on a ring."""
    angle = (np.arange(22) + rng.uniform(-0.3, 0.3, 22)) * (2.0 * np.pi / 22)
    out = np.column_stack([np.cos(angle), np.sin(angle), rng.uniform(-0.8, 0.8, 22)])
    points = np.column_stack([0.05 * out[:, :2] * rng.uniform(0.9, 1.1, (22, 1)), rng.uniform(-0.015, 0.015, 22)])
    return points, out / np.linalg.norm(out, axis=1, keepdims=True)


def pose(body: int, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation of a body."""
    s = np.sin(2.0 * np.pi * np.outer([0.11, 0.17, 0.23], [seconds]) + np.arange(3)[:, None] + 2.0 * body)[:, 0]
    turn = Rotation.from_rotvec(s * (0.6, 0.7, 0.3)) * Rotation.from_rotvec((0.9 * body, 0.4 * body, 0.0))
    return turn.as_matrix(), np.array([-0.25 + 0.5 * body, 0.05, 0.9 - 0.2 * body]) + 0.12 * s


def pixels(points: np.ndarray, R: np.ndarray, t: np.ndarray, fisheye: bool) -> np.ndarray:
    """Where OpenCV sees the points."""
    rotation = cv2.Rodrigues(R)[0]
    if fisheye:
        return cv2.fisheye.projectPoints(points[:, None], rotation, t, K, FISHEYE)[0][:, 0]
    return cv2.projectPoints(points, rotation, t, K, BROWN)[0][:, 0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--fisheye", action="store_true")
    parser.add_argument("--frames", type=int, default=FRAMES)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(1)
    bodies = {"headset": headset(rng), "controller": controller(rng)}
    with (given.folder / "model.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["body", "x", "y", "z", "nx", "ny", "nz"])
        for name, (points, normals) in bodies.items():
            writer.writerows([name, *place, *normal] for place, normal in zip(points, normals, strict=True))
    lens = {"fisheye": FISHEYE.tolist()} if given.fisheye else {"dist": BROWN.tolist()}
    (given.folder / "camera.json").write_text(json.dumps({"K": K.tolist(), **lens}) + "\n")
    with (
        (given.folder / "frames.csv").open("w", newline="") as file,
        (given.folder / "truth.csv").open("w", newline="") as true,
    ):
        frames, truth = csv.writer(file), csv.writer(true)
        frames.writerow(["frame", "x", "y"])
        truth.writerow(["frame", "body", "tx", "ty", "tz", "qx", "qy", "qz", "qw"])
        for k in range(given.frames):
            seen = [rng.uniform((0.0, 0.0), SIZE, (CLUTTER, 2))]
            for body, (name, (points, normals)) in enumerate(bodies.items()):
                R, t = pose(body, k / RATE)
                places = points @ R.T + t
                facing = -(normals @ R.T * places).sum(axis=1) / np.linalg.norm(places, axis=1)
                image = pixels(points, R, t, given.fisheye) + rng.normal(0.0, NOISE, (len(points), 2))
                shown = (facing > np.cos(np.radians(VIEW))) & (rng.random(len(points)) >= MISSED)
                seen.append(image[shown & (image > 0).all(axis=1) & (image < SIZE).all(axis=1)])
                truth.writerow([k, name, *t, *Rotation.from_matrix(R).as_quat()])
            detections = rng.permutation(np.concatenate(seen))
            frames.writerows([k, *place] for place in detections.round(3).tolist())


if __name__ == "__main__":
    main()
