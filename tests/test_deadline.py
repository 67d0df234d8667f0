"""A match with a time limit: when its stages end, and what it says of what it has found by then."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.deadline import NEVER, Deadline, OutOfTime, Pace, active_deadline, checkpoint
from rootmatch.explain import point_set_decision
from rootmatch.explain.explain import explain
from rootmatch.explain.image_hypotheses import make_detection_model
from rootmatch.explain.match_options import MatchOptions
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.affinity import affinity
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.jit.threads import chunk_bounds, run_in_chunks, run_in_pieces, run_in_threads
from rootmatch.model.gathering import gather_each
from rootmatch.model.proposals import solve_minimal_sets
from rootmatch.problems.points import distances
from rootmatch.result import report
from rootmatch.samplers.base import SamplingTask
from rootmatch.samplers.guided import search
from rootmatch.samplers.guided.hypotheses import Hypotheses
from rootmatch.samplers.guided.sampler import Guided
from rootmatch.samplers.guided.visible_search import choose_search
from rootmatch.samplers.point_sets import congruent
from rootmatch.simulation import p3p_scene, up2p_scene
from rootmatch.solvers import SOLVERS, MultiStartAscent, PowerIteration
from rootmatch.solvers.ascent.assignment_state import empty_state
from rootmatch.solvers.ascent.bounded_ascents import BoundedAscents
from rootmatch.solvers.ascent.climb import climb_from
from rootmatch.solvers.ascent.multi_start import MultiStart
from rootmatch.solvers.ascent.subset_index import build_index


class Clock:
    """Seconds that pass when told, and with every look at it."""

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


def test_work_inside_a_deadline_ends_when_it_passes() -> None:
    clock, done = Clock(), []
    deadline = Deadline(1.0, clock=clock)
    with deadline.within():
        assert active_deadline() is deadline
        for k in range(5):
            checkpoint()
            done.append(k)
            clock.now += 0.4
    assert done == [0, 1, 2]
    assert deadline.stopped_early
    assert active_deadline() is NEVER
    with deadline.enforce(), pytest.raises(OutOfTime):
        checkpoint()
    soon = Deadline(10.0, clock=clock)
    with soon.enforce():
        checkpoint(5.0)
        with pytest.raises(OutOfTime):
            checkpoint(11.0)  # would take longer than is left
    assert soon.stopped_early
    checkpoint(1e9)  # no deadline is in force
    late = deadline.with_grace()
    assert 0.0 < late.ends - deadline.ends < 0.1
    assert NEVER.with_grace() is NEVER


@pytest.mark.parametrize("threads", [1, 3])
def test_tasks_of_a_chunk_are_done_in_order_by_one_thread(threads: int) -> None:
    bounds, seen, by = chunk_bounds(7, 1007, 6), [], {}
    assert (bounds[0], bounds[-1], len(bounds)) == (7, 1007, 7)
    assert max(np.diff(bounds)) - min(np.diff(bounds)) <= 1

    def work(first: int, last: int) -> None:
        for task in range(first, last):
            chunk = int(np.searchsorted(bounds, task, side="right")) - 1
            seen.append((chunk, task))
            by.setdefault(chunk, set()).add(threading.get_ident())

    run_in_chunks(work, bounds, threads, begin=5)
    assert sorted(seen) == [(int(np.searchsorted(bounds, k, side="right")) - 1, k) for k in range(7, 1007)]
    for chunk in range(6):
        own = [task for one, task in seen if one == chunk]
        assert own == sorted(own)
        assert len(by[chunk]) == 1
    run_in_chunks(work, [0] * 7, threads, begin=5)  # nothing to do
    clock, begun = Clock(), []

    def slow(first: int, last: int) -> None:
        begun.append(last - first)
        clock.now += 0.3

    with Deadline(1.0, clock=clock).enforce(), pytest.raises(OutOfTime):
        run_in_chunks(slow, bounds, threads, begin=2)
    assert begun[0] == 2
    assert 3 <= len(begun) <= 4 + threads

    def wrong(first: int, last: int) -> None:
        raise ValueError(f"{first}")

    with pytest.raises(ValueError, match="7"):
        run_in_chunks(wrong, bounds, threads, begin=5)


@pytest.mark.parametrize("threads", [1, 3])
def test_pieces_make_up_the_whole_and_end_at_a_deadline(threads: int) -> None:
    seen = np.zeros(10_000, int)

    def work(first: int, last: int) -> None:
        seen[first:last] += 1

    run_in_threads(work, len(seen), threads, 4)
    assert (seen == 1).all()
    run_in_threads(work, 0, threads)
    assert (seen == 1).all()
    clock, begun = Clock(), []

    def slow(first: int, last: int) -> None:
        begun.append((first, last))
        clock.now += 0.3

    with Deadline(1.0, clock=clock).enforce(), pytest.raises(OutOfTime):
        run_in_threads(slow, 1000, threads)
    assert 4 <= len(begun) < 4 + threads
    assert sorted(first for first, _ in begun)[0] == 0

    def wrong(first: int, last: int) -> None:
        raise ValueError(f"{first}")

    with pytest.raises(ValueError, match="0"):
        run_in_threads(wrong, 1000, threads)


def test_a_single_task_is_begun_before_the_deadline_alone() -> None:
    clock, begun = Clock(), []
    deadline = Deadline(1.0, clock=clock)
    with deadline.enforce():
        run_in_pieces(lambda first, last: begun.append((first, last)), 1)
        run_in_pieces(lambda first, last: begun.append((first, last)), 0)
        assert begun == [(0, 1)]
        clock.now += 2.0
        run_in_pieces(lambda first, last: begun.append((first, last)), 0)
        assert not deadline.stopped_early
        with pytest.raises(OutOfTime):
            run_in_pieces(lambda first, last: begun.append((first, last)), 1)
    assert begun == [(0, 1)]
    assert deadline.stopped_early


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
    for looks in (4, 8, 16, 10**6):
        # every look at the clock takes a second
        deadline = Deadline(float(looks), clock=Clock(1.0))
        task = MatchingTask.of(
            scene.problem, scene.source, scene.target, noise=0.5, options=MatchOptions(), deadline=deadline
        )
        found = report(explain(task), seconds=0.0, stopped_early=task.deadline.stopped_early)
        fractions.append(found.evaluated)
        assert found.stopped_early == (looks < 10**6)
    assert fractions == sorted(fractions)
    np.testing.assert_array_equal(found.assignment, scene.truth)


def test_hypotheses_are_verified_in_parts_until_a_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, weigh = p3p_scene(8, 4, 0.5, 4), affinity("joint")
    tables = scene.problem.prepare(scene.source, scene.target, 0.5)
    task = SamplingTask(tables, weigh.residual.kernel_kind(6), weigh, (8, 12), 4)
    points = np.array([(0, 1, k) for k in range(2, 8) for _ in range(4)])
    images = np.array([(k % 4, *scene.truth[row]) for k, row in enumerate(points)])

    def verified(looks: float) -> list[Hypotheses]:
        found = choose_search(task, Guided(), NEVER)
        with Deadline(looks, clock=Clock(1.0)).within():
            found._verify(points, images)
        return found.hypotheses

    (whole,) = verified(1e6)
    monkeypatch.setattr(search, "VERIFIED", 1)
    (parts,) = verified(1e6)
    assert all(np.array_equal(one, other) for one, other in zip(parts, whole, strict=True))
    (some,) = verified(9.5)
    assert 0 < len(some.evidence) < len(whole.evidence)
    assert all(np.array_equal(one, other[: len(one)]) for one, other in zip(some, whole, strict=True))
    assert verified(0.5) == []


def test_labellings_grow_in_parts_until_a_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    source = rng.uniform(-1.0, 1.0, (12, 3))
    target = source @ Rotation.random(random_state=3).as_matrix().T + 0.01 * rng.normal(size=source.shape)
    problem = rm.Rigid(3)
    task = MatchingTask.of(problem, source, target, noise=0.01, options=MatchOptions(), deadline=NEVER)
    model = point_set_decision.make_point_set_model(task)
    assert model is not None
    # of each labelling its motion finds the rest
    some = np.array([np.where(np.isin(np.arange(12), rng.permutation(12)[:5]), np.arange(12), -1) for _ in range(9)])
    whole = congruent.grow_labellings(model.clouds, some, False, None)
    assert (whole[0] == np.arange(12)).all()
    monkeypatch.setattr(congruent, "CELLS", 1)
    assert np.array_equal(congruent.grow_labellings(model.clouds, some, False, None), whole)
    deadline = Deadline(3.5, clock=Clock(1.0))
    with deadline.enforce():
        first = congruent.grow_labellings(model.clouds, some, False, None)
    assert deadline.stopped_early
    assert (first[0] == np.arange(12)).all()


def test_hypotheses_gather_until_a_deadline() -> None:
    scene = p3p_scene(8, 3, noise=0.5, seed=0)
    model = make_detection_model(MatchingTask.of(scene.problem, scene.source, scene.target, noise=0.5))
    hypotheses = solve_minimal_sets(model, scene.truth[None], 8).alone
    hypotheses = hypotheses.take(np.resize(np.arange(len(hypotheses.assignments)), 60))
    whole = gather_each(model, hypotheses)
    deadline = Deadline(3.5, clock=Clock(1.0))
    with deadline.enforce():
        assignments, gains = gather_each(model, hypotheses)
    assert deadline.stopped_early
    (done,) = np.nonzero((assignments >= 0).any(axis=1))
    assert 0 < len(done) < 60
    assert np.array_equal(done, np.arange(len(done)))
    assert np.array_equal(assignments[done], whole[0][done])
    assert np.array_equal(gains[done], whole[1][done])
    assert (gains[len(done) :] == -np.inf).all()


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


@pytest.mark.parametrize("exchanges", [False, True])
def test_an_ascent_in_steps_is_the_whole_one_and_ends_between_two(exchanges: bool) -> None:
    rng = np.random.default_rng(1)
    tuples = [rng.permuted(np.tile(np.arange(n), (4000, 1)), axis=1)[:, :3] for n in (12, 14)]
    unary = rng.random((12, 14))
    edges = (tuples[0] * 14 + tuples[1]).astype(np.int32)
    index = build_index(AffinityTensor.unchecked(edges, rng.random(4000), (12, 14), unary).merged())
    nothing = np.full(12, -1)
    ascended = climb_from(index, empty_state(index), nothing[None], penalty=0.0, limit=10_000, exchanges=exchanges)
    (whole,), (value,), (moves,), (reads,) = ascended
    empty = empty_state(index)
    search = BoundedAscents(MultiStartAscent(), index, Deadline(1e6, clock=Clock(1e-3)))
    (image,), (same,), (made,), (read,) = search.ascend_one_in_steps(empty, nothing, 0.0, exchanges=exchanges)
    np.testing.assert_array_equal(image, whole)
    assert (same, made, read) == (value, moves, reads)
    bases = np.array([nothing, whole])
    images, values, made, read = search.ascend_in_steps(empty, bases, 0.0, exchanges=exchanges, threads=2)
    np.testing.assert_array_equal(images[0], whole)
    assert (values[0], made[0], read[0]) == (value, moves, reads)
    none = MultiStart(MultiStartAscent(), index, Deadline(1e-9, clock=Clock(1.0)))
    none.polish()  # of nothing, as no ascent was made
    assert none.solution().assignment.tolist() == nothing.tolist()
    short = BoundedAscents(MultiStartAscent(), index, Deadline(6.0, clock=Clock(1.0)))
    assert short.whole_ascent < 0.25  # this one would be made whole
    (image,), (less,), (made,), _ = short.ascend_one_in_steps(empty, nothing, 0.0, exchanges=False)
    assert 0 < made < moves
    assert 0.0 < less < value
    assert np.unique(image[image >= 0]).size == (image >= 0).sum() == made


def test_distances_are_those_of_a_norm_and_end_at_a_deadline() -> None:
    points = np.random.default_rng(2).normal(size=(1500, 3))
    np.testing.assert_array_equal(distances(points[:40]), np.linalg.norm(points[:40, None] - points[:40], axis=2))
    with Deadline(2.5, clock=Clock(1.0)).enforce(), pytest.raises(OutOfTime):
        distances(points)


def test_a_solver_that_knows_no_deadline_is_called_without() -> None:
    def own(tensor, *, seed=0):  # type: ignore[no-untyped-def]
        return PowerIteration()(tensor, seed=seed)

    scene = up2p_scene(6, 3, 0.5, 0)
    found = rm.match(scene.source, scene.target, scene.problem, noise=0.5, solver=own, max_seconds=600.0)
    assert (found.assignment >= 0).any()


INTERRUPTED = """
import signal, time
import numpy as np
import rootmatch as rm
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where the tests run in the background
rng = np.random.default_rng(0)
camera = rm.Camera(800.0, 800.0, 320.0, 240.0)
first, second = rng.uniform((0.0, 0.0), (640.0, 480.0), (2, 900, 2))
ball = rng.uniform(-1.0, 1.0, (900, 3))
tasks = (
    (first[:30], second[:700], rm.ThreePlusOne(camera, axis=(0, 1, 0), axis2=(0, 1, 0))),
    (ball, second, rm.P3P(camera)),
)
from numba.core.dispatcher import Dispatcher
loaded, before = [0], Dispatcher.add_overload
def counted(self, result):
    loaded[0] += 1
    before(self, result)
