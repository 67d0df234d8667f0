"""Bodies that repeat themselves: another one on the same squares is not trusted, and the body's own part of more is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.algebra.rotation import one_rotation_matrix
from rootmatch.arrays import Floats, Integers
from rootmatch.explain import continued_bodies
from rootmatch.explain.continued_bodies import continue_body
from rootmatch.model.evidence import weigh_poses

CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0, size=(1280, 960))
SQUARE, NOISE = 0.03, 0.2


def board(rng: np.random.Generator, columns: int, rows: int, holes: int) -> Floats:
    """Corners of a board, some of them missing."""
    x, y = np.meshgrid(SQUARE * np.arange(columns), SQUARE * np.arange(rows))
    every = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return every[np.sort(rng.permutation(len(every))[holes:])]


def image(rng: np.random.Generator, points: Floats) -> tuple[Floats, Integers]:
    """Shuffled detections of points with four others, and the detection of each point, −1 for none."""
    R = one_rotation_matrix(rng.normal(0.0, 0.4, 3))
    pixels = CAMERA.project(points @ R.T + rng.uniform((-0.13, -0.1, 0.5), (-0.07, -0.04, 0.6)))
    seen = (pixels > 0.0).all(axis=1) & (pixels < (1280.0, 960.0)).all(axis=1) & (rng.random(len(points)) < 0.95)
    every = np.concatenate([pixels[seen], rng.uniform((0.0, 0.0), (1280.0, 960.0), (4, 2))])
    order = rng.permutation(len(every))
    truth = np.full(len(points), -1)
    truth[seen] = np.argsort(order)[: seen.sum()]
    return every[order] + rng.normal(0.0, NOISE, every.shape), truth


def test_a_board_continues_on_its_squares() -> None:
    x, y = (one.ravel() for one in np.meshgrid(np.arange(6.0), np.arange(5.0)))
    corners = np.column_stack([x, y, np.zeros(30)])
    hole, mark = (corners[:, :2] == (2.0, 3.0)).all(axis=1), np.array([[1.4, 2.3, 0.7]])
    places = continue_body(np.concatenate([corners[~hole], mark]), None)
    np.testing.assert_allclose(places.points, np.round(places.points), atol=1e-9)  # and the mark is not continued
    assert len(np.unique(np.round(places.points), axis=0)) == len(places.points) > 60
    np.testing.assert_allclose(places.points[~places.beyond], [[2.0, 3.0, 0.0]], atol=1e-9)


def test_what_repeats_nothing_or_turns_into_itself_has_no_places() -> None:
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (12, 3))
    assert not len(continue_body(points, None).points)
    both = np.concatenate([points, points * (-1.0, -1.0, 1.0)])
    assert not len(continue_body(both, None).points)


def test_what_is_nearly_regular_leads_to_each_place_once() -> None:
    """Each motion leads a little beside where another one does; there were up to three points in a place."""
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(np.arange(6) * 5.0, np.arange(8) * 3.0, [0.0]), axis=3).reshape(-1, 3)
    trees = grid + rng.normal(0.0, 0.03, grid.shape) * (1.0, 1.0, 0.0)
    places = continue_body(trees[rng.random(len(trees)) > 0.1], None).points
    distance = np.linalg.norm(places[:, None] - places, axis=2) + 10.0 * np.eye(len(places))
    assert len(places) > len(trees)
    assert distance.min() > 0.7  # a quarter of the distance of two trees


def test_another_board_on_the_same_squares_is_not_trusted() -> None:
    """Before, 7 of 8 were: the border of the board told its place, though rows go on beyond it."""
    told = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        source = board(rng, 8, 6, 6)
        target, _ = image(rng, board(rng, *((10, 8), (9, 6))[seed % 2], 6))
        match = rm.match(source, target, rm.P3P(CAMERA), noise=NOISE)
        assert not match
        told.append("same repeating pattern" in match.advice)
    assert sum(told) >= 3


@pytest.mark.parametrize("seed", [1, 10])
def test_a_board_of_the_same_size_with_some_of_the_same_corners_missing_is_not_trusted(seed: int) -> None:
    """Before, these two of seeds 0 to 13 were: three corners of 42 are not there, two or three strays are in holes."""
    rng = np.random.default_rng(seed)
    whole = board(rng, 8, 6, 0)
    order = rng.permutation(48)
    own, other = np.sort(order[6:]), np.sort([*order[:3], *order[9:]])
    target, _ = image(rng, whole[other])
    match = rm.match(whole[own], target, rm.P3P(CAMERA), noise=NOISE)
    assert match.status is not rm.Status.MATCHED
    target, truth = image(rng, whole[own])
    match = rm.match(whole[own], target, rm.P3P(CAMERA), noise=NOISE)
    assert match.status is rm.Status.MATCHED
    assert (match.assignment == truth).mean() > 0.95


@pytest.mark.parametrize("turn", [0.0, 22.5, 45.0, 67.5])
def test_another_board_in_the_predicted_place_is_not_trusted(turn: float) -> None:
    """Before, it was with .995 if turned between the edges of an octagon, beyond which rows showed nothing."""
    rng = np.random.default_rng(3)
    source, points = board(rng, 7, 5, 0), board(rng, 8, 6, 0)
    R = one_rotation_matrix(np.radians([15.0, -10.0, 0.0])) @ one_rotation_matrix(np.radians([0.0, 0.0, turn]))
    t = np.array([0.0, 0.0, 0.6]) - R @ points.mean(axis=0)
    target = np.concatenate([CAMERA.project(points @ R.T + t), rng.uniform((0.0, 0.0), (1280.0, 960.0), (3, 2))])
    target += rng.normal(0.0, NOISE, target.shape)
    prior = rm.Pose(R, t, np.diag([0.02**2] * 3 + [0.005**2] * 3))
    match = rm.match(source, target, rm.P3P(CAMERA), noise=NOISE, prior=prior)
    assert not match
    assert match.probability is not None
    assert match.probability < 0.5


def test_the_board_is_trusted_and_so_is_a_part_of_a_larger_one() -> None:
    for seed in range(2):
        rng = np.random.default_rng(seed)
        whole = board(rng, 11, 9, 18)
        own = (whole[:, 0] < 7.5 * SQUARE) & (whole[:, 1] < 5.5 * SQUARE)
        for source, points in ((whole[own], whole[own]), (whole[own], np.concatenate([whole[own], whole[~own]]))):
            target, truth = image(rng, points)
            match = rm.match(source, target, rm.P3P(CAMERA), noise=NOISE)
            assert match
            assert (match.assignment == truth[: len(source)]).all()


def test_places_that_the_pose_cannot_see_leave_a_probability(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are matched from a pose nearby: one of 60 images of a row of towers had a probability of NaN."""

    def of_unseen(*given: Any) -> Any:
        found, at = weigh_poses(*given)
        nothing = np.full_like(found.log_odds, -np.inf)
        return found._replace(log_odds=nothing, detected=nothing), at

    rng = np.random.default_rng(0)
    source = board(rng, 8, 6, 6)
    target, _ = image(rng, board(rng, 10, 8, 6))
    monkeypatch.setattr(continued_bodies, "weigh_poses", of_unseen)
    match = rm.match(source, target, rm.P3P(CAMERA), noise=NOISE)
    assert match.probability is not None
    assert 0.0 < match.probability < 1.0
