"""A few points of a body that look like others of it."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.explain.image_hypotheses import TWINS, Candidate, model_of, proposals_of, twins_of
from rootmatch.explain.similar_subsets import MOST, MOST_POINTS, TOLERANCE, twins_of_few
from rootmatch.explain.task import MatchingTask
from rootmatch.model.mode_search import modes_of
from rootmatch.model.modes import Modes
from rootmatch.model.near_symmetries import body_radius
from rootmatch.model.proposals import Proposals

CAMERA = rm.Camera(500.0, 500.0, 320.0, 240.0)


@pytest.mark.parametrize("few", [(0, 3, 5), (1, 2, 4, 6)])
def test_they_are_those_whose_distances_are_alike(few: tuple[int, ...]) -> None:
    rng = np.random.default_rng(len(few))
    angle = np.arange(9) * (2.0 * np.pi / 9.0)
    points = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(9)]) + 0.05 * rng.standard_normal((9, 3))
    between = np.linalg.norm(points[:, None] - points, axis=2)
    worst = {
        other: np.abs(between[np.ix_(other, other)] - between[np.ix_(few, few)]).max()
        for other in permutations(range(9), len(few))
        if other != few
    }
    alike = [one for one in sorted(worst, key=worst.__getitem__) if worst[one] <= TOLERANCE * body_radius(points)]
    found = [tuple(image[list(few)]) for image in twins_of_few(points, np.array(few))]
    assert found == alike[:MOST]
    assert len(found) >= 3
    for image in twins_of_few(points, np.array(few)):
        assert (np.flatnonzero(image >= 0) == sorted(few)).all()


def test_large_bodies_are_not_compared() -> None:
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (MOST_POINTS + 1, 3))
    assert not len(twins_of_few(points, np.array([0, 1, 2])))


def test_an_arc_read_from_the_other_end_is_proposed() -> None:
    """Four points of an arc in a plane, alike after half a turn, on a body that has no symmetry."""
    rng = np.random.default_rng(5)
    arc = np.column_stack([[-0.06, -0.02, 0.021, 0.06], [0.0, 0.02, 0.0205, 0.001], np.zeros(4)])
    points = np.concatenate([arc, rng.uniform(-0.1, 0.1, (5, 3))])
    target = CAMERA.project(arc + np.array([0.02, 0.01, 0.6])) + rng.normal(0.0, 0.3, (4, 2))
    task = MatchingTask.of(rm.P3P(CAMERA), points, target, noise=0.3)
    right = np.array([0, 1, 2, 3, -1, -1, -1, -1, -1])
    model = model_of(task)
    proposed = twins_of(task, model, modes_of(model, proposals_of(task, model, [right]))).assignments.tolist()
    assert [3, 2, 1, 0, -1, -1, -1, -1, -1] in proposed
    found = rm.match(points, target, rm.P3P(CAMERA), noise=0.3)
    assert found.status is not rm.Status.MATCHED


def test_twins_of_a_mode_are_proposed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stairs of twelve steps, of which four show: each better reading has twins, and those before it had theirs."""
    steps = np.array([[0.04 * k, 0.03 * k, 0.02 * (k % 2)] for k in range(12)])
    points = np.concatenate([steps, np.random.default_rng(2).uniform(-0.1, 0.1, (3, 3))])
    target = CAMERA.project(steps[7:11] + np.array([0.02, 0.01, 0.8]))
    task, proposed = MatchingTask.of(rm.P3P(CAMERA), points, target, noise=0.3), list[bytes]()
    work = Candidate.twins

    def counted(self: Candidate, modes: Modes) -> Proposals:
        proposed.extend(one.tobytes() for one in modes.rotation)
        return work(self, modes)

    monkeypatch.setattr(Candidate, "twins", counted)
    wrong = np.array([0, 1, 2, 3, *11 * [-1]])
    Candidate.of(task, [wrong])
    assert len(proposed) > TWINS  # there was a second turn
    assert len(proposed) == len(set(proposed))
