"""What was not in view a moment ago: a tracker of tools in space asks more of a frame that shows little of it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import rootmatch as rm
from rootmatch.model.priors import PRESENT
from rootmatch.tracking.followed_body import RETURN, FollowedBody, TrackingOptions

Floats = NDArray[np.float64]
TOOL = np.random.default_rng(13).uniform(-0.08, 0.08, (5, 3))
SIGMA = 0.0006


def targets(seed: int, shown: int) -> Floats:
    """Some markers of the tool, and strays."""
    rng = np.random.default_rng(seed)
    strays = rng.uniform((-0.6, -0.4, 0.9), (0.6, 0.4, 1.8), (24, 3))
    place = np.array([0.0, 0.0, 1.2])
    return np.concatenate([TOOL[:shown] + place + rng.normal(0.0, SIGMA, (shown, 3)), strays])


def test_three_markers_are_a_tool_only_where_one_may_be() -> None:
    """Their triangle may well be one of strays, in the hundreds of frames that show nothing of the tool."""
    alone = rm.match(TOOL, targets(2, 3), rm.Rigid(3), noise=SIGMA)
    assert alone.status is rm.Status.MATCHED
    tracker = rm.Tracker(TOOL, rm.Rigid(3), noise=SIGMA)
    assert not tracker.update(targets(1, 0), time=0.0)
    assert not tracker.update(targets(2, 3), time=0.01)
    assert tracker.update(targets(3, 5), time=0.02), "five markers are no accident"
    assert tracker.update(targets(4, 3), time=0.03), "where it was a moment ago, three suffice"


def test_time_makes_its_return_probable() -> None:
    body = FollowedBody(TOOL, TrackingOptions())
    assert body.present(5.0) is None
    body.presence = 0.02, 5.0
    assert body.present(5.0) == pytest.approx(0.02)
    assert body.present(5.0 + RETURN) == pytest.approx(PRESENT + (0.02 - PRESENT) / np.e)
    assert body.present(1e6) == pytest.approx(PRESENT)
