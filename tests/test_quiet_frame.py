"""A frame in which a followed body is where it is expected: it is a thousand small steps, which are counted."""

from __future__ import annotations

import sys
from types import FrameType
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain import image_bodies

MAX_CALLS = 1380
"""Of Python and C functions in one frame: 1,372 when this was written. Each takes about .8 µs."""
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
    assert np.median(calls[20:]) < MAX_CALLS


def test_a_search_that_finds_nothing_tells_anew_of_the_body_searched_for_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, told = np.random.default_rng(5), list[object]()
    points = rng.uniform(-0.2, 0.2, (2, 8, 3))
    tracker = rm.Tracker(points.reshape(-1, 3), rm.P3P(CAMERA), noise=0.3, bodies=np.repeat([0, 1], 8))
    work = image_bodies.image_finding

    def counted(base: Any, *rest: Any, **more: Any) -> Any:
        told.append(base)
        return work(base, *rest, **more)

    monkeypatch.setattr(image_bodies, "image_finding", counted)
    after_search = []
    for k in range(60):
        shown = [frame(points[0], k, rng)]
        if k < 5:
            R = Rotation.from_rotvec([0.1, 1.0, 0.0]).as_matrix()
            shown.append(CAMERA.project(points[1] @ R.T + [-0.7, 0.0, 1.5]))
        else:
            shown.append(rng.uniform(100.0, 800.0, (7, 2)))  # stray ones in its place
        told.clear()
        match = tracker.update(np.vstack(shown), time=k / 60.0)
        assert match.bodies is not None
        body = tracker._bodies[1]
        if body.served == tracker._frame and k > 5 and not match.bodies[1]:
            after_search.append(len(told))
    assert after_search
    assert min(after_search) == 3
