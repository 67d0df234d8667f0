"""One image of a body, of which one point is elsewhere: it was moved, or the image shows something else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.arrays import Floats
from rootmatch.model.copy_or_alike import log_odds_of_points_elsewhere

CAMERA, SIGMA = rm.Camera(1000.0, 1000.0, 640.0, 480.0, size=(1280, 960)), 0.4
UPRIGHT = rm.UP2P(CAMERA, vertical_camera=(0.0, 1.0, 0.0), vertical_world=(0.0, 1.0, 0.0))
POSE = Rotation.from_rotvec((0.0, 0.4, 0.0)).as_matrix(), np.array((0.3, 0.8, 4.0))
FRONT = np.array([(-0.35, -0.2, 0.0), (0.3, -0.3, 0.0), (-0.1, -0.85, 0.0), (0.25, -0.7, 0.0), (-0.3, -0.6, 0.0)])
"""Five reflectors on the front of a trolley."""
OTHER = FRONT + 0.05 * (np.arange(5) == 3)[:, None] * (1.0, 0.0, 0.0)
"""Those of another kind: one is a hole to the right."""


def pixels(points: Floats, strays: int, seed: int = 0) -> Floats:
    """Detections of points, then strays."""
    rng, (R, t) = np.random.default_rng(seed), POSE
    own = CAMERA.project(points @ R.T + t) + rng.normal(0.0, SIGMA, (len(points), 2))
    return np.vstack([own, rng.uniform((0.0, 0.0), (1280.0, 960.0), (strays, 2))])


def matched(target: Floats, **more: Any) -> rm.Match:
    """The first kind."""
    return rm.match(FRONT, target, UPRIGHT, noise=SIGMA, **more)


def log_odds(match: rm.Match) -> float:
    """Of something else."""
    found = match.finding
    assert found.model is not None
    assert found.posterior is not None
    return log_odds_of_points_elsewhere(found.model, found.posterior.modes, found.mode)


@pytest.mark.parametrize("strays", [0, 3])
def test_one_point_elsewhere_is_seldom_of_something_else(strays: int) -> None:
    """It was moved with .05 (`INEXACT`), and is of something else with .001 / 2 (`WRONG_MODEL`, `ANOTHER`)."""
    match = matched(pixels(OTHER, strays))
    assert match.status is rm.Status.MATCHED
    assert match.assignment.tolist() == [0, 1, 2, -1, 4]
    assert "point 3 seems displaced" in match.advice
    assert np.log(0.005) < log_odds(match) < np.log(0.01)
    assert match.probability == pytest.approx(1.0 - np.exp(log_odds(match)), abs=3e-3)
    doubted = matched(pixels(OTHER, strays), min_probability=0.995)
    assert not doubted
    assert "another object that differs in a point" in doubted.advice


def test_the_denser_the_clutter_the_more_probably_it_is_a_stray() -> None:
    few, many = matched(pixels(OTHER, 0)), matched(pixels(OTHER, 80))
    assert few.assignment.tolist() == many.assignment.tolist() == [0, 1, 2, -1, 4]
    assert log_odds(many) < log_odds(few) - 1.0


def test_a_point_that_is_hidden_tells_nothing() -> None:
    target = np.delete(pixels(FRONT, 3), 3, axis=0)
    match = matched(target, min_probability=0.995)
    assert match
    assert log_odds(match) == -np.inf


def test_the_other_kind_is_named_where_it_is_given() -> None:
    kinds = ["first"] * 5 + ["other"] * 5
    match = rm.match(np.vstack([FRONT, OTHER]), pixels(OTHER, 3), UPRIGHT, noise=SIGMA, bodies=kinds)
    assert match.bodies is not None
    assert not match.bodies["first"]
    assert match.bodies["other"]
    assert match.bodies["other"].assignment.tolist() == [0, 1, 2, 3, 4]


def test_what_is_where_the_body_was_expected_is_the_body() -> None:
    R, t = POSE
    prior = rm.Pose(R, t, np.diag([0.01**2] * 3 + [0.03**2] * 3))
    match = matched(pixels(OTHER, 3), prior=prior, min_probability=0.995)
    assert match
    assert match.finding.another == -np.inf
