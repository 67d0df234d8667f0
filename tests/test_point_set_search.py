"""The search for the motion between two point sets: its triangles and motions against loops over all of them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.deadline import NEVER
from rootmatch.explain.sampling import sample
from rootmatch.explain.task import MatchingTask
from rootmatch.problems.points import distances
from rootmatch.samplers.point_sets import motion_search, triangles
from rootmatch.samplers.point_sets.congruent import congruent_labellings
from rootmatch.samplers.point_sets.motion_search import MotionSearch
from rootmatch.samplers.point_sets.motions import fit_motions, fit_triangles
from rootmatch.samplers.point_sets.place_grid import PlaceGrid
from rootmatch.samplers.point_sets.shown_parts import LOST, ORDERS, ShownParts

PROBLEMS = [rm.Rigid(2), rm.Rigid(3), rm.Similarity(2), rm.Similarity(3), rm.Similarity(2, mirror=True)]


def fiducials(
    problem: rm.Similarity, seed: int, n: int, matched: int, stray: int, sigma: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Plan (n, k), what a tracker reports (matched + stray, k), and the truth (n,)."""
    rng = np.random.default_rng(seed)
    k = problem.dimension
    assert k is not None
    plan = rng.uniform(-1.0, 1.0, (n, k))
    R = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-3.0, 3.0)] if k == 2 else rng.normal(size=3)).as_matrix()[:k, :k]
    if problem.mirror:
        R = R @ np.diag([-1.0, 1.0])
    moved = (1.0 if isinstance(problem, rm.Rigid) else 1.6) * plan @ R.T + rng.normal(size=k)
    seen = rng.permutation(n)[:matched]
    reported = np.vstack(
        [moved[seen] + sigma * rng.normal(size=(matched, k)), rng.uniform(moved.min(0), moved.max(0), (stray, k))]
    )
    order = rng.permutation(len(reported))
    truth = np.full(n, -1)
    truth[seen] = np.argsort(order)[:matched]
    return plan, reported[order], truth


def search_of(
    problem: rm.Similarity, source: np.ndarray, target: np.ndarray, sigma: float, **options: object
) -> MotionSearch:
    task = MatchingTask.of(problem, source, target, noise=(0.0, sigma), **options).sampling_task  # type: ignore[arg-type]
    assert task.clouds is not None
    return MotionSearch(task, task.clouds, NEVER)


@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize("masked", [False, True])
def test_triangles_that_are_alike(problem: rm.Similarity, masked: bool) -> None:
    """Against loops over all triples of targets, each judged by the lengths of its sides."""
    sigma, gate = 0.02, triangles.GATE
    source, target, _ = fiducials(problem, 1, 8, 8, 3, sigma)
    allowed = np.random.default_rng(0).random((8, 11)) < 0.7 if masked else None
    search = search_of(problem, source, target, sigma, candidates=allowed)
    clouds, allowed = search.clouds, search.allowed
    side = lambda points, i, j: float(np.linalg.norm(points[i] - points[j]))  # noqa: E731
    exact, noisy = 1e-6, sigma**2  # variance 0 is taken as (1e-6)²
    for a, b, c in ((0, 1, 2), (5, 3, 7)):
        expected = []
        for k, l, m in itertools.permutations(range(11), 3):  # noqa: E741
            if allowed is not None and not (allowed[a, k] and allowed[b, l] and allowed[c, m]):
                continue
            sides = (((a, b), (k, l)), ((b, c), (l, m)), ((a, c), (k, m)))
            lengths = [(side(clouds.source, *one), side(clouds.target, *other)) for one, other in sides]
            longest, its_image = max(lengths)
            s = its_image / longest if clouds.scaled else 1.0
            first = 2.0 * noisy + 2.0 * s * s * exact**2
            of_scale = first / longest**2 if clouds.scaled else 0.0
            close = True
            for length, image in lengths:
                of_side = of_scale if length < longest else 0.0
                close &= abs(image - s * length) <= gate * np.sqrt(first + of_side * length**2)
            if close:
                expected.append((k, l, m))
        of_source, of_target = search.triangles
        triple = np.array([[c, a, b], [a, b, c]])
        for _ in range(4):  # side by side at first, then by a table of shapes
            found = of_target.alike(triple, of_source.far, clouds.source_variance, allowed, search.rng)
            assert_same_triangles(found, expected)
    assert (of_target._shapes is not None) is clouds.scaled


