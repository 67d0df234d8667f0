"""Completions of minimal sets against single predictions, plain loops and the exhaustive tensor."""

from itertools import combinations, permutations

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.algebra.directions import tangent_bases
from rootmatch.algebra.vector import tangent_basis
from rootmatch.hypergraph.affinity import affinity
from rootmatch.hypergraph.enumeration import target_arrangements
from rootmatch.problems.up2p.hypotheses import predictions
from rootmatch.samplers.base import SamplingTask
from rootmatch.samplers.completion import Completion
from rootmatch.samplers.completion_kernels import STRIDE, Completions, predict_block
from rootmatch.samplers.exhaustive import exhaustive_tensor
from rootmatch.simulation import up2p_scene


def up2p_tables(seed: int, n: int = 9, clutter: int = 3, tilt: float = 0.0, normals: bool = False):
    scene = up2p_scene(n, clutter, 1.0, seed)
    problem = rm.UP2P(scene.cameras[0], (0, 1, 0), (0, 1, 0), vertical_noise=tilt)
    facing = np.random.default_rng(seed).normal(size=(n, 3)) if normals else None
    if facing is not None:
        facing[::3] = 0.0
    return problem.prepare(scene.source, scene.target, 1.0, facing), scene


def block_of(tables, points: list[int], images: list[int], root: int) -> np.ndarray | None:
    """Rows x, y, z, s11, s12, s22, seen of all points but those of the set."""
    others = [d for d in range(tables.points.shape[1]) if d not in points]
    flat = np.zeros((7, STRIDE))
    flat[:, : len(points) + len(others)] = np.concatenate([tables.points, tables.normals])[:, points + others]
    out = np.zeros(7 * STRIDE)
    if not predict_block(tables, flat.reshape(-1), len(points) + len(others), np.array(images), root, out):
        return None
    return out.reshape(7, STRIDE)[:, len(points) : len(points) + len(others)]


@pytest.mark.parametrize(("tilt", "normals"), [(0.0, False), (0.01, False), (0.0, True), (0.01, True)])
def test_many_predictions_at_once_are_those_of_one_at_a_time(tilt: float, normals: bool) -> None:
    compared = 0
    for seed in range(4):
        tables, _ = up2p_tables(seed, tilt=tilt, normals=normals)
        n, n_target = tables.points.shape[1], tables.rays.shape[1]
        for points in ([0, 1], [2, 7], [8, 4]):
            others = [d for d in range(n) if d not in points]
            for images in permutations(range(n_target), 2):
                for root in range(2):
                    wanted = np.zeros((13, n))
                    there = predictions(tables, np.array(points), np.array(images), root, wanted)
                    found = block_of(tables, points, list(images), root)
                    assert (found is not None) == bool(there)
                    if found is None:
                        continue
                    wanted = wanted[:, others]
                    compared += len(others)
                    np.testing.assert_allclose(found[:3], wanted[:3], atol=1e-12)
                    size = wanted[9] + wanted[11]
                    # where the variance is that large, at a double root, terms cancel that are larger still
                    sound = size < 1.0
                    np.testing.assert_allclose(
                        found[3:6, sound] / size[sound], wanted[9:12, sound] / size[sound], atol=1e-7
                    )
                    firm = abs(size - 1e-2) > 1e-6
                    np.testing.assert_array_equal(found[6, firm], wanted[12, firm])
    assert compared > 2000


def test_tangent_bases_are_orthonormal_and_right_handed() -> None:
    bearings = np.concatenate([np.random.default_rng(0).normal(size=(50, 3)), np.eye(3), -np.eye(3)])
    bearings /= np.linalg.norm(bearings, axis=1, keepdims=True)
    for bearing, of_many in zip(bearings, np.stack(tangent_bases(bearings), axis=1), strict=True):
        for pair in (np.array(tangent_basis(*bearing)), of_many):
            frame = np.array([*pair, bearing])
            np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
            assert np.linalg.det(frame) > 0.0


@pytest.mark.parametrize("masked", [False, True])
def test_a_set_is_completed_by_each_detection_within_the_gate_of_a_prediction(masked: bool) -> None:
    found_in_all = 0
    for seed in range(3):
        tables, _ = up2p_tables(seed)
        n, n_target = tables.points.shape[1], tables.rays.shape[1]
        allowed = np.random.default_rng(seed).random((n, n_target)) < 0.6 if masked else np.empty((0, 0), np.bool_)
        images = target_arrangements(n_target, 2).astype(np.int64)
        base, others = np.array([6, 1]), np.array([0, 3, 8])
        found, _ = Completions(tables, images, 400.0, allowed).of(base, others)
        wanted = []
        for pair in images:
            if masked and not (allowed[6, pair[0]] and allowed[1, pair[1]]):
                continue
            for root in range(2):
                out = np.zeros((13, n))
                if not predictions(tables, base, pair, root, out):
                    continue
                for d in others:
                    for k in range(n_target):
                        if k in pair or not out[12, d] or (masked and not allowed[d, k]):
                            continue
                        away = out[3:9, d].reshape(2, 3) @ tables.rays[:, k]
                        a, c, b = out[9, d], out[10, d], out[11, d]
                        covariance = np.array([[a, c], [c, b]]) + tables.variance[k] * np.eye(2)
                        ahead = out[:3, d] @ tables.rays[:, k] > 0
                        if ahead and away @ np.linalg.solve(covariance, away) <= 400.0:
                            wanted.append((d, *pair, k))
        assert sorted(map(tuple, found.tolist())) == sorted(wanted)
        found_in_all += len(wanted)
    assert found_in_all > 10


