"""Groups of several motions: the set packing, the fit of whole groups, and both together."""

from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, least_squares, milp

import rootmatch as rm
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems.up2p.group_fit import extend_upright_groups, grow_upright_groups, upright_chi2
from rootmatch.simulation import Scene, up2p_scene
from rootmatch.solvers.packing.exact_packing import best_packing, find_packing_above, relaxation, round_relaxation
from rootmatch.solvers.packing.solver import GroupPacking, weight_inside_groups
from rootmatch.solvers.packing.tabu_search import search_packing


def best_by_trying(elements: np.ndarray, values: np.ndarray, maximum: int) -> float:
    """The largest total value of disjoint sets, by trying all."""
    sets = [set(row[row >= 0].tolist()) for row in elements]
    best = 0.0
    for size in range(1, maximum + 1):
        for chosen in combinations(range(len(sets)), size):
            union = set().union(*(sets[g] for g in chosen))
            if len(union) == sum(len(sets[g]) for g in chosen):
                best = max(best, float(values[list(chosen)].sum()))
    return best


def few_sets(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Twelve sets of one to four of ten elements, and their values."""
    elements = np.full((12, 4), -1)
    for row in elements:
        size = rng.integers(1, 5)
        row[:size] = rng.choice(10, size, replace=False)
    values = rng.uniform(0.5, 3.0, 12)
    return elements, values


def are_disjoint(sets: np.ndarray) -> bool:
    used = sets[sets >= 0]
    return len(set(used.tolist())) == len(used)


@pytest.mark.parametrize("maximum", [1, 3, 12])
def test_both_searches_find_the_best_of_few(maximum: int) -> None:
    for seed in range(15):
        elements, values = few_sets(np.random.default_rng(seed))
        best = best_by_trying(elements, values, min(maximum, 10))
        relaxed = relaxation(elements, values, 10, maximum)
        assert relaxed.bound >= best - 1e-9
        for chosen in (
            search_packing(elements, values, 10, maximum, np.zeros(12, bool), 300),
            find_packing_above(0.0, elements, relaxed, maximum, 100_000),  # from nothing
        ):
            assert are_disjoint(elements[chosen])
            assert chosen.sum() <= maximum
            assert values[chosen].sum() == pytest.approx(best)
        assert not find_packing_above(best + 1e-6, elements, relaxed, maximum, 100_000).any()


def some_motions(seed: int, groups: int) -> tuple[np.ndarray, np.ndarray]:
    """Sets like those of motions: a hidden division of 60 elements into 10 sets, and many that chance made."""
    rng = np.random.default_rng(seed)
    hidden = rng.permutation(60).reshape(10, 6)
    elements = np.concatenate([hidden, [rng.choice(60, 6, replace=False) for _ in range(groups)]])
    elements[20::3, 5] = -1
    values = np.where(elements[:, 5] < 0, 6.0, 8.0) + rng.normal(0.0, 1.5, len(elements))
    values[:10] = np.abs(rng.normal(8.5, 1.0, 10))
    return elements, np.maximum(values, 0.1)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("maximum", [7, 60])
def test_best_packing_is_that_of_an_integer_programme(seed: int, maximum: int) -> None:
    elements, values = some_motions(seed, 100)
    relaxed = relaxation(elements, values, 60, maximum)
    chosen = best_packing(
        elements, values, relaxed, maximum, round_relaxation(elements, values, relaxed, maximum), 1_000_000
    )
    matrix = np.zeros((61, len(values)))
    for g, row in enumerate(elements):
        matrix[row[row >= 0], g] = 1.0
    matrix[60] = 1.0
    solved = milp(
        -values, integrality=np.ones(len(values)), bounds=Bounds(0, 1),
        constraints=LinearConstraint(matrix, -np.inf, np.append(np.ones(60), maximum)), options={"mip_rel_gap": 1e-9},
    )  # fmt: skip
    assert (matrix[:60] @ chosen).max() <= 1.0
    assert chosen.sum() <= maximum
    assert values[chosen].sum() == pytest.approx(-solved.fun, rel=1e-6)


def test_a_search_that_ends_early_keeps_what_it_began_with() -> None:
    elements, values = some_motions(9, 400)
    relaxed = relaxation(elements, values, 60, 60)
    start = round_relaxation(elements, values, relaxed, 60)
    chosen = best_packing(elements, values, relaxed, 60, start, 1)
    assert values[chosen].sum() >= values[start].sum()
    assert are_disjoint(elements[chosen])


def residuals_of_pose(parameters: np.ndarray, points: np.ndarray, rays: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Angles between predicted and seen bearings on the two axes across, over σ; written out anew."""
    angle, shift = parameters[0], parameters[1:]
    c, s = np.cos(angle), np.sin(angle)
    seen = points @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T + shift
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    return ((seen - rays) / sigma[:, None]).ravel()


@pytest.mark.parametrize("seed", range(6))
def test_chi2_of_a_group_is_that_of_the_best_pose(seed: int) -> None:
    scene = up2p_scene(6, 0, 1.0, seed)
    tables = scene.problem.prepare(scene.source, scene.target, 1.0)
    found = upright_chi2(tables.points, tables.rays, tables.variance, scene.truth[None])[0]
    points, rays = tables.points.T, tables.rays.T[scene.truth]
    rotation, shift = scene.poses[0]
    unit = np.sqrt(((scene.source - scene.source.mean(axis=0)) ** 2).mean())
    start = np.append(np.arctan2(rotation[0, 2], rotation[0, 0]), (shift + rotation @ scene.source.mean(axis=0)) / unit)
    solved = least_squares(residuals_of_pose, start, args=(points, rays, np.sqrt(tables.variance[scene.truth])))
    assert found == pytest.approx(2.0 * solved.cost, rel=1e-3)


def test_a_group_grows_to_all_that_its_pose_predicts() -> None:
    complete = 0
    for seed in range(20):
        scene = up2p_scene(8, 6, 0.5, seed)
        tables = scene.problem.prepare(scene.source, scene.target, 0.5)
        start = np.full((1, 8), -1)
        start[0, :4] = scene.truth[:4]
        grown = grow_upright_groups(
            tables.points, tables.rays, tables.variance, start, 36.0, 12.25, np.empty((0, 0), np.bool_)
        )
        complete += int((grown[0] == scene.truth).all())
        assert ((grown[0] == scene.truth) | (grown[0] < 0)).sum() >= 6
    assert complete >= 17


@pytest.mark.parametrize("masked", [False, True])
def test_a_group_is_extended_by_each_detection_near_a_prediction(masked: bool) -> None:
    scene = up2p_scene(8, 6, 0.5, 3)
    tables = scene.problem.prepare(scene.source, scene.target, 0.5)
    n, n_target = 8, 14
    groups = np.full((2, n), -1)
    groups[0, :4], groups[1, 3:] = scene.truth[:4], scene.truth[3:]
    allowed = np.random.default_rng(0).random((n, n_target)) < 0.7 if masked else np.empty((0, 0), np.bool_)
    gate2 = 300.0**2
    wanted = []
    for group in groups:
        members = np.flatnonzero(group >= 0)
        points, rays, sigma = tables.points.T, tables.rays.T, np.sqrt(tables.variance)
        rotation, shift = scene.poses[0]
        centre = scene.source.mean(axis=0)
        unit = np.sqrt(((scene.source - centre) ** 2).mean())
        start = np.append(np.arctan2(rotation[0, 2], rotation[0, 0]), (shift + rotation @ centre) / unit)
        of = points[members], rays[group[members]], sigma[group[members]]
        angle, *move = least_squares(residuals_of_pose, start, args=of, xtol=1e-12, ftol=1e-12).x
        c, s = np.cos(angle), np.sin(angle)
        seen = points @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T + move
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        for i in set(range(n)) - set(members.tolist()):
            for k in set(range(n_target)) - set(group[members].tolist()):
                near = ((seen[i] - rays[k]) ** 2).sum() / sigma[k] ** 2 <= gate2
                if near and (not masked or allowed[i, k]):
                    more = group.copy()
                    more[i] = k
                    wanted.append(tuple(more.tolist()))
    room = np.empty((1000, n), np.int64)
    count = extend_upright_groups(tables.points, tables.rays, tables.variance, groups, gate2, allowed, room)
    assert len(wanted) > 5
    assert sorted(map(tuple, room[:count].tolist())) == sorted(wanted)
    assert extend_upright_groups(tables.points, tables.rays, tables.variance, groups, gate2, allowed, room[:1]) == count


def test_groups_are_found_among_weights_across_them() -> None:
    rng = np.random.default_rng(0)
    label, image = np.arange(12) // 4, rng.permutation(12)
    truth = [t for t in combinations(range(12), 3) if len({label[i] for i in t}) == 1]
    across = [rng.choice(12, 3, replace=False) for _ in range(300)]
    indices = [[i * 12 + image[i] for i in t] for t in truth]
    indices += [[i * 12 + k for i, k in zip(np.sort(t), rng.choice(12, 3, replace=False), strict=True)] for t in across]
    weights = np.append(rng.uniform(0.4, 1.0, len(truth)), rng.uniform(0.01, 1.0, len(across)))
    _, first = np.unique(np.array(indices), axis=0, return_index=True)
    tensor = AffinityTensor(np.array(indices, np.int32)[first], weights[first], (12, 12))
    solution = GroupPacking(motions=3, chance_weight=1e-4)(tensor)
    np.testing.assert_array_equal(solution.assignment, image)
    assert solution.groups is not None
    same = solution.groups[:, None] == solution.groups
    np.testing.assert_array_equal(same, label[:, None] == label)
    assert solution.score == pytest.approx(weight_inside_groups(tensor, image, label))
    assert solution.score < tensor.score(image) + 1e-9


def matched(scene: Scene, motions: object) -> tuple[float, bool]:
    """Accuracy, and whether the labels are right."""
    match = rm.match(scene.source, scene.target, scene.problem, noise=scene.noise, motions=motions)
    same = match.motion_labels[:, None] == match.motion_labels
    return scene.accuracy(match.assignment), bool((same == (scene.motions[:, None] == scene.motions)).all())


@pytest.mark.parametrize(("motions", "clutter"), [(2, 0), (4, 0), (2, 10)])
@pytest.mark.parametrize("told", [True, False])
def test_small_motions_are_told_apart(motions: int, clutter: int, told: bool) -> None:
    found = [
        matched(up2p_scene(5 * motions, clutter, 1.0, seed, motions), motions if told else "auto")
        for seed in range(3000, 3004)
    ]
    assert np.mean([accuracy for accuracy, _ in found]) >= 0.95
    assert np.mean([right for _, right in found]) >= 0.75


@pytest.mark.parametrize(("size", "motions", "clutter", "seeds"), [(5, 6, 0, 1), (12, 2, 0, 4), (30, 2, 0, 2)])
def test_many_motions_and_large_ones_are_told_apart(size: int, motions: int, clutter: int, seeds: int) -> None:
    found = [
        matched(up2p_scene(size * motions, clutter, 1.0, seed, motions), "auto") for seed in range(3100, 3100 + seeds)
    ]
    assert np.mean([accuracy for accuracy, _ in found]) >= 0.95
    assert np.mean([right for _, right in found]) >= 0.7


def test_a_small_motion_beside_a_large_one_stays() -> None:
    found = 0
    for seed in range(6):
        large, small = up2p_scene(12, 0, 0.5, seed), up2p_scene(5, 0, 0.5, 100 + seed)
        source = np.concatenate([large.source, small.source])
        target = np.concatenate([large.target, small.target])
        truth = np.append(large.truth, 12 + small.truth)
        match = rm.match(source, target, large.problem, noise=0.5, motions="auto")
        found += int((match.assignment == truth).mean() > 0.9 and match.motion_labels.max() == 1)
    assert found >= 5


def test_bad_options_are_refused() -> None:
    with pytest.raises(rm.InputError, match="chance"):
        GroupPacking(chance_weight=0.0)


def test_hyperedges_that_make_no_group_match_nothing() -> None:
    scene = up2p_scene(8, noise=0.01, seed=0, motions=2)
    match = rm.match(
        scene.source, scene.target, scene.problem, noise=0.01, sampler="random", samples=20, motions="auto"
    )
    assert (match.assignment == -1).all()
    assert (match.motion_labels == -1).all()
    assert match.status is rm.Status.UNTRUSTED
