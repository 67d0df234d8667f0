"""Joint hypotheses of several bodies: clutter is what none of them explains."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import gammaln

import rootmatch as rm
from rootmatch.model import joint
from rootmatch.model.joint import joint_marginals

Floats = NDArray[np.float64]
LogLeft = Callable[[NDArray[np.bool_]], Floats]


def log_left(taken: NDArray[np.bool_]) -> Floats:
    """Jeffreys' prior of the number of clutter points."""
    count = taken.shape[1]
    return np.asarray(gammaln(count - taken.sum(axis=1) + 0.5) - gammaln(count + 0.5))


def by_hand(
    uses: list[NDArray[np.bool_]], masses: list[Floats], given: list[int], log_left: LogLeft = log_left
) -> list[Floats]:
    """The marginals, by all joint hypotheses one by one."""
    expected, count = [np.zeros(len(one) + 1) for one in uses], uses[0].shape[1]
    for chosen in itertools.product(*(range(len(one) + 1) for one in uses)):
        own = [(k, mode) for k, mode in enumerate(chosen) if mode < len(uses[k])]
        taken = np.array([uses[k][mode] for k, mode in own]).reshape(-1, count)
        if (taken.sum(axis=0) > 1).any():
            continue
        rows = [mass if of < 0 else mass[chosen[of]] for mass, of in zip(masses, given, strict=True)]
        alone = sum(rows[k][mode] - log_left(uses[k][mode : mode + 1])[0] for k, mode in own)
        weight = np.exp(alone + log_left(taken.any(axis=0)[None])[0])
        for k, mode in enumerate(chosen):
            expected[k][mode] += weight
    return [one / one.sum() for one in expected]


@pytest.mark.parametrize("hopeless", [0.0, 40.0])
@pytest.mark.parametrize("listed", [joint.LISTED, 0])
def test_marginals_are_those_of_all_joint_hypotheses(
    listed: int, hopeless: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether or not they are few enough to be listed, and some are left out as they are hardly possible."""
    monkeypatch.setattr(joint, "LISTED", listed)
    rng = np.random.default_rng(0)
    uses = [rng.random((k, 9)) < 0.3 for k in (3, 4, 2)]
    # the last one's odds depend on what the first one is, or on its absence
    masses = [*(rng.normal(0.0, 2.0, len(one)) for one in uses[:2]), rng.normal(0.0, 2.0, (4, 2))]
    given = [-1, -1, 0]
    for mass in masses[1:]:
        mass[..., 1] -= hopeless
    for found, wanted in zip(
        joint_marginals(uses, masses, log_left, given=given), by_hand(uses, masses, given), strict=True
    ):
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-8)


def test_joint_hypotheses_that_are_merged_count_for_as_much() -> None:
    """Four bodies of which few detections are contested, in two images with as many detections."""
    rng, images = np.random.default_rng(2), np.repeat([0, 1], 9)
    uses = [(rng.random((5, 18)) < 0.6) & np.isin(np.arange(18) % 9, [2 * k, 2 * k + 1, 8]) for k in range(4)]
    masses = [*(rng.normal(0.0, 2.0, 5) for _ in range(3)), rng.normal(0.0, 2.0, (6, 5))]

    def left_in_each(taken: NDArray[np.bool_]) -> Floats:
        return log_left(taken[:, images == 0]) + 3.0 * log_left(taken[:, images == 1])

    found = joint_marginals(uses, masses, left_in_each, images=images, given=[-1, -1, -1, 1])
    for one, wanted in zip(found, by_hand(uses, masses, [-1, -1, -1, 1], left_in_each), strict=True):
        np.testing.assert_allclose(one, wanted, rtol=1e-6)


def test_bodies_that_are_the_same_have_the_same_marginals() -> None:
    """As each of them by itself would have; what depends on them, too."""
    rng = np.random.default_rng(1)
    first, other = rng.random((4, 9)) < 0.3, rng.random((2, 9)) < 0.3
    mass, of_copy = rng.normal(0.0, 2.0, 4), rng.normal(-2.0, 1.0, (5, 4))
    uses, masses = [first, other, first, first, first, first], [mass, rng.normal(size=2), mass, mass, of_copy, of_copy]
    given = [-1, -1, -1, -1, 0, 2]
    uses, masses, given = [*uses, first], [*masses, of_copy], [*given, 3]
    told = joint_marginals(uses, masses, log_left, given=given, same=[[0, 2, 3]])
    for found, wanted in zip(told, by_hand(uses, masses, given), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-6)


@pytest.mark.parametrize("exactly", [True, False])
def test_no_order_of_many_copies_is_told_by_what_is_left_out(exactly: bool) -> None:
    """Nine bodies in nine places: more orders than are weighed, of which the first ones are as good as any."""
    uses = [np.repeat(np.eye(9, dtype=bool), 6, axis=1)] * 9
    mass = np.linspace(4.0, 24.0, 9)
    told = joint_marginals(uses, [mass] * 9, log_left, same=[[*range(9)]] if exactly else ())
    for one in told:
        assert one[:9] == pytest.approx(1.0 / 9.0, abs=0.02 if exactly else 0.2)


@pytest.mark.parametrize("seed", [1000, 1001, 1004])
def test_a_body_profits_from_what_another_explains(seed: int) -> None:
    """Two links of an arm: what the first one explains is no clutter from which the second one has to stand out."""
    rng = np.random.default_rng(seed)
    camera = rm.Camera(900.0, 900.0, 640.0, 480.0)
    links = rng.uniform(-0.05, 0.05, (2, 6, 3)) * (1.0, 1.0, 4.0)
    images = []
    for k, link in enumerate(links):
        turn = Rotation.random(rng=rng).as_matrix()
        images.append(camera.project(link @ turn.T + (0.15 - 0.3 * k, 0.0, 1.5)))
    pixels = np.concatenate(images)[:10] + 0.3 * rng.normal(size=(10, 2))  # of the second one two are hidden
    both = rm.match(np.concatenate(links), pixels, rm.P3P(camera), noise=0.3, bodies=np.repeat([0, 1], 6))
    alone = rm.match(links[1], pixels[6:], rm.P3P(camera), noise=0.3)
    assert alone
    assert both, both.advice
    assert (both.assignment[:10] == np.arange(10)).all()
