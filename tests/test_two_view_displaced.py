"""A corridor whose lamps are a period apart: the right labelling is among the rivals of one that is a period away."""

from __future__ import annotations

import math

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.model.two_view_fit import fit_relative_poses
from rootmatch.model.two_view_losses import displaced_labellings, log_loss_probability
from rootmatch.model.two_view_model import TwoViewModel
from rootmatch.model.two_view_samples import fit_likeliest

FOCAL, SIGMA, LAMPS, PERIOD = 900.0, 0.4, 12, 2.5
CAMERA = rm.Camera(FOCAL, FOCAL, 640.0, 360.0, size=(1280, 720))
VERTICAL = {"axis": (0.0, 1.0, 0.0), "axis2": (0.0, 1.0, 0.0), "axis_noise": math.radians(0.1)}


def corridor(forward: float, seed: int, strays: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pixels of both images, the camera of the second one so many metres ahead, and numbers of lamps; −1 of strays."""
    rng = np.random.default_rng(seed)
    along = PERIOD * np.arange(LAMPS) + 2.0
    lamps = np.concatenate([np.column_stack([np.full(LAMPS, x), np.full(LAMPS, -0.8), along]) for x in (-1.2, 1.2)])
    found = []
    for place in (0.0, forward):
        x, y, z = (lamps - [0.06 * place, 0.0, place]).T
        pixels = FOCAL * np.column_stack([x, y])[z > 0.1] / z[z > 0.1, None] + [640.0, 360.0]
        numbers = np.flatnonzero(z > 0.1)
        seen = ((pixels > 0.0) & (pixels < [1280.0, 720.0])).all(axis=1) & (rng.random(len(pixels)) < 0.95)
        pixels = pixels[seen] + SIGMA * rng.normal(size=(int(seen.sum()), 2))
        order = rng.permutation(len(pixels) + strays)
        pixels = np.concatenate([pixels, rng.random((strays, 2)) * [1280.0, 720.0]])[order]
        found += [pixels, np.concatenate([numbers[seen], np.full(strays, -1)])[order]]
    return found[0], found[2], found[1], found[3]


def labelling(first: np.ndarray, second: np.ndarray, shift: int) -> np.ndarray:
    """Lamps (n,) of the first image taken for those so many periods further in the second one."""
    wanted = np.where((first >= 0) & (first // LAMPS == (first + shift) // LAMPS), first + shift, -2)
    same = wanted[:, None] == second
    return np.where(same.any(axis=1), same.argmax(axis=1), -1)


def model_of(first: np.ndarray, second: np.ndarray) -> TwoViewModel:
    bearings = [np.column_stack([(one - [640.0, 360.0]) / FOCAL, np.ones(len(one))]) for one in (first, second)]
    bearings = [one / np.linalg.norm(one, axis=1, keepdims=True) for one in bearings]
    variances = [np.full(len(one), (SIGMA / FOCAL) ** 2) for one in bearings]
    return TwoViewModel(*bearings, *variances, np.zeros(len(second)))


@pytest.mark.parametrize("shift", [1, -1])
def test_the_right_labelling_is_a_displaced_one(shift: int) -> None:
    first, second, numbers, others = corridor(1.6, 3)
    model, truth, shifted = model_of(first, second), labelling(numbers, others, 0), labelling(numbers, others, shift)
    pose = fit_likeliest(model, shifted[None]).poses
    right = [int(((one == truth) & (truth >= 0)).sum()) for one in displaced_labellings(model, pose, shifted)]
    assert max(right) > 0.6 * np.count_nonzero(truth >= 0)


def test_too_few_matches_have_no_displaced_ones() -> None:
    first, second, numbers, others = corridor(1.6, 3)
    model, some = model_of(first, second), labelling(numbers, others, 1)
    fits = fit_relative_poses(model, some[None])
    some[np.flatnonzero(some >= 0)[3:]] = -1
    assert displaced_labellings(model, fits.poses.take(np.array([0])), some).shape == (0, len(some))


@pytest.mark.parametrize("seed", range(6))
def test_losses_are_those_of_a_pose_with_the_points_in_front(seed: int) -> None:
    first, second, numbers, others = corridor(1.8, seed)
    shifted = labelling(numbers, others, 1)
    # the farthest lamps of the first image are amid nothing but the other ones: all in view, as seen from a period back
    far = np.isin(numbers % LAMPS, [LAMPS - 1])
    assert far.any()
    assert (shifted[far] < 0).all()
    log = log_loss_probability(model_of(first, second), shifted[None])[0]
    assert log < -2.0 * math.log(np.count_nonzero(shifted >= 0) + 1) - 1.0


@pytest.mark.parametrize("seed", [2, 9, 14, 15])
def test_corridors_are_not_trusted_a_period_away(seed: int) -> None:
    forward = np.random.default_rng(seed).uniform(0.5, 3.5)
    first, second, _, _ = corridor(forward, seed, strays=2)
    match = rm.match(first, second, rm.ThreePlusOne(CAMERA, **VERTICAL), noise=SIGMA)
    assert match.status is rm.Status.AMBIGUOUS
