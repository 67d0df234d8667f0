"""What a labelling loses: of a wall that looks like itself, the columns at its ends, or points amid others."""

from __future__ import annotations

import math

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.model.two_view_losses import log_loss_probability
from rootmatch.model.two_view_model import TwoViewModel

CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)
COLUMNS, ROWS = 8, 4


def wall() -> np.ndarray:
    """Places (32, 3) on a regular wall, column by column, y along the common direction."""
    x, y = np.meshgrid(0.8 * np.arange(COLUMNS), 0.6 * np.arange(ROWS), indexing="ij")
    return np.column_stack([x.ravel() - x.mean(), y.ravel() - y.mean(), np.zeros(x.size)])


def view(points: np.ndarray, place: tuple[float, float, float], turn: float) -> np.ndarray:
    """Points in the frame of a camera in some place, turned about y."""
    c, s = math.cos(turn), math.sin(turn)
    return (points - place) @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def images(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return view(points, (0.3, 0.1, -5.0), 0.1), view(points, (1.4, -0.1, -5.4), -0.15)


def a_period_away(shown: np.ndarray) -> np.ndarray:
    """Of places (32,) that are shown, the labelling that takes each column for the next one."""
    number = np.where(shown, np.cumsum(shown) - 1, -1)
    following = np.append(number[ROWS:], np.full(ROWS, -1))
    return following[shown]


def holes(*places: int) -> np.ndarray:
    shown = np.ones(COLUMNS * ROWS, np.bool_)
    shown[list(places)] = False
    return shown


@pytest.mark.parametrize(("shown", "lost"), [(holes(), 0), (holes(9), 1), (holes(9, 14, 22), 3)])
def test_points_that_leave_the_view_are_not_lost(shown: np.ndarray, lost: int) -> None:
    first, second = (one / np.linalg.norm(one, axis=1, keepdims=True) for one in images(wall()[shown]))
    count = len(first)
    unused = np.full(count, 1e-7), np.full(count, 1e-7), np.zeros(count)
    shifted, all_of_them = a_period_away(shown), np.arange(count)
    logs = log_loss_probability(TwoViewModel(first, second, *unused), np.array([all_of_them, shifted]))
    matched = int((shifted >= 0).sum())
    # a hole is lost in one image, and what is seen in its place is new in the other one
    each = math.log((matched + lost + 1) * math.comb(matched + lost, lost))
    np.testing.assert_allclose(logs, [-2.0 * math.log(count + 1), -2.0 * each])


def matched(shown: np.ndarray, seed: int) -> tuple[rm.Match, np.ndarray]:
    rng = np.random.default_rng(seed)
    first, second = (CAMERA.project(one) + rng.normal(0.0, 0.3, (len(one), 2)) for one in images(wall()[shown]))
    order = rng.permutation(len(second))
    problem = rm.ThreePlusOne(CAMERA, axis=(0.0, 1.0, 0.0), axis2=(0.0, 1.0, 0.0))
    return rm.match(first, second[order], problem, noise=0.3), np.argsort(order)


def test_a_rival_that_loses_points_amid_others_is_improbable() -> None:
    """Most were told with one half, as what is shifted by a period is beyond any accident too."""
    told = []
    for seed in range(4):
        match, truth = matched(np.random.default_rng(seed).permutation(COLUMNS * ROWS) < 20, seed)
        assert np.array_equal(match.assignment, truth)
        told.append(match.probability)
    assert np.count_nonzero(np.array(told) > 0.95) >= 3


def test_of_a_whole_wall_either_labelling_may_be_right() -> None:
    for seed in range(2):
        match, _ = matched(holes(), seed)
        assert match.status is rm.Status.AMBIGUOUS
        assert match.probability < 0.55
        assert match.alternatives
