"""A body that is found may be in several places: bodies that are lost are tried in each of them at once."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain.image_bodies import _Body

CAMERA = rm.Camera(800.0, 800.0, 320.0, 240.0)


def test_a_lost_body_is_tried_in_each_place_of_what_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise what was found is followed in the other body's place, of which no later frame shows anything."""
    rng, tried = np.random.default_rng(2), list[tuple[int, NDArray[np.bool_]]]()
    found, lost = rng.uniform(-0.08, 0.08, (2, 6, 3))
    tracker = rm.Tracker(np.concatenate([found, lost]), rm.P3P(CAMERA), noise=0.3, bodies=[0] * 6 + [1] * 6)
    tracker.update(rng.uniform((0.0, 0.0), (640.0, 480.0), (3, 2)))
    search = _Body.search

    def noted(body: _Body, *arguments: object) -> None:
        tried.append((body.number, body.free.copy()))
        search(body, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(_Body, "search", noted)
    for k in range(4):
        turns = [Rotation.from_rotvec([turn, 0.2 + 0.01 * k, 0.1]).as_matrix() for turn in (0.3, -0.4)]
        copies = [CAMERA.project(found @ R.T + (x, 0.0, 0.9)) for R, x in zip(turns, (-0.15, 0.15), strict=True)]
        match = tracker.update(np.concatenate([*copies, rng.uniform((0.0, 0.0), (640.0, 480.0), (2, 2))]))
        assert match.bodies is not None
        if match.bodies[0].status is rm.Status.AMBIGUOUS:
            break
    number, free = tried[-1]
    assert number == 1
    assert free[:12].all()
    assert not free[12:].any()