Dispatcher.add_overload = counted
for source, target, problem in tasks:
    rm.match(source[:8], target[:9], problem, sampler="guided")
    for _ in range(8):  # what is needed is compiled: no compiler is interrupted
        loaded[0] = 0
        rm.match(source, target, problem, sampler="guided", max_seconds=0.5)
        if not loaded[0]:
            break
    print("compiled", flush=True)
    try:
        rm.match(source, target, problem)
        print("ended")
    except KeyboardInterrupt:
        print(time.process_time(), flush=True)
"""


def processor_time(pid: int) -> float:
    """Seconds that a process has taken so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processor time is looked up in /proc")
def test_an_interrupt_ends_a_large_match_at_once() -> None:
    """Between views, and by the guided search of an image."""
    command = [sys.executable, "-c", INTERRUPTED]
    environment = {**os.environ, "NUMBA_NUM_THREADS": "2"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as child:
        assert child.stdout is not None
        for _ in range(2):
            assert child.stdout.readline() == "compiled\n"
            begun = processor_time(child.pid)
            while processor_time(child.pid) < begun + 0.5:
                assert child.poll() is None, "the match ended by itself"
                time.sleep(0.01)
            sent = processor_time(child.pid)
            child.send_signal(signal.SIGINT)
            # of two threads, by their own time: others may have the processor
            assert float(child.stdout.readline()) - sent < 1.0
