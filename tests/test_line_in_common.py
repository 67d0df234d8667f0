"""An upright camera sees the points of one edge of a body, and none of its others: that edge may be another body's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.arrays import Floats
from rootmatch.explain.line_in_common import log_odds_of_line
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.proposals import solve_minimal_sets
from rootmatch.problems.base import Problem

CAMERA, SIGMA = rm.Camera(1100.0, 1100.0, 640.0, 480.0, size=(1280, 960)), 0.3
VERTICALS = {"vertical_camera": (0.0, 1.0, 0.0), "vertical_world": (0.0, 0.0, -1.0)}
UPRIGHT = rm.UP2P(CAMERA, **VERTICALS)
ZOOMED = rm.UP2PF((640.0, 480.0), **VERTICALS)
EDGE = np.outer((-0.6, -0.35, 0.05, 0.3, 0.6), (1.0, 0.2, 0.3))
OTHERS = np.random.default_rng(3).uniform(-0.7, 0.7, (11, 3))
MAST = np.vstack([EDGE, OTHERS])
POSE = Rotation.from_euler("zx", (25.0, 90.0), degrees=True).as_matrix(), np.array((0.1, 0.1, 2.6))


def pixels(which: list[int], strays: int = 4) -> Floats:
    """Detections of some points, then strays."""
    rng, (R, t) = np.random.default_rng(1), POSE
    own = CAMERA.project(MAST[which] @ R.T + t) + rng.normal(0.0, SIGMA, (len(which), 2))
    return np.vstack([own, rng.uniform((0.0, 0.0), (1280.0, 960.0), (strays, 2))])


def log_odds(match: rm.Match) -> float:
    """Of something else that shares a line."""
    found = match.finding
    assert isinstance(found.model, DetectionModel)
    assert found.posterior is not None
    return log_odds_of_line(found.model, found.posterior.modes, found.mode)


@pytest.mark.parametrize("problem", [UPRIGHT, ZOOMED])
def test_one_edge_alone_may_be_of_something_else(problem: Problem) -> None:
    match = rm.match(MAST, pixels([0, 1, 2, 3, 4]), problem, noise=SIGMA)
    assert match.assignment[:5].tolist() == [0, 1, 2, 3, 4]
    assert not match
    assert log_odds(match) > -2.0
    assert "another object" in match.advice


@pytest.mark.parametrize("problem", [UPRIGHT, ZOOMED])
def test_the_edge_with_others_is_of_the_body(problem: Problem) -> None:
    match = rm.match(MAST, pixels([0, 1, 2, 3, 4, 6, 9]), problem, noise=SIGMA)
    assert match
    assert match.assignment[[0, 1, 2, 3, 4, 6, 9]].tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert log_odds(match) == -np.inf


def test_a_triple_on_a_line_proposes_rotations() -> None:
    """Its frame has a rounding error for a third axis; what was no rotation had any evidence."""
    model = DetectionModel(CAMERA, MAST, pixels([0, 1, 2, 3, 4]), np.full(9, SIGMA))
    labels = np.full((3, len(MAST)), -1)
    for row, own in zip(labels, ([0, 1, 2], [0, 2, 4], [1, 2, 3, 4]), strict=True):
        row[own] = own
    sets = solve_minimal_sets(model, labels, 4).proposals
    assert np.allclose(sets.rotation @ sets.rotation.swapaxes(1, 2), np.eye(3), atol=1e-6)
