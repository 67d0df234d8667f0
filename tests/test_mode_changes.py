"""The changes of a mode that are weighed, and the sums over them, against plain listings."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rootmatch.model.compiled.mode_changes import IMPOSSIBLE, likely_mode_changes, sum_over_changes
from rootmatch.model.compiled.single_changes import fill_match_gains
from test_compiled_model import PINHOLE, WEIGHTS, scene
from test_neighbourhood import one_change_neighbours

Integers = NDArray[np.int64]


def all_at_once(given: Integers, changed: Integers) -> tuple[Integers, int]:
    """The changes (K, n) of an assignment made one after another, by the rule; how many are."""
    out, count = given.copy(), 0
    for row in changed:
        own = row != given
        others = out[~own]
        if (out[own] == given[own]).all() and not np.isin(row[own & (row >= 0)], others[others >= 0]).any():
            out[own], count = row[own], count + 1
    return out, count


@pytest.mark.parametrize("weighed", [False, True])
@pytest.mark.parametrize("may_lose", [False, True])
@pytest.mark.parametrize("maximum", [1, 4, 200])
def test_changes_are_the_likely_neighbours(weighed: bool, may_lose: bool, maximum: int) -> None:
    """Of assignments that fit, and of ones of which parts do not."""
    more: dict[str, object] = {"log_weights": WEIGHTS, "allowed": WEIGHTS > -1.0} if weighed else {}
    together = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        model, R, position = scene(PINHOLE, seed=1030 + seed, poses=2, **more)
        at = model.linearise_about(R[:1], position[:1])
        truth = np.where(rng.random(6) < 0.9, rng.permutation(9)[:6], -1)
        target = model.target.copy()
        target[truth[truth >= 0]] = at.pixels[0, truth >= 0] + rng.normal(0.0, 3.0, (int((truth >= 0).sum()), 2))
        model = replace(model, target=target)
        assignment = truth.copy()
        some = rng.permutation(6)[: seed % 4]
        assignment[some] = np.roll(assignment[some], 1)
        covariance, rate = np.diag(rng.uniform(1e-6, 1e-3, 6)), math.nan if seed % 2 else 0.8
        log_counts, image_of = rng.normal(size=(2, 10)), rng.integers(0, 2, 9)
        known = model.gating_image
        points = at.pixels[0], at.jacobian[0], np.empty((0, 2, 2)), rng.uniform(0.2, 1.0, 6), at.seen[0]
        columns, gains, order, changed = likely_mode_changes(
            assignment, points, covariance, (*known, log_counts, image_of), (rate, -9.0, may_lose, maximum, 3)
        )
        every, matches = np.empty((6, 9)), np.bincount(image_of[assignment[assignment >= 0]], minlength=2)
        log_count = np.array([np.diff(log_counts[k])[max(matches[k], 1) - 1] for k in image_of])
        if math.isnan(rate):
            rate = (matches.sum() + 0.5) / (max(points[3].sum(), matches.sum()) + 1.0)
        fill_match_gains(assignment, points, covariance, (*known, log_count), rate, every)
        own = np.flatnonzero(assignment >= 0), assignment[assignment >= 0]
        every[own] = np.maximum(every[own], IMPOSSIBLE)
        neighbours = one_change_neighbours(assignment, 9, resize=True).apply_to(assignment)
        value = np.where(neighbours >= 0, every[np.arange(6), neighbours], 0.0).sum(axis=1)
        value -= np.where(assignment >= 0, every[np.arange(6), assignment], 0.0).sum()
        fewer = (neighbours >= 0).sum(axis=1) < (assignment >= 0).sum()
        likely = (value > -9.0) & (may_lose | ~fewer)
        assert len(gains) == likely.sum()
        np.testing.assert_allclose(np.sort(gains), np.sort(value[likely]), rtol=1e-9, atol=1e-6)
        np.testing.assert_array_equal(gains[order], np.sort(gains)[::-1][:maximum])
        rows = {row.tobytes(): gain for row, gain in zip(neighbours[likely], value[likely], strict=True)}
        for row, gain in zip(changed[: len(order)], gains[order], strict=True):
            assert rows.pop(row.tobytes()) == pytest.approx(gain, rel=1e-9, abs=1e-6)
        out, count = all_at_once(assignment, changed[: len(order)][gains[order] > 0.0])
        expected = [out] if count > 1 and (out >= 0).sum() >= 3 else []
        np.testing.assert_array_equal(changed[len(order) :], np.array(expected).reshape(-1, 6))
        together += len(expected)
        assert columns.shape[1] >= len(gains)
    assert maximum == 1 or together > 0


def test_there_is_room_for_any_number_of_changes() -> None:
    """Of six points, each that is seen may have any of sixty detections."""
    model, R, position = scene(PINHOLE, seed=1030, poses=1)
    at = model.linearise_about(R, position)
    model = replace(model, target=np.tile(model.target[:1], (60, 1)) + np.arange(60)[:, None], sigma=np.full(60, 0.5))
    counts = np.zeros((1, 61)), np.zeros(60, np.int64)
    image = *model.gating_image[:3], np.zeros(60), model.weights_of_pairs, *counts
    points = at.pixels[0], at.jacobian[0], np.empty((0, 2, 2)), np.full(6, 0.9), at.seen[0]
    limits = 0.9, -1e12, True, 8, 3
    columns, gains, order, changed = likely_mode_changes(np.full(6, -1), points, 1e-4 * np.eye(6), image, limits)
    assert (
        len(gains)
        == 60 * np.count_nonzero(at.seen[0])
        == len({tuple(one) for one in columns[:, : len(gains)].T.tolist()})
    )
    assert len(order) == 8
    assert ((changed[:8] >= 0).sum(axis=1) == 1).all()


@pytest.mark.parametrize("independent", [3, 6])
def test_sums_over_changes(independent: int) -> None:
    """One by one: of single changes, or of every combination of changes of different points."""
    assignment = np.array([4, 1, 0, 2, 7, -1])
    changes = one_change_neighbours(assignment, 9, resize=True)
    gains = np.random.default_rng(0).normal(-2.0, 1.5, len(changes.source))
    local, unmatched = np.empty(6), np.empty(6)
    total = sum_over_changes(assignment, np.array(changes), gains, independent, local, unmatched)
    weight = np.exp(np.minimum(gains, 0.0))
    own = [weight[changes.source == i].sum() for i in range(6)]
    touched = [weight[(changes.source == i) | (changes.other == i)].sum() for i in range(6)]
    dropped = [weight[(changes.source == i) & (changes.target < 0)].sum() for i in range(6)]
    if independent <= 5:
        assert total == pytest.approx(sum(math.log1p(one) for one in own))
        share = [1.0 / (1.0 + one) for one in touched]
        np.testing.assert_allclose(local, share)
    else:
        assert total == pytest.approx(math.log(1.0 + sum(own)))
        share = [1.0 / (1.0 + sum(own))] * 6
        np.testing.assert_allclose(local, [1.0 - one * share[0] for one in touched])
    # without a detection, whether or not another point has it then
    np.testing.assert_allclose(unmatched[:5], np.array(dropped[:5]) * share[:5])
    assert unmatched[5] == local[5]


def test_no_change_is_likely() -> None:
    """A mode far from all other detections stays as it is."""
    model, R, _ = scene(PINHOLE, seed=1050, poses=1)
    turned = Rotation.from_rotvec([0.0, 0.0, 0.1]).as_matrix() @ R
    at = model.linearise_about(turned, np.array([[0.0, 0.0, 0.6]]))
    model = replace(model, target=np.array(at.pixels[0]), sigma=np.full(6, 0.5))
    counts = np.zeros((1, 7)), np.zeros(6, np.int64)
    columns, gains, order, changed = likely_mode_changes(
        np.arange(6), (at.pixels[0], at.jacobian[0], np.empty((0, 2, 2)), np.full(6, 0.9), at.seen[0]),
        1e-12 * np.eye(6), (*model.gating_image[:3], np.full(6, -40.0), model.weights_of_pairs, *counts),
        (0.9, -9.0, True, 8, 3),
    )  # fmt: skip
    assert (len(gains), len(order), changed.shape) == (0, 0, (0, 6))
    local, unmatched = np.empty(6), np.empty(6)
    assert sum_over_changes(np.arange(6), columns, gains, 9, local, unmatched) == 0.0
    np.testing.assert_array_equal(local, 1.0)
    np.testing.assert_array_equal(unmatched, 0.0)
