"""A match with a time limit: when its stages end, and what it says of what it has found by then."""

from __future__ import annotations

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.deadline import NEVER, Deadline, Pace
from rootmatch.explain.explain import explain
from rootmatch.explain.task import MatchingTask, MatchOptions
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.result import report
from rootmatch.simulation import p3p_scene, up2p_scene
from rootmatch.solvers import SOLVERS, PowerIteration


class Clock:
    """Seconds that pass with every look at it."""

    def __init__(self, step: float = 0.0) -> None:
        self.now, self.step = 0.0, step

    def __call__(self) -> float:
        self.now += self.step
        return self.now


def test_deadlines_end_and_know_what_they_cut() -> None:
    clock = Clock()
    whole = Deadline(2.0, clock=clock)
    stage = whole.part(0.5)
    clock.now = 0.9
    assert not stage.passed()
    assert stage.left() == pytest.approx(0.1)
    clock.now = 1.5
    assert not whole.stopped_early
    assert stage.passed()
    assert whole.stopped_early  # a part that cut work says so to the whole
    assert not whole.passed()
    assert whole.affordable(100, 0.1) == 5
    assert not Deadline(1.0, clock=clock).stopped_early
    assert Deadline(1.0, clock=clock).cut(100, 0.1) == 10


def test_no_deadline_cuts_nothing() -> None:
    assert NEVER.part(0.1) is NEVER
    assert not NEVER.passed()
    assert NEVER.cut(10**9, 1.0) == 10**9
    assert Pace(NEVER, 1).block(10**9) == 10**9
    assert not NEVER.stopped_early


def test_blocks_shrink_as_the_deadline_comes_near() -> None:
    clock = Clock()
    pace = Pace(Deadline(1.0, clock=clock), 10)
    sizes, late = [], 0.0
    while size := pace.block(1000):
        sizes.append(size)
        clock.now += 0.001 * size  # a millisecond a unit
        late = clock.now
    assert sizes[0] == 10
    assert max(sizes) < 500
    assert sizes[-1] == 1
    assert late <= 1.0 + 0.0015


@pytest.mark.parametrize("value", [0, -1.0, float("nan"), float("inf"), "1", True])
def test_bad_limits(value) -> None:  # type: ignore[no-untyped-def]
    scene = p3p_scene(8, 0, 0.5, 0)
    with pytest.raises(rm.InputError, match=r"max_seconds: .* given; give a positive number"):
        rm.match(scene.source, scene.target, scene.problem, max_seconds=value)
    matcher = rm.Matcher(scene.source, scene.problem)
    with pytest.raises(rm.InputError, match="max_seconds"):
        matcher.match(scene.target, max_seconds=value)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"sampler": "guided"},
        {"sampler": "random", "samples": 20_000},
        {"motions": 2},
        {"preset": "paper"},
        {"noise": "auto"},
        {"solver": "hgm"},
    ],
    ids=str,
)
def test_a_generous_limit_changes_nothing_and_a_tiny_one_ends_every_stage(options) -> None:  # type: ignore[no-untyped-def]
    scene = up2p_scene(12, 6, 0.5, 3, motions=options.get("motions", 1))
    options = {"noise": 0.5} | options
    free = rm.match(scene.source, scene.target, scene.problem, **options)
    generous = rm.match(scene.source, scene.target, scene.problem, max_seconds=600.0, **options)
    np.testing.assert_array_equal(generous.assignment, free.assignment)
    assert generous.status is free.status
    assert not generous.stopped_early
    tiny = rm.match(scene.source, scene.target, scene.problem, max_seconds=1e-9, **options)
    assert tiny.stopped_early
    assert tiny.status is not rm.Status.MATCHED
    assert tiny.evaluated <= free.evaluated


def test_a_search_that_is_cut_returns_what_it_found() -> None:
    scene = p3p_scene(16, 16, 0.5, 1)
    fractions = []
    for looks in (4, 8, 16, 2000):
        # every look at the clock takes a second
        deadline = Deadline(float(looks), clock=Clock(1.0))
        task = MatchingTask.of(
            scene.problem, scene.source, scene.target, noise=0.5, options=MatchOptions(), deadline=deadline
        )
        found = report(explain(task), seconds=0.0, stopped_early=task.deadline.stopped_early)
        fractions.append(found.evaluated)
        assert found.stopped_early == (looks < 2000)
    assert fractions == sorted(fractions)
    np.testing.assert_array_equal(found.assignment, scene.truth)


def test_each_frame_has_its_own_limit() -> None:
    scene = up2p_scene(6, 3, 0.5, 0)
    matcher = rm.Matcher(scene.source, scene.problem, noise=0.5, max_seconds=1e-9)
    assert matcher.match(scene.target).stopped_early
    assert not matcher.match(scene.target, max_seconds=600.0).stopped_early


@pytest.mark.parametrize("name", sorted(SOLVERS))
def test_every_solver_keeps_to_a_deadline(name) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(0)
    source, target = (
        rng.permuted(np.tile(np.arange(6), (300, 1)), axis=1)[:, :3],
        rng.permuted(np.tile(np.arange(7), (300, 1)), axis=1)[:, :3],
    )
    tensor = AffinityTensor.unchecked((source * 7 + target).astype(np.int32), rng.random(300), (6, 7))
    cut = SOLVERS[name](tensor, deadline=Deadline(1e-9, clock=Clock(1.0)))  # type: ignore[call-arg]
    assert cut.assignment.shape == (6,)
    assert not cut.converged


def test_a_solver_that_knows_no_deadline_is_called_without() -> None:
    def own(tensor, *, seed=0):  # type: ignore[no-untyped-def]
        return PowerIteration()(tensor, seed=seed)

    scene = up2p_scene(6, 3, 0.5, 0)
    found = rm.match(scene.source, scene.target, scene.problem, noise=0.5, solver=own, max_seconds=600.0)
    assert (found.assignment >= 0).any()