def assert_same_triangles(found: triangles.Alike, expected: list[tuple[int, int, int]]) -> None:
    """Those of a triple in two orders of its corners."""
    assert found.share.tolist() == [1.0, 1.0]
    first, second = (found.corners[found.number == k] for k in range(2))
    assert sorted(map(tuple, first[:, [1, 2, 0]].tolist())) == sorted(expected)
    assert sorted(map(tuple, second.tolist())) == sorted(expected)


def test_motions_are_those_of_scipy() -> None:
    rng = np.random.default_rng(0)
    source, weight = rng.normal(size=(4, 6, 3)), rng.uniform(0.5, 2.0, (4, 6))
    target = source @ Rotation.random(rng=rng).as_matrix().T + 0.1 * rng.normal(size=(4, 6, 3)) + 3.0
    motions = fit_motions(source, target, False, False, weight)
    for k in range(4):
        middle, middle2 = (np.average(points[k], axis=0, weights=weight[k]) for points in (source, target))
        expected, _ = Rotation.align_vectors(target[k] - middle2, source[k] - middle, weight[k])
        np.testing.assert_allclose(motions.linear[k], expected.as_matrix(), atol=1e-9)
        np.testing.assert_allclose(motions.shift[k], middle2 - expected.as_matrix() @ middle, atol=1e-9)


@pytest.mark.parametrize("problem", PROBLEMS[:4])
def test_motions_of_triangles_are_the_least_squares_ones(problem: rm.Similarity) -> None:
    source, target, truth = fiducials(problem, 4, 12, 12, 0, 0.01)
    triples = ShownParts(source, distances(source), np.random.default_rng(0)).triples(40)
    scaled = not isinstance(problem, rm.Rigid)
    corners = source[triples], target[truth[triples]]
    found, expected = fit_triangles(*corners, scaled, False), fit_motions(*corners, scaled, False)
    for own, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(own, other, atol=1e-9)


@pytest.mark.parametrize("problem", PROBLEMS[:4])
@pytest.mark.parametrize("noise", [0.002, 0.2])
@pytest.mark.parametrize("masked", [False, True])
def test_points_near_targets_are_all_found_by_their_places(problem: rm.Similarity, noise: float, masked: bool) -> None:
    """Motions of triples drawn at random put most points beyond the targets, and some have a large scale."""
    rng = np.random.default_rng(5)
    source, target, _ = fiducials(problem, 5, 30, 20, 10, noise)
    task = MatchingTask.of(problem, source, target, noise=(0.5 * noise, noise)).sampling_task
    assert task.clouds is not None
    allowed = rng.random((30, 30)) < 0.7 if masked else None
    chosen = [np.array([rng.choice(30, 3, replace=False) for _ in range(300)]) for _ in range(2)]
    motions = fit_motions(source[chosen[0]], target[chosen[1]], not isinstance(problem, rm.Rigid), False)
    found = PlaceGrid(task.clouds, 8.0, allowed).pairs(motions)
    # the task has its points in another order
    squared, variance = motions.squares(task.clouds)
    near = squared <= 64.0 * variance
    if allowed is not None:
        near &= allowed
    own, edge = (
        set(zip(found.motion.tolist(), found.source.tolist(), found.target.tolist(), strict=True)),
        64.0 * variance,
    )
    assert own ^ set(map(tuple, np.argwhere(near).tolist())) <= set(
        map(tuple, np.argwhere(abs(squared - edge) < 1e-9 * edge).tolist())
    )
    np.testing.assert_allclose(found.square, squared[tuple(found[:3])], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.variance, variance[tuple(found[:3])])
    assert PlaceGrid(task.clouds, 8.0, allowed).explained(motions).tolist() == (
        np.minimum(near.any(axis=2).sum(axis=1), near.any(axis=1).sum(axis=1)).tolist()
    )


