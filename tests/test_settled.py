"""Poses that modes settle at where the image hardly tells some of the pose, against SciPy's least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain.image_hypotheses import Candidate
from rootmatch.explain.task import MatchingTask
from rootmatch.model.evidence import FAR, about, settled, squared_deviations
from rootmatch.model.proposals import rough_fits

CAMERA = rm.Camera(700.0, 700.0, 640.0, 400.0)
SIGMA = 0.4


def wand(seed: int, strays: int = 2) -> tuple[MatchingTask, np.ndarray]:
    """Five LEDs nearly on a line and one aside, with stray detections."""
    rng = np.random.default_rng([seed, 5])
    line = np.column_stack([rng.normal(0.0, 0.004, (5, 2)), np.sort(rng.uniform(-0.3, 0.3, 5))])
    points = np.vstack([line, [0.06, 0.0, 0.1]])
    R, t = Rotation.random(random_state=rng).as_matrix(), np.array([*rng.uniform(-0.3, 0.3, 2), rng.uniform(0.8, 2.0)])
    pixels = np.vstack([CAMERA.project(points @ R.T + t), rng.uniform((200, 100), (1000, 700), (strays, 2))])
    order = rng.permutation(len(pixels))
    target = (pixels + rng.normal(0.0, SIGMA, pixels.shape))[order]
    return MatchingTask.of(rm.P3P(CAMERA), points, target, noise=SIGMA), np.argsort(order)[:6]


def least_chi2(task: MatchingTask, truth: np.ndarray, R: np.ndarray, position: np.ndarray) -> float:
    """The least χ² of an assignment, from a pose of the points' centre."""
    places = task.points.source - task.points.source.mean(axis=0)

    def residuals(x: np.ndarray) -> np.ndarray:
        turned = places @ (Rotation.from_rotvec(x[:3]).as_matrix() @ R).T + position + x[3:]
        return ((CAMERA.project(turned) - task.points.target[truth]) / SIGMA).ravel()

    return 2.0 * float(least_squares(residuals, np.zeros(6), xtol=1e-12, ftol=1e-12).cost)


@pytest.mark.parametrize("seed", range(12))
def test_of_nearly_collinear_points(seed: int) -> None:
    task, truth = wand(seed)
    modes = Candidate.of(task, [truth]).modes
    model = Candidate.of(task, []).model
    k = int(np.flatnonzero((modes.assignments == truth).all(axis=1))[0])
    R, position = modes.rotation[k], modes.position[k]
    chi2 = squared_deviations(model, truth[None], model.linearised(R[None], position[None]))[0]
    assert chi2 < least_chi2(task, truth, R, position) + FAR


def test_a_hypothesis_settles_as_it_does_by_itself() -> None:
    """Whatever the others need: those near their best pose are left as they are."""
    task, truth = wand(0)
    model, rng = Candidate.of(task, []).model, np.random.default_rng(0)
    rows = np.array([truth, *(rng.permutation(8)[:6] for _ in range(10))])
    proposals = rough_fits(model, rows)
    together, at = settled(model, proposals.assignments, *about(model, *proposals))
    for k in range(3):
        one = proposals.take(np.array([k]))
        alone, there = settled(model, one.assignments, *about(model, *one))
        if together.log_odds[k] < together.log_odds.max() - 30.0:
            continue
        np.testing.assert_allclose(at.rotation[k], there.rotation[0], atol=1e-9)
        assert together.log_odds[k] == pytest.approx(alone.log_odds[0], abs=1e-6)
    assert together.log_odds[0] > together.log_odds[1:].max()