def test_points_beyond_one_block_and_results_beyond_the_room_are_not_lost() -> None:
    scene = up2p_scene(90, 0, 3.0, 0)
    tables = scene.problem.prepare(scene.source, scene.target, 3.0)
    images = target_arrangements(90, 2).astype(np.int64)[::7]
    base, others = np.array([3, 50]), np.delete(np.arange(90), [3, 50])
    whole, evaluated = Completions(tables, images, 25.0, np.empty((0, 0), np.bool_)).of(base, others)
    single = Completions(tables, images, 25.0, np.empty((0, 0), np.bool_))
    parts = [single.of(base, others[first : first + 5])[0] for first in range(0, len(others), 5)]
    assert len(whole) > 4096
    assert evaluated > len(images)
    assert sorted(map(tuple, whole.tolist())) == sorted(map(tuple, np.concatenate(parts).tolist()))


def test_completed_tensor_has_what_exhaustion_finds_of_the_truth() -> None:
    weigh = affinity("joint", None)
    wanted = shared = 0
    for seed in range(12):
        tables, scene = up2p_tables(seed, 10, 10)
        kind = weigh.residual.kernel_kind(3)
        shape = (10, 20)
        completed = Completion()(SamplingTask(tables, kind, weigh, shape, 3))
        every, evaluated = exhaustive_tensor(tables, kind, weigh, shape, 3)
        assert completed.evaluated < evaluated
        assert not completed.partial

        def true_ones(tensor, truth=scene.truth) -> set[tuple[int, ...]]:
            source, target = np.divmod(tensor.indices, 20)
            right = (truth[source] == target).all(axis=1)
            return {tuple(sorted(row)) for row in source[right].tolist()}

        here, there = true_ones(completed.tensor), true_ones(every)
        wanted += len(there)
        shared += len(here & there)
        flat = np.sort(completed.tensor.indices, axis=1)
        assert len(np.unique(flat, axis=0)) == len(flat)
        # the mean weight of a random hyper-edge; exhaustion also keeps some by which a badly conditioned set is met
        by_chance = every.weights.sum() / evaluated
        assert 0.2 * by_chance < completed.chance < 1.05 * by_chance
    assert wanted > 0.95 * 12 * len(list(combinations(range(10), 3)))
    assert shared >= 0.99 * wanted


def test_completions_are_the_same_in_one_thread_and_two_and_obey_the_mask() -> None:
    import numba

    tables, scene = up2p_tables(1, 12, 6)
    weigh = affinity("joint", None)
    mask = np.random.default_rng(0).random((12, 18)) < 0.5
    mask[np.arange(12), scene.truth] = True
    results = []
    request = SamplingTask(tables, weigh.residual.kernel_kind(3), weigh, (12, 18), 3, candidates=mask)
    before = numba.get_num_threads()
    try:
        for threads in (1, min(2, before)):
            numba.set_num_threads(threads)
            results.append(Completion()(request))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(results[0].tensor.indices, results[1].tensor.indices)
    np.testing.assert_array_equal(results[0].tensor.weights, results[1].tensor.weights)
    source, target = np.divmod(results[0].tensor.indices, 18)
    assert len(source) > 100
    assert mask[source, target].all()


def test_more_than_can_be_listed_is_refused() -> None:
    scene = up2p_scene(400, 0, 0.5, 1)
    with pytest.raises(rm.InputError, match=r"completion: 1.06e\+07 sets of 3 source points .* sampler=.guided"):
        rm.match(scene.source, scene.target[:4], scene.problem, noise=0.5, sampler=Completion(), motions=2)


def test_what_cannot_be_completed_says_so() -> None:
    scene = rm.simulation.p3p_scene(6, 0, 1.0, 0)
    tables = scene.problem.prepare(scene.source, scene.target, 1.0)
    weigh = affinity("joint", None)
    with pytest.raises(rm.InputError, match="no predictions"):
        Completion()(SamplingTask(tables, weigh.residual.kernel_kind(2), weigh, (6, 6), 4))
    assert not Completion().pays(SamplingTask(tables, weigh.residual.kernel_kind(2), weigh, (40, 40), 4))
