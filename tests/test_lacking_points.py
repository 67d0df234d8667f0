"""Bodies that lack points by their own law: the pose that puts another point there is not trusted."""

from __future__ import annotations

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.algebra.rotation import one_rotation_matrix
from rootmatch.explain.lacking_points import lacking_points

CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0, size=(1280, 960))
CORNERS = (np.stack(np.meshgrid(*[(0, 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) - 0.5) * (0.3, 0.2, 0.25)
MARK = np.array([[0.05, 0.1, -0.2]])
NOISE = 0.25


def test_a_box_of_seven_corners_has_eight_and_a_landmark_stands_alone() -> None:
    lacking = lacking_points(np.concatenate([CORNERS[1:], MARK]), None)
    best = int(lacking.chance.argmax())
    np.testing.assert_allclose(lacking.places.points[best], CORNERS[0], atol=1e-9)
    assert lacking.chance[best] > 0.5
    assert (np.delete(lacking.chance, best) < 0.1).all()
    assert (lacking_points(np.concatenate([CORNERS, MARK]), None).chance < 0.05).all()


def test_nothing_is_lacked_where_one_law_holds_or_none() -> None:
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (12, 3))
    assert not len(lacking_points(points, None).chance)
    both = np.concatenate([points, points * (-1.0, -1.0, 1.0)])
    assert not len(lacking_points(both[1:], None).chance)  # as likely, its partner is a landmark


@pytest.mark.parametrize("seed", range(2))
def test_half_a_turn_that_puts_a_corner_where_the_body_lacks_one_is_not_trusted(seed: int) -> None:
    """Before, it was trusted: in the true pose that corner is a stray."""
    rng = np.random.default_rng(seed)
    R = one_rotation_matrix(rng.normal(0.0, 1.0, 3))
    source, turned = np.concatenate([CORNERS[1:], MARK]), CORNERS[0] * (-1.0, -1.0, 1.0)
    seen = CORNERS[np.linalg.norm(CORNERS - turned, axis=1) > 0.01]
    target = CAMERA.project(seen @ R.T + (0.0, 0.0, 1.0)) + rng.normal(0.0, NOISE, (7, 2))
    assert rm.match(source, target, rm.P3P(CAMERA), noise=NOISE).status == rm.Status.AMBIGUOUS


def test_with_its_landmark_in_view_the_body_is_trusted() -> None:
    rng = np.random.default_rng(0)
    R = one_rotation_matrix(rng.normal(0.0, 1.0, 3))
    every = np.concatenate([CORNERS, MARK])
    target = CAMERA.project(every @ R.T + (0.0, 0.0, 1.0)) + rng.normal(0.0, NOISE, (9, 2))
    match = rm.match(every[1:], target, rm.P3P(CAMERA), noise=NOISE)
    assert match
    assert (match.assignment == np.arange(1, 9)).all()
