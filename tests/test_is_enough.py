"""When a prediction explains so much that no search is needed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain.image_hypotheses import Candidate, is_search_needless
from rootmatch.explain.task import MatchingTask
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.posterior import Posterior, empty_posterior

CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)


def told_of(matched: int, detections: int) -> tuple[DetectionModel, Posterior]:
    """The posterior of a pose that explains so many of 10 points and of some detections, the others at random."""
    rng = np.random.default_rng(4)
    points = rng.uniform(-0.1, 0.1, (10, 3))
    R, t = Rotation.from_rotvec([0.2, -0.3, 0.1]).as_matrix(), np.array([0.05, 0.0, 0.9])
    image = CAMERA.project(points @ R.T + t)[:matched]
    target = np.concatenate([image, rng.uniform((0.0, 0.0), (1280.0, 960.0), (detections - matched, 2))])
    prior = rm.Pose(R, t, np.diag([0.01] * 3 + [0.005] * 3) ** 2)
    task = MatchingTask.of(rm.P3P(CAMERA), points, target, noise=0.3, prior=prior)
    body = Candidate.of(task, [np.where(np.arange(10) < matched, np.arange(10), -1)])
    told = body.alone()
    assert np.count_nonzero(told.modes.assignments[0] >= 0) == matched
    return body.model, told


def with_mass(told: Posterior, mass: float) -> Posterior:
    return replace(told, modes=told.modes._replace(log_mass=np.full(len(told.modes.log_mass), mass)))


def test_all_detections_explained_are_enough() -> None:
    model, told = told_of(8, 8)
    assert is_search_needless(model, told, 3)
    assert is_search_needless(model, with_mass(told, 0.1), 3)  # nothing is left for a pose elsewhere
    assert not is_search_needless(model, with_mass(told, -9.0), 3)
    assert not is_search_needless(model, empty_posterior(10), 3)


def test_a_poor_fit_says_nothing_of_what_a_good_one_elsewhere_is_worth() -> None:
    """A prediction of a drone that came back into view explained four of its LEDs poorly, and was kept to."""
    model, told = told_of(4, 11)
    assert is_search_needless(model, with_mass(told, 3.4), 3, of_several=True)
    assert not is_search_needless(model, with_mass(told, 3.4), 3)


@pytest.mark.parametrize("detections", [8, 9, 10, 11])
def test_the_worth_of_a_match_elsewhere_is_that_of_one_that_fits(detections: int) -> None:
    model, told = told_of(4, detections)
    visible, left = float(told.modes.visible[0].sum()), detections - 4
    # a detection where clutter has one in so many square pixels, against a Gaussian of its noise
    worth = np.log(1280.0 * 960.0 / detections / (2.0 * np.pi * 0.3**2)) - 1.0
    maximum = min(left, visible) - 3.0
    threshold = maximum * worth - 3.0 * np.log(left) + np.log(0.01)
    assert is_search_needless(model, with_mass(told, threshold + 4.0 * maximum), 3)
    assert not is_search_needless(model, with_mass(told, threshold - 4.0 * maximum), 3)