def most_explained(source: np.ndarray, target: np.ndarray, within: float) -> int:
    """Points that the best of all motions explains: every triple on every triple of targets, by scipy."""
    best = 0
    for i in itertools.combinations(range(len(source)), 3):
        for j in itertools.permutations(range(len(target)), 3):
            first, second = source[list(i)], target[list(j)]
            sides = [np.linalg.norm(x - np.roll(x, 1, 0), axis=1) for x in (first, second)]
            if np.abs(sides[0] - sides[1]).max() > 2.0 * within:
                continue
            R, _ = Rotation.align_vectors(second - second.mean(axis=0), first - first.mean(axis=0))
            moved = R.apply(source - first.mean(axis=0)) + second.mean(axis=0)
            best = max(best, int((np.linalg.norm(moved[:, None] - target, axis=-1).min(axis=1) < within).sum()))
    return best


def test_the_best_motion_of_all_is_found() -> None:
    for seed in range(3):
        source, target, truth = fiducials(rm.Rigid(3), seed, 7, 5, 3, 0.005)
        search = search_of(rm.Rigid(3), source, target, 0.005)
        search.run()
        explained = int((search.hypotheses[0].assignment >= 0).sum())
        assert explained >= most_explained(source, target, 3.0 * 0.005)
        assert explained >= (truth >= 0).sum()


@pytest.mark.parametrize("problem", [rm.Rigid(), rm.Similarity()])
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_hundred_against_a_hundred(problem: rm.Similarity, dimension: int) -> None:
    """Half of the markers are missing, half of what is reported is stray; the dimension is that of the points."""
    settled = type(problem)(dimension)
    for seed in range(2):
        plan, reported, truth = fiducials(settled, seed, 100, 50, 50, 0.001)
        match = rm.match(plan, reported, problem, noise=(0.0, 0.001))
        assert match.status is rm.Status.MATCHED
        matched = match.assignment >= 0
        assert matched.sum() >= 45
        # in a plane a stray point may lie as near as the right one
        assert (match.assignment == truth)[matched].mean() >= 0.95
        (pose,) = match.poses
        assert pose is not None
        assert pose.covariance is not None
        assert pose.rms_sigma == pytest.approx(1.0, abs=0.3)
        assert len(pose.R) == dimension


@pytest.mark.parametrize("problem", PROBLEMS[:4])
def test_few_candidates_are_searched_as_many_are(problem: rm.Similarity) -> None:
    """However few hyper-edges are left, the model needs what a search proposes; of one body and of several."""
    plan, reported, truth = fiducials(problem, 0, 40, 16, 28, 0.001)
    right = np.zeros((40, 44), np.bool_)
    right[np.arange(40), truth] = truth >= 0
    for wrong in (0.0, 0.04):
        candidates = right | (np.random.default_rng(1).random(right.shape) < wrong)
        told = {"noise": (0.0, 0.001), "candidates": candidates}
        match, guided = (rm.match(plan, reported, problem, **told, sampler=by) for by in (None, "guided"))  # type: ignore[arg-type]
        assert match.status is guided.status is rm.Status.MATCHED
        assert (match.assignment == guided.assignment).all()
        assert (match.assignment == truth).all()
    stray = np.random.default_rng(2).uniform(-1.0, 1.0, (40, plan.shape[1]))
    both, allowed = np.vstack([plan, stray]), np.vstack([right, right])
    found = rm.match(both, reported, problem, noise=(0.0, 0.001), candidates=allowed, bodies=["a"] * 40 + ["b"] * 40)
    assert found.bodies is not None
    assert found.bodies["a"].status is rm.Status.MATCHED
    assert not found.bodies["b"]


