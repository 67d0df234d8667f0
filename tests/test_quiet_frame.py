"""A frame in which a followed body is where it is expected: it is a thousand small steps, which are counted."""

from __future__ import annotations

import sys
from types import FrameType

import numpy as np
from scipy.spatial.transform import Rotation

import rootmatch as rm

MOST_CALLS = 2000
"""Of Python and C functions in one frame: 1,700 when this was written. Each takes about .8 µs."""
CAMERA = rm.Camera.from_opencv_fisheye(
    [[420.0, 0.0, 640.0], [0.0, 420.0, 480.0], [0.0, 0.0, 1.0]], [0.1, 0.01, 0.0, 0.0]
)


def frame(points: np.ndarray, k: int, rng: np.random.Generator) -> np.ndarray:
    """Detections of a body that turns slowly, of some of its points, with a stray one."""
    R = Rotation.from_rotvec([0.1, 0.01 * k, 0.2]).as_matrix()
    pixels = CAMERA.project(points @ R.T + [0.02 * k, 0.0, 1.5])
    shown = rng.permutation(len(points))[:7]
    return np.vstack([pixels[shown] + rng.normal(0.0, 0.3, (7, 2)), rng.uniform(100.0, 800.0, (1, 2))])


def test_a_quiet_frame_is_few_steps() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.2, 0.2, (8, 3))
    tracker, calls = rm.Tracker(points, rm.P3P(CAMERA), noise=0.3), list[int]()

    def count(_: FrameType, event: str, __: object) -> None:
        calls[-1] += event in ("call", "c_call")

    for k in range(40):
        target = frame(points, k, rng)
        calls.append(0)
        sys.setprofile(count)
        try:
            match = tracker.update(target, time=k / 60.0)
        finally:
            sys.setprofile(None)
        assert match.status is rm.Status.MATCHED
    assert np.median(calls[20:]) < MOST_CALLS
