"""Poses in which a body looks the same: those that no search need meet are weighed, and each is proposed once."""

from __future__ import annotations

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.explain.image_hypotheses import TWINS, Candidate
from rootmatch.explain.task import MatchingTask
from rootmatch.model.modes import Modes
from rootmatch.model.proposals import Proposals

CAMERA = rm.Camera(500.0, 500.0, 320.0, 240.0)


def test_an_arc_is_not_trusted_as_read_from_one_end() -> None:
    """Four points of an arc in a plane, alike after half a turn, on a body that has no symmetry."""
    rng = np.random.default_rng(5)
    arc = np.column_stack([[-0.06, -0.02, 0.021, 0.06], [0.0, 0.02, 0.0205, 0.001], np.zeros(4)])
    points = np.concatenate([arc, rng.uniform(-0.1, 0.1, (5, 3))])
    target = CAMERA.project(arc + np.array([0.02, 0.01, 0.6])) + rng.normal(0.0, 0.3, (4, 2))
    found = rm.match(points, target, rm.P3P(CAMERA), noise=0.3)
    assert found.status is not rm.Status.MATCHED
    every = [found.assignment.tolist(), *(one.tolist() for one, *_ in found.alternatives)]
    assert [0, 1, 2, 3, -1, -1, -1, -1, -1] in every
    assert [3, 2, 1, 0, -1, -1, -1, -1, -1] in every


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