@pytest.mark.parametrize(("problem", "stray"), [(rm.Rigid(3), 0), (rm.Rigid(3), 20), (rm.Similarity(3), 5)])
def test_a_part_about_one_place_is_found(problem: rm.Similarity, stray: int) -> None:
    """The fifteen nearest to a place of 150 points, as a camera in space shows a part of a large object."""
    for seed in range(2):
        plan, reported, truth = fiducials(problem, seed, 150, 150, stray, 0.0005)
        distance = np.linalg.norm(plan - plan[seed], axis=1)
        hidden = truth[np.argsort(distance)[15:]]
        left = np.setdiff1d(np.arange(len(reported)), hidden)
        match = rm.match(plan, reported[left], problem, noise=(0.0, 0.0005))
        assert match.status is rm.Status.MATCHED
        shown = np.argsort(distance)[:15]
        assert (left[match.assignment[shown]] == truth[shown]).all()


def test_what_was_missed_is_the_share_of_parts_that_no_triple_is_all_in() -> None:
    """Against drawing parts anew and looking whether one of the triples that were tried lies in each."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.0, 1.0, (60, 3))
    parts = ShownParts(points, distances(points), rng)
    triples = parts.triples(40)
    assert all(len(set(one)) == 3 for one in triples.tolist())
    assert parts.missed(10) == 1.0
    parts.add(triples, np.ones(40))
    fresh = ShownParts(points, distances(points), np.random.default_rng(1))
    for shown in (6, 20, 40):
        left = []
        for order in fresh._draw_places(2_000)[1]:
            part = set(np.argsort(order)[:shown].tolist())
            left.append(LOST ** sum(part.issuperset(one) for one in triples.tolist()))
        # so many orders stand for all of them
        assert abs(parts.missed(shown) - np.mean(left)) < 4.0 * np.std(left) / np.sqrt(ORDERS)
    assert parts.missed(6) > parts.missed(20) > parts.missed(40)


def test_all_triples_of_few_points_are_tried_once() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.0, 1.0, (9, 3))
    parts = ShownParts(points, distances(points), rng)
    every = []
    while not parts.is_exhausted:
        every.append(parts.triples(12))
        parts.add(every[-1], np.ones(len(every[-1])))
    assert sorted(map(tuple, np.concatenate(every).tolist())) == list(itertools.combinations(range(9), 3))
    assert parts.missed(4) == 0.0


def test_triples_without_a_motion_that_was_judged_wait() -> None:
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (9, 3))
    parts = ShownParts(points, distances(points), np.random.default_rng(0))
    first = parts.triples(84)
    parts.add(first, np.repeat([1.0, 0.0], 42))
    assert sorted(map(tuple, parts.triples(84).tolist())) == sorted(map(tuple, first[42:].tolist()))
    parts.add(first[42:], np.ones(42))
    assert parts.is_exhausted
    assert parts.missed(4) == 0.0


def test_where_noise_makes_most_triples_alike_the_budget_holds() -> None:
    """The motions of each triple would take as long as all of the budget; what it leaves out is told."""
    rng = np.random.default_rng(0)
    sigma = np.where(np.arange(24) < 6, 0.005, 0.4)
    source, R = rng.uniform(-1.0, 1.0, (24, 3)), Rotation.random(random_state=0).as_matrix()
    target = 1.5 * (source + sigma[:, None] * rng.normal(size=(24, 3))) @ R.T
    task = MatchingTask.of(rm.Similarity(), source, target, noise=(sigma, 0.0075)).sampling_task
    assert task.clouds is not None
    search = MotionSearch(task, task.clouds, NEVER)
    budget = 20_000_000
    search.run(budget)
    assert budget <= search.evaluated < 1.2 * budget
    assert search.missed > 0.05
    assert search.conclusive
    assert search.hypotheses[0].motion.scale[0] == pytest.approx(1.5, rel=0.02)


def test_a_fifth_is_enough() -> None:
    plan, reported, truth = fiducials(rm.Rigid(3), 3, 100, 20, 80, 0.002)
    match = rm.match(plan, reported, rm.Rigid(), noise=(0.0, 0.002))
    assert match.status is rm.Status.MATCHED
    assert (match.assignment == truth).mean() > 0.97


def test_unrelated_points_are_not_trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    monkeypatch.setattr(motion_search, "TRIPLES", 200)
    source, target = rng.uniform(-1.0, 1.0, (2, 40, 3))
    match = rm.match(source, target, rm.Rigid(), noise=(0.0, 0.01), sampler=rm.Guided())
    assert match.status is rm.Status.UNTRUSTED


def test_markers_that_look_alike_turned_by_half_are_ambiguous() -> None:
    rng = np.random.default_rng(0)
    half = rng.uniform(-1.0, 1.0, (12, 3))
    plan = np.vstack([half, half * [-1.0, -1.0, 1.0]])
    reported = plan[rng.permutation(24)] @ Rotation.from_rotvec([0.3, 0.2, 0.5]).as_matrix().T
    match = rm.match(plan, reported + 0.001 * rng.normal(size=(24, 3)), rm.Rigid(), noise=(0.0, 0.001))
    assert match.status is rm.Status.AMBIGUOUS


@pytest.mark.parametrize("source", [np.zeros((5, 4)), np.zeros(5), [[1, 2], [3]]])
def test_points_that_settle_no_dimension_are_refused(source: object) -> None:
    with pytest.raises(rm.InputError, match="source"):
        rm.match(source, np.eye(3), rm.Rigid())  # type: ignore[arg-type]


def test_a_search_ends_once_nothing_beyond_chance_can_have_been_missed() -> None:
    rng = np.random.default_rng(1500)
    source, target = rng.uniform(-100.0, 100.0, (2, 20, 3))
    search = search_of(rm.Rigid(3), source, target, 1.0)
    search.run()
    assert not search.conclusive
    assert search.tried < motion_search.TRIPLES / 4
    assert search._miss_probability(search.level) < motion_search.MISSED


def test_what_a_search_found_is_judged_though_it_is_not_beyond_chance() -> None:
    """No sweep takes its place: hyper-edges tell the model of two point sets nothing."""
    rng = np.random.default_rng(1501)
    source, target = rng.uniform(-100.0, 100.0, (2, 30, 3))
    task = MatchingTask.of(rm.Rigid(3), source, target, noise=1.0)
    sampled = sample(task)
    assert not sampled.conclusive
    assert sampled.assignments is not None
    assert sampled.evaluated < task.sampling_task.sweep_cost / 4


def test_motions_that_explain_their_own_triple_alone_are_of_no_account() -> None:
    source, target, _ = fiducials(rm.Rigid(3), 2, 15, 12, 5, 0.01)
    task = MatchingTask.of(rm.Rigid(3), source, target, noise=0.01).sampling_task
    assert task.clouds is not None
    found = congruent_labellings(task.clouds, mirror=False).proper
    matched = (found >= 0).sum(axis=1)
    assert (matched == 3).mean() < 0.1  # those that lost a point when their motion was fitted
    assert matched.max() == 12
    few, seen, _ = fiducials(rm.Rigid(3), 2, 6, 4, 3, 0.01)
    task = MatchingTask.of(rm.Rigid(3), few, seen, noise=0.01).sampling_task
    assert task.clouds is not None
    matched = (congruent_labellings(task.clouds, mirror=False).proper >= 0).sum(axis=1)
    assert (matched.min(), matched.max()) == (3, 4)
