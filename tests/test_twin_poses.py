"""A body that looks nearly the same after half a turn: both poses are weighed whatever a search has found."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain.assessment import rivals_beyond_chance
from rootmatch.explain.assignment_posterior import Misfit, Ranked
from rootmatch.explain.confidence import Marginals
from rootmatch.explain.decide import TRUST
from rootmatch.explain.explain import explain
from rootmatch.explain.task import MatchingTask, MatchOptions
from rootmatch.explain.twin_poses import twins_of
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.result import report
from rootmatch.samplers.base import SampledTensor, SamplingTask

CAMERA = rm.Camera(800.0, 800.0, 640.0, 480.0)
HALF_TURN = np.array([-1.0, -1.0, 1.0])
HALF = 8
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def image(off: float, noise: float, more: int = 0) -> tuple[MatchingTask, Integers]:
    """The front of a body whose back is its copy half a turn away but for ``off``, and ``more`` points on its front.

    The detections are those of the front, in order, and five of clutter.
    """
    rng = np.random.default_rng(4)
    front = rng.uniform((0.02, -0.1, -0.1), (0.06, 0.1, 0.1), (HALF, 3))
    others = rng.uniform((0.02, -0.1, -0.1), (0.06, 0.1, 0.1), (more, 3))
    source = np.concatenate([front, front * HALF_TURN + off * rng.standard_normal((HALF, 3)), others])
    normals = np.zeros_like(source)
    normals[:, 0] = np.sign(source[:, 0])
    R = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])  # its front towards the camera
    R = Rotation.from_rotvec([0.2, -0.3, 0.1]).as_matrix() @ R
    seen = np.flatnonzero(source[:, 0] > 0.0)
    pixels = CAMERA.project(source[seen] @ R.T + [0.05, 0.02, 0.6]) + rng.normal(0.0, noise, (len(seen), 2))
    target = np.concatenate([pixels, rng.uniform((0.0, 0.0), (1280.0, 960.0), (5, 2))])
    truth = np.full(len(source), -1)
    truth[seen] = np.arange(len(seen))
    task = MatchingTask.of(rm.P3P(CAMERA), source, target, noise=noise, normals=normals, view_angle=np.radians(70.0))
    return task, truth


def twin(truth: Integers) -> Integers:
    """The assignment after half a turn."""
    other = np.full_like(truth, -1)
    other[HALF : 2 * HALF] = truth[:HALF]
    return other


def found_alone(task: MatchingTask, assignment: Integers) -> MatchingTask:
    """The task with a search that finds one assignment, and thinks that it has seen everything."""
    there = assignment[task.permutation]
    groups = np.array(list(itertools.combinations(np.flatnonzero(there >= 0), 4)))

    def sampler(sampling: SamplingTask) -> SampledTensor:
        indices = (groups * sampling.shape[1] + there[groups]).astype(np.int32)
        tensor = AffinityTensor(indices, np.ones(len(groups)), sampling.shape)
        return SampledTensor(tensor, 1000, chance_weight=1e-6, assignments=there[None])

    return replace(task, options=MatchOptions(sampler=sampler))


@pytest.mark.parametrize("first", [True, False])
def test_the_twin_is_listed_where_the_points_do_not_decide(first: bool) -> None:
    task, truth = image(0.0, 0.3)
    match = report(explain(found_alone(task, truth if first else twin(truth))), seconds=0.0)
    assert match.status is rm.Status.AMBIGUOUS
    assert match.probability == pytest.approx(0.5, abs=0.05)
    both = [match.assignment, match.alternatives[0][0]]
    for expected in (truth, twin(truth)):
        assert any(np.array_equal(other, expected) for other in both)
    assert match.confidence[match.assignment >= 0] == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("first", [True, False])
def test_it_is_matched_where_they_do(first: bool) -> None:
    task, truth = image(0.0003, 0.03)
    match = report(explain(found_alone(task, truth if first else twin(truth))), seconds=0.0)
    assert match.status is rm.Status.MATCHED
    assert np.array_equal(match.assignment, truth)
    assert match.confidence[match.assignment >= 0].min() > 0.99


def test_a_twin_has_what_only_it_explains() -> None:
    task, truth = image(0.0, 0.3, more=4)
    (found,) = twins_of(task, [twin(truth)])
    assert np.array_equal(found, truth)
    assert np.count_nonzero(found >= 0) == HALF + 4
    # of a pose few of whose matches it shares there is none, and without normals all that is hidden is unknown
    few = np.where(np.arange(len(truth)) < HALF - 2, -1, truth)
    assert twins_of(task, [few]) == []
    unknown = MatchingTask.of(task.problem, task.points.source, task.points.target, noise=0.3)
    assert twins_of(unknown, [twin(truth)]) == []


def test_a_twin_keeps_to_the_candidates() -> None:
    task, truth = image(0.0, 0.3)
    allowed = np.ones(task.shape, np.bool_)
    allowed[HALF : 2 * HALF] = False
    assert len(twins_of(task, [truth])) == 1
    assert twins_of(replace(task, allowed=allowed), [truth]) == []


def test_rivals_share_the_odds_that_the_object_is_there() -> None:
    task, truth = image(0.0, 0.3)

    def believed(beyond: float, first: float, rest: int = 1) -> bool:
        logarithms = np.log([first, *[(1.0 - first) / rest] * rest])
        each = Marginals(np.full(len(truth), first), np.zeros(len(truth)), first)
        others = [twin(truth)] * rest
        return rivals_beyond_chance(task, Ranked([truth, *others], logarithms, beyond, Misfit(1.0, 1.0, 10), each))

    edge = TRUST.beyond_clutter_of_rivals
    assert believed(edge + 0.1, 0.5)
    assert believed(edge - math.log(2.0) + 0.1, 0.5)
    assert not believed(edge - math.log(2.0) - 0.1, 0.5)
    assert not believed(edge + 0.1, 0.95)  # one of them sure: as for any pose
    assert not believed(edge + 0.1, 0.2, rest=20)  # no short list
