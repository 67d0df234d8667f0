"""What a deadline leaves out: work is counted by a clock that stands still, or that moves on with each look or unit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rootmatch.cameras.pinhole import Camera
from rootmatch.deadline import NEVER, Deadline, OutOfTime, checkpoint
from rootmatch.explain import body_labels, known_rotation, point_set_decision
from rootmatch.explain.decide import Status
from rootmatch.explain.explain import explain
from rootmatch.explain.match_options import MatchOptions
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.assignment import SECONDS_PER_STEP
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.model import mode_search, point_set_posterior, prediction, two_view_posterior, weighed_labellings
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.mode_search import find_modes
from rootmatch.model.modes import Modes
from rootmatch.model.pose_density import Gaussian
from rootmatch.model.prediction import propose_about
from rootmatch.model.proposals import Proposals
from rootmatch.model.two_view_model import TwoViewModel
from rootmatch.problems.derived import evaluator
from rootmatch.problems.p3p.problem import P3P
from rootmatch.problems.pose_fit.pose_prior import PosePrior
from rootmatch.problems.similarity.problem import Rigid
from rootmatch.problems.up2pf.problem import UP2PF
from rootmatch.samplers.guided import visible_search
from rootmatch.samplers.guided.sampler import Guided
from rootmatch.samplers.guided.visible_search import choose_search
from rootmatch.samplers.point_sets import triangles
from rootmatch.samplers.point_sets.motion_search import MotionSearch
from rootmatch.solvers.base import SECONDS_PER_PAIR, Solution, empty_solution, solve_tensor
from test_deadline import Clock

CAMERA = Camera(900.0, 900.0, 640.0, 480.0)


class Body:
    """Eight points before a camera, seen among clutter: a model, and proposals of which the first is true."""

    def __init__(self, clutter: int = 12) -> None:
        rng = np.random.default_rng(5)
        self.points = rng.uniform(-0.1, 0.1, (8, 3))
        self.R = Rotation.random(random_state=5).as_matrix()
        self.position = np.array([0.1, -0.05, 0.8])
        self.centre = self.points.mean(axis=0)
        pixels = CAMERA.project((self.points - self.centre) @ self.R.T + self.position)
        self.target = np.concatenate([pixels, rng.uniform((0, 0), (1280, 960), (clutter, 2))])
        self.target += rng.normal(0.0, 0.4, self.target.shape)
        self.model = DetectionModel(CAMERA, self.points, self.target, np.full(len(self.target), 0.4))
        turns = Rotation.random(5, random_state=6).as_matrix()
        assignments = np.array([np.arange(8), *(rng.permutation(len(self.target))[:8] for _ in turns)])
        rotation = np.concatenate([self.R[None], turns])
        self.proposals = Proposals(assignments, rotation, np.tile(self.position, (len(rotation), 1)))


@pytest.fixture(scope="module")
def body() -> Body:
    return Body()


def assert_same(one: Modes, other: Modes) -> None:
    assert np.array_equal(one.assignments, other.assignments)
    assert np.array_equal(one.log_mass, other.log_mass)


@pytest.fixture
def every_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    """No mode and no proposal is left out for what it says."""
    monkeypatch.setattr(mode_search, "NEGLIGIBLE", 1e6)
    monkeypatch.setattr(mode_search, "HOPELESS", 1e6)


@pytest.mark.usefixtures("every_mode")
@pytest.mark.parametrize(("wanted", "weighed"), [(2.5, 2), (1.0, 1), (0.3, 1), (1e6, 6)])
def test_as_many_proposals_are_weighed_as_end_in_time(
    body: Body, wanted: float, weighed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen, possible = [], mode_search._settle_possible

    def counted(model: DetectionModel, proposals: Proposals, *arguments: Any, **options: Any) -> Any:
        seen.append(len(proposals.assignments))
        return possible(model, proposals, *arguments, **options)

    monkeypatch.setattr(mode_search, "_settle_possible", counted)
    each = mode_search.SECONDS_PER_DENSITY * body.model.shape[1] * len(body.model.clutter.centres)
    deadline = Deadline(wanted * each, clock=Clock())
    with deadline.enforce():
        found = find_modes(body.model, body.proposals)
    assert seen == [weighed]
    assert deadline.stopped_early == (weighed < 6)
    assert_same(found, find_modes(body.model, body.proposals.take(np.arange(weighed))))


def test_no_proposal_is_weighed_after_the_deadline(body: Body) -> None:
    with Deadline(1.0, clock=Clock(2.0)).enforce(), pytest.raises(OutOfTime):
        find_modes(body.model, body.proposals)


@pytest.mark.usefixtures("every_mode")
def test_modes_are_grown_until_the_deadline_the_strongest_first(body: Body, monkeypatch: pytest.MonkeyPatch) -> None:
    clock, taken, before = Clock(), [], mode_search._add_mode

    def slow(kept: Any, mode: Any) -> Any:
        taken.append(mode.log_odds)
        clock.now += 1.0
        return before(kept, mode)

    monkeypatch.setattr(mode_search, "_add_mode", slow)
    find_modes(body.model, body.proposals)
    every = taken.copy()
    assert len(every) > 3
    assert every[0] == max(every)
    for seconds, count in ((2.5, 3), (1.0, 1)):
        clock.now = 0.0
        taken.clear()
        deadline = Deadline(seconds, clock=clock)
        with deadline.enforce():
            found = find_modes(body.model, body.proposals)
        assert taken == every[:count]
        assert deadline.stopped_early
        assert (found.assignments[0] == np.arange(8)).all()


def test_a_solver_is_not_begun_whose_tables_would_be_late() -> None:
    shape, calls = (30, 40), []
    tensor = AffinityTensor.unchecked(np.empty((0, 3), np.int32), np.empty(0), shape)

    def solver(tensor: AffinityTensor, *, seed: int = 0, deadline: Deadline = NEVER) -> Solution:
        calls.append(deadline)
        return empty_solution(tensor)

    tables = SECONDS_PER_PAIR * 30 * 40
    for seconds, begun in ((0.9 * tables, False), (1.1 * tables, True)):
        calls.clear()
        deadline = Deadline(seconds, clock=Clock())
        with deadline.enforce():
            solution = solve_tensor(solver, tensor, 0, deadline)
        assert calls == [deadline] * begun
        assert solution.converged == begun
        assert deadline.stopped_early != begun
        assert solution.assignment.shape == (30,)
        assert (solution.assignment == -1).all()


def test_a_solver_that_a_deadline_ends_has_found_nothing() -> None:
    tensor = AffinityTensor.unchecked(np.empty((0, 3), np.int32), np.empty(0), (3, 4))
    clock = Clock()

    def solver(tensor: AffinityTensor, *, seed: int = 0) -> Solution:
        clock.now += 2.0
        checkpoint()
        raise AssertionError("beyond the deadline")

    deadline = Deadline(1.0, clock=clock)
    with deadline.enforce():
        solution = solve_tensor(solver, tensor, 0, deadline)
    assert not solution.converged
    assert solution.assignment.tolist() == [-1, -1, -1]


def test_congruent_bodies_are_compared_until_the_deadline() -> None:
    rng = np.random.default_rng(7)
    first = rng.uniform(-1.0, 1.0, (12, 3))
    order = rng.permutation(12)
    second = (first @ Rotation.random(random_state=7).as_matrix().T)[order]
    body_labels.twin_points.cache_clear()  # of another test
    with Deadline(6.5, clock=Clock(1.0)).enforce(), pytest.raises(OutOfTime):
        body_labels.twin_points(first, second)  # in the midst of the rows
    late = Deadline(0.9 * SECONDS_PER_STEP * 12**3, clock=Clock())
    with late.enforce(), pytest.raises(OutOfTime):
        body_labels.twin_points(first, second)  # before the assignment, which is made whole
    assert late.stopped_early
    with Deadline(1.1 * SECONDS_PER_STEP * 12**3, clock=Clock()).enforce():
        found = body_labels.twin_points(first, second)
    assert found is not None  # what was cut off is not remembered as none
    assert np.array_equal(order[found], np.arange(12))


def test_pairs_of_large_point_sets_are_not_sorted_late() -> None:
    rng = np.random.default_rng(3)
    source = rng.uniform(-1.0, 1.0, (12, 3))
    target = source @ Rotation.random(random_state=3).as_matrix().T
    task = MatchingTask.of(Rigid(3), source, target, noise=0.01, options=MatchOptions(), deadline=NEVER)
    model = point_set_decision.make_point_set_model(task)
    assert model is not None
    seconds = triangles.SECONDS_PER_PAIR * 12**2
    arguments = task.sampling_task, model.clouds, NEVER
    with Deadline(0.9 * seconds, clock=Clock()).enforce(), pytest.raises(OutOfTime):
        MotionSearch(*arguments)
    with Deadline(1.1 * seconds, clock=Clock()).enforce():
        assert [len(of.lengths) for of in MotionSearch(*arguments).triangles] == [66, 66]


def looks_at(clock: Clock, work: Callable[[], Any]) -> int:
    """How often work looks at a deadline that does not pass."""
    with Deadline(1e6, clock=clock).enforce():
        before = clock.now
        work()
    return round(clock.now - before)


def test_neighbours_of_labellings_are_weighed_until_the_deadline() -> None:
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    rng = np.random.default_rng(4)
    target = corners @ Rotation.random(random_state=4).as_matrix().T + 0.01 * rng.normal(size=corners.shape)
    task = MatchingTask.of(Rigid(3), corners, target, noise=0.01, options=MatchOptions(), deadline=NEVER)
    model = point_set_decision.make_point_set_model(task)
    assert model is not None
    turned = np.array([4, 5, 0, 1, 6, 7, 2, 3])  # a cube is symmetric: what exchanges labels is looked at too
    proposals = model.judge(np.array([np.arange(8), turned]))
    free = point_set_posterior.weigh_point_set_posterior(model, proposals)
    clock = Clock(1.0)
    looks = looks_at(clock, lambda: point_set_posterior.weigh_point_set_posterior(model, proposals))
    assert looks > 1 + len(proposals.log_odds)  # all of them, each one's neighbours, and each exchange
    for maximum in range(looks):
        with Deadline(maximum + 0.5, clock=Clock(1.0)).enforce(), pytest.raises(OutOfTime):
            point_set_posterior.weigh_point_set_posterior(model, proposals)
    with Deadline(looks + 0.5, clock=Clock(1.0)).enforce():
        found = point_set_posterior.weigh_point_set_posterior(model, proposals)
    assert np.array_equal(found.probabilities, free.probabilities)


def test_point_sets_that_a_deadline_ends_are_not_trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    source = rng.uniform(-1.0, 1.0, (30, 3))
    target = source @ Rotation.random(random_state=3).as_matrix().T + 0.01 * rng.normal(size=source.shape)
    clock, before = Clock(), weighed_labellings._select_best

    def slow(*arguments: Any) -> Any:
        clock.now += 1.0
        return before(*arguments)

    monkeypatch.setattr(weighed_labellings, "_select_best", slow)
    for seconds, status in ((0.5, Status.UNTRUSTED), (1e6, Status.MATCHED)):
        clock.now = 0.0
        task = MatchingTask.of(
            Rigid(3), source, target, noise=0.01, options=MatchOptions(), deadline=Deadline(seconds, clock=clock)
        )
        assert explain(task).status is status
        assert task.deadline.stopped_early == (status is Status.UNTRUSTED)


def test_pairs_of_two_views_are_not_listed_late(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(8)
    bearings = [np.array([*rng.normal(size=(2, count)), np.ones(count)]).T for count in (12, 9)]
    bearings = [each / np.linalg.norm(each, axis=1, keepdims=True) for each in bearings]
    views = TwoViewModel(*bearings, np.full(12, 1e-6), np.full(9, 1e-6), np.zeros(9), weighs_parts=False)
    rows, columns = two_view_posterior.possible_pairs(views)
    assert rows.tolist() == [k // 9 for k in range(12 * 9)]
    assert columns.tolist() == [k % 9 for k in range(12 * 9)]
    listed = []

    def counted(model: Any) -> Any:
        listed.append(model)
        raise OutOfTime  # what follows is not of interest

    monkeypatch.setattr(two_view_posterior, "possible_pairs", counted)
    nothing = np.full((1, 12), -1)
    told = two_view_posterior.sample_two_view_posterior(views, nothing)  # of which no list is made, and no table
    assert not told.parts
    unmatched = told.confidence_in(nothing[0])
    assert "marginals" not in vars(told)
    assert not told.marginals.any()
    assert unmatched == pytest.approx(np.full(12, (1.0 - two_view_posterior.WRONG_MODEL) * 0.5 / (1.0 - 0.5 * 0.9)))
    some = np.where(np.arange(12) < 9, np.arange(12), -1)[None]
    for share, count in ((0.9, 0), (1.1, 1)):
        deadline = Deadline(share * two_view_posterior.SECONDS_PER_PAIR * 12 * 9, clock=Clock())
        with deadline.enforce(), pytest.raises(OutOfTime):
            two_view_posterior.sample_two_view_posterior(views, some)
        assert len(listed) == count


def test_tables_of_a_derived_problem_are_made_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    problem = UP2PF((320, 240), (0, 1, 0), (0, 1, 0))
    points, pixels = rng.uniform(-1.0, 1.0, (9, 3)), rng.uniform(0.0, 480.0, (20, 2))
    task = MatchingTask.of(problem, points, pixels, noise=0.5, options=MatchOptions(), deadline=NEVER)

    def tables() -> dict[str, Any]:
        made = problem.tables(task.points)
        return {name: value for name, value in made._asdict().items() if name != "tag"}

    whole = tables()
    assert {"target_pair", "target_pair_noise"} <= set(whole)
    looks = looks_at(Clock(1.0), tables)
    monkeypatch.setattr(evaluator, "CELLS", 60)  # three rows of pairs of detections
    clock = Clock(1.0)
    assert looks_at(clock, tables) > 3 * looks
    pieces = tables()
    for name, value in whole.items():
        assert np.array_equal(pieces[name], value), name
    with Deadline(1.5, clock=Clock(1.0)).enforce(), pytest.raises(OutOfTime):
        tables()
    with Deadline(looks + 1.5, clock=Clock(1.0)).enforce(), pytest.raises(OutOfTime):
        tables()  # in the midst of it


def about(body: Body, off: NDArray[np.float64]) -> Gaussian:
    """A prediction off by a rotation vector and a movement, wide enough for it."""
    R = Rotation.from_rotvec(off[:3]).as_matrix() @ body.R
    return Gaussian(R, body.position + off[3:], np.diag([0.15**2] * 3 + [0.05**2] * 3))


def test_what_a_prediction_proposes_by_the_deadline_is_handed_on(body: Body, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = about(body, np.array([0.2, -0.2, 0.2, 0.05, -0.04, 0.05]))
    clock, rounds, before = Clock(), [0], prediction.settle_assignment

    def slow(*arguments: Any, **options: Any) -> Any:
        clock.now += 1.0
        rounds[0] += 1
        return before(*arguments, **options)

    monkeypatch.setattr(prediction, "settle_assignment", slow)
    whole = propose_about(body.model, wrong)
    assert whole is not None
    total = rounds[0]
    assert total > 2  # the first one does not convince
    kept = {row.tobytes() for row in whole.assignments}
    counts = []
    for seconds in (1.5, 2.5, 1e6):
        clock.now, rounds[0] = 0.0, 0
        with Deadline(seconds, clock=clock).enforce():
            found = propose_about(body.model, wrong)
        counts.append(rounds[0])
        assert found is not None
        assert {row.tobytes() for row in found.assignments} <= kept
    assert counts == [2, 3, total]


def test_no_visible_set_is_begun_that_would_end_late(body: Body, monkeypatch: pytest.MonkeyPatch) -> None:
    outward = body.points / np.linalg.norm(body.points, axis=1, keepdims=True)
    task = MatchingTask.of(P3P(CAMERA), body.points, body.target, noise=0.4, normals=outward, options=MatchOptions())
    begun, before = [0], visible_search.run_listed_tests

    def counted(*arguments: Any, **options: Any) -> Any:
        begun[0] += 1
        return before(*arguments, **options)

    monkeypatch.setattr(visible_search, "run_listed_tests", counted)
    one_set = visible_search.SECONDS_PER_TRIPLE * 20 * 19 * 18
    for seconds, some in ((0.9 * one_set, False), (1.1 * one_set, True)):
        deadline = Deadline(seconds, clock=Clock())
        search = choose_search(task.sampling_task, Guided(), deadline)
        with deadline.within():
            search.run()
        assert (begun[0] > 0) == some
        assert bool(search.hypotheses) == some
        assert deadline.stopped_early != some


def test_poses_with_a_known_rotation_are_scored_until_the_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    body = Body(3)
    t = body.position - body.R @ body.centre
    known = PosePrior(rotation=(body.R, 0.02), position=(t, 0.05))
    task = MatchingTask.of(P3P(CAMERA), body.points, body.target, noise=0.4, options=MatchOptions(), prior=known)
    clock, count, before = Clock(), [0], known_rotation._score

    def slow(*arguments: Any) -> Any:
        clock.now += 1.0
        count[0] += 1
        return before(*arguments)

    monkeypatch.setattr(known_rotation, "_score", slow)
    whole = known_rotation.propose_by_rotation(task, known, body.model)
    assert count == [1]
    monkeypatch.setattr(known_rotation, "BATCH", 1)  # a piece for each pair of matches
    pieces = known_rotation.propose_by_rotation(task, known, body.model)
    assert whole is not None
    assert pieces is not None
    assert np.array_equal(whole.assignments, pieces.assignments)
    maximum = count[0] - 1
    assert maximum > 5
    clock.now, count[0] = 0.0, 0
    deadline = Deadline(3.5, clock=clock)
    with deadline.enforce():
        some = known_rotation.propose_by_rotation(task, known, body.model)
    assert some is not None  # of the poses that were compared in half of the time
    assert count == [2]
    assert deadline.stopped_early


def test_of_pairs_of_matches_some_are_looked_at_where_time_is_short() -> None:
    few = Deadline(1000 * known_rotation.SECONDS_PER_PAIR / known_rotation.LISTED, clock=Clock())
    for deadline, count in ((NEVER, 4950), (few, 1000)):
        with deadline.enforce():
            drawn = known_rotation.draw_match_pairs(np.arange(100), np.arange(100), np.random.default_rng(0))
            first, second, share = (np.hstack(one) for one in zip(*drawn, strict=True))
        assert len(first) == count
        assert share.sum() == pytest.approx(count / 4950)
        assert len({frozenset(pair) for pair in zip(first.tolist(), second.tolist(), strict=True)}) == count
        assert (first != second).all()
        assert deadline.stopped_early == (count < 4950)
