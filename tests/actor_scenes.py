"""Actors before a rig: small bodies of few markers, several of each shape, of which cameras show four or five."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm

Floats = NDArray[np.float64]
HEAD = np.array([[0.09, 0.0, 0.0], [-0.08, 0.03, 0.02], [0.0, 0.1, 0.03], [0.02, -0.09, 0.05], [0.0, 0.0, 0.13]])
HIP = np.array([[0.14, 0.1, 0.0], [-0.14, 0.1, 0.01], [0.1, -0.12, 0.02], [-0.09, -0.12, 0.0]])
CAMERA, SIZE, SIGMA = rm.Camera(900.0, 900.0, 640.0, 480.0), (1280, 960), 0.25


def view(angle: float) -> tuple[Floats, Floats]:
    """A camera 4 m away at this angle, 2.2 m high, that looks at the middle of a stage."""
    eye = np.array([4.0 * np.cos(angle), 4.0 * np.sin(angle), 2.2])
    ahead = np.array([0.0, 0.0, 1.3]) - eye
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    R = np.array([one / np.linalg.norm(one) for one in (right, np.cross(ahead, right), ahead)])
    return R, -R @ eye


class Stage:
    """Three actors with five markers on the head and four on the hip, each some millimetres from a common layout."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([seed, 8])
        views = [view(angle) for angle in rng.uniform() + np.array([0.0, 1.4])]
        self.rig = rm.Rig([(CAMERA, R, t) for R, t in views], sizes=[SIZE, SIZE])
        points, self.labels, seen = [], [], []
        for actor in range(3):
            floor, turn = rng.uniform(-1.0, 1.0, 2), Rotation.from_rotvec([0.0, 0.0, rng.uniform(-3.0, 3.0)])
            for part, layout, height in (("head", HEAD, 1.65), ("hip", HIP, 1.0)):
                points.append(layout + 0.006 * rng.normal(size=layout.shape))
                R = (turn * Rotation.from_rotvec(0.2 * rng.normal(size=3))).as_matrix()
                seen.append(points[-1] @ R.T + (*floor, height))
                self.labels += [f"{part} {actor}"] * len(layout)
        self.source = np.concatenate(points)
        rows = []
        for camera, (R, t) in enumerate(views):
            pixels = CAMERA.project(np.concatenate(seen) @ R.T + t)
            for point, pixel in enumerate(pixels):
                if rng.random() < 0.85 and (pixel > 0.0).all() and (pixel < SIZE).all():
                    rows.append((*(pixel + SIGMA * rng.normal(size=2)), camera, point))
            rows += [(*rng.uniform(0.0, SIZE), camera, -1) for _ in range(2)]
        every = rng.permutation(np.array(rows))
        self.rows, self.truth = every[:, :3], np.full((2, len(self.source)), -1)
        of_points = np.flatnonzero(every[:, 3] >= 0.0)
        self.truth[tuple(every[of_points, 2:].astype(int).T)] = of_points

    def match(self) -> rm.Match:
        """What is found of all bodies."""
        return rm.match(self.source, self.rows, rm.P3P(self.rig), noise=SIGMA, bodies=self.labels)

    def truth_of(self, name: str) -> NDArray[np.int64]:
        """The detections (2, n) of one body's points in each camera, −1 for none."""
        return self.truth[:, np.array(self.labels) == name]
