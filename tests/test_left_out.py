"""A wrong match that fits and holds the pose away from where right ones are: it is left out, and they are found."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from posteriors import told
from rootmatch.explain import image_hypotheses
from rootmatch.explain.image_hypotheses import model_of
from rootmatch.explain.task import MatchingTask
from rootmatch.model.evidence import settled_about
from rootmatch.model.left_out import without_each
from rootmatch.model.mode_search import modes_of
from rootmatch.model.modes import Modes
from rootmatch.model.proposals import Proposals, no_proposals, rough_fits

CAMERA = rm.Camera(800.0, 800.0, 320.0, 240.0)
NOISE = 0.2
TURN, PLACE = 0.06, np.array([-0.15, 0.02, 1.0])
"""Between the right pose and the wrong one (rad), and where the body is."""
NEAR, FAR = 7, 3
"""Points near each other, which hardly tell such a turn, and points far from them, which do."""


def scene(seed: int) -> tuple[MatchingTask, NDArray[np.int64], NDArray[np.int64]]:
    """A body, the right assignment, and one with a detection of the first far point at a point beside it.

    That point is not detected; it is where a pose turned about the near points would show it at that detection.
    """
    rng = np.random.default_rng([seed, 37])
    near = rng.uniform(-0.05, 0.05, (NEAR, 3)) * [1.0, 1.0, 0.04]
    far = rng.uniform([0.3, -0.15, -0.05], [0.4, 0.15, 0.05], (FAR, 3))
    pixels = CAMERA.project(np.concatenate([near, far]) + PLACE)
    turned = Rotation.from_rotvec([0.0, TURN, 0.0]).as_matrix()
    place = far[0] + PLACE
    beside = (place * rng.uniform(0.98, 1.0) - PLACE) @ turned
    points = np.concatenate([near, far, [beside]])
    right = np.append(np.arange(NEAR + FAR), -1)
    wrong = np.full(len(points), -1)
    wrong[:NEAR], wrong[-1] = np.arange(NEAR), NEAR
    target = np.concatenate([pixels + rng.normal(0.0, NOISE, pixels.shape), rng.uniform(0.0, 480.0, (2, 2))])
    return MatchingTask.of(rm.P3P(CAMERA), points, target, noise=NOISE), right, wrong


def mode_of(task: MatchingTask, row: NDArray[np.int64]) -> Modes:
    """The mode that an assignment leads to by its single changes."""
    model = model_of(task)
    return modes_of(model, rough_fits(model, row[None]))


@pytest.mark.parametrize("seed", range(4))
def test_a_match_that_keeps_others_away_is_left_out(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    task, right, wrong = scene(seed)
    assert (told(task, [wrong]).modes.assignments[0] == right).all()
    monkeypatch.setattr(image_hypotheses, "without_each", lambda model, modes: no_proposals(model.shape[0]))
    assert (told(task, [wrong]).modes.assignments[0] != right).any()


@pytest.mark.parametrize("seed", range(4))
def test_what_is_gathered_is_what_the_pose_without_the_match_leads_to(seed: int) -> None:
    task, right, wrong = scene(seed)
    model, modes = model_of(task), mode_of(task, wrong).first(1)
    found = without_each(model, modes)
    (k,) = (found.assignments == right).all(axis=1).nonzero()[0]
    settled, at = settled_about(model, *found.take(np.array([k])))
    step = np.append(
        Rotation.from_matrix(found.rotation[k] @ at.rotation[0].T).as_rotvec(), found.position[k] - at.position[0]
    )
    before = np.append(
        Rotation.from_matrix(modes.rotation[0] @ at.rotation[0].T).as_rotvec(), modes.position[0] - at.position[0]
    )
    precision = np.linalg.inv(settled.covariance[0])
    assert step @ precision @ step < 0.02 * (before @ precision @ before)


def test_matches_that_hold_nothing_away_are_not_left_out() -> None:
    """A body of which all is found; and as few matches as make a mode."""
    task, right, _ = scene(0)
    model, modes = model_of(task), mode_of(task, right)
    assert not len(without_each(model, modes.first(1)).assignments)
    few = np.where(np.arange(len(right)) < model.prior.least, right, -1)
    alone = modes.first(1)._replace(assignments=few[None])
    assert isinstance(found := without_each(model, alone), Proposals)
    assert not len(found.assignments)
