"""Joint hypotheses of several bodies: clutter is what none of them explains."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import gammaln

import rootmatch as rm
from rootmatch.model.joint import joint_marginals

Floats = NDArray[np.float64]


def log_left(taken: NDArray[np.bool_]) -> Floats:
    """Jeffreys' prior of the number of clutter points."""
    count = taken.shape[1]
    return np.asarray(gammaln(count - taken.sum(axis=1) + 0.5) - gammaln(count + 0.5))


def test_marginals_are_those_of_all_joint_hypotheses() -> None:
    rng = np.random.default_rng(0)
    uses = [rng.random((k, 9)) < 0.3 for k in (3, 4, 2)]
    # the last one's odds depend on what the first one is, or on its absence
    masses = [*(rng.normal(0.0, 2.0, len(one)) for one in uses[:2]), rng.normal(0.0, 2.0, (4, 2))]
    expected = [np.zeros(len(one) + 1) for one in uses]
    for chosen in itertools.product(*(range(len(one) + 1) for one in uses)):
        own = [(k, mode) for k, mode in enumerate(chosen) if mode < len(uses[k])]
        taken = np.array([uses[k][mode] for k, mode in own]).reshape(-1, 9)
        if (taken.sum(axis=0) > 1).any():
            continue
        rows = [masses[0], masses[1], masses[2][chosen[0]]]
        alone = sum(rows[k][mode] - log_left(uses[k][mode : mode + 1])[0] for k, mode in own)
        weight = np.exp(alone + log_left(taken.any(axis=0)[None])[0])
        for k, mode in enumerate(chosen):
            expected[k][mode] += weight
    for found, wanted in zip(joint_marginals(uses, masses, log_left, given=[-1, -1, 0]), expected, strict=True):
        np.testing.assert_allclose(found, wanted / wanted.sum(), rtol=1e-6)


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
