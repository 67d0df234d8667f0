"""Enumeration, selection and threads of the CPU backend, against itertools and one hyper-edge at a time."""

from __future__ import annotations

import itertools
import sys
from typing import Any

import numba
import numpy as np
import pytest

import instances
import oracles
from rootmatch.backends import cpu
from rootmatch.backends.strongest import Enumeration
from rootmatch.cameras.pinhole import Camera
from rootmatch.hypergraph import enumeration
from rootmatch.hypergraph.affinity import Affinity, Residual, affinity
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.problems.p3p.problem import P3P
from rootmatch.problems.padding import pad_tables, target_columns
from rootmatch.problems.residual_dispatch import edge_residual
from rootmatch.problems.residual_kinds import QR, SVD, Joint, Normalised, QRBoth
from rootmatch.problems.three_plus_one.problem import ThreePlusOne
from rootmatch.problems.up2p.problem import UP2P
from rootmatch.samplers.exhaustive import exhaustive_tensor
from rootmatch.samplers.random import random_tensor

ORDER = {"p3p": 4, "up2p": 3, "3p1": 4}
PAIRS = {"p3p": 6, "up2p": 3, "3p1": 6}
PROBLEMS = list(ORDER)
ALL = 1e7
"""A gate that every residual passes."""


def scene(problem: str, n: int, n_target: int, seed: int = 0, sigma: float = 0.5) -> Any:
    """Tables of a scene of the paper with clutter (3P1: points that the first image lacks), or with unseen points."""
    rng = np.random.default_rng(seed)
    if problem == "3p1":
        pair = instances.paper_pair(rng, 3.0, max(n, n_target))
        noisy = [view + sigma * rng.normal(size=view.shape) for view in (pair.first[:n], pair.second[:n_target])]
        camera = Camera(*pair.intrinsics)
        return ThreePlusOne(camera, camera, axis=(0, 1, 0), axis2=(0, 1, 0)).prepare(
            noisy[0], noisy[1][rng.permutation(n_target)], sigma
        )
    made = instances.paper_scene(problem, rng, n)
    pixels = made.target[:n_target] + sigma * rng.normal(size=made.target[:n_target].shape)
    clutter = rng.uniform((0.0, 0.0), (640.0, 480.0), (max(0, n_target - n), 2))
    camera = Camera(*made.intrinsics)
    target = np.concatenate((pixels, clutter))[rng.permutation(n_target)]
    return (P3P(camera) if problem == "p3p" else UP2P(camera, (0, 1, 0), (0, 1, 0))).prepare(made.source, target, sigma)


def enumerated(tables: Any, kind: Any, n: int, n_target: int, order: int) -> dict[tuple[int, ...], float]:
    """Residual of every hyper-edge, keyed by its ascending flat correspondences."""
    source, target = (np.array(side) for side in zip(*oracles.all_hyperedges(n, n_target, order), strict=True))
    values = cpu.residuals(tables, kind, source, target).tolist()
    return dict(zip(map(tuple, (source * n_target + target).tolist()), values, strict=True))


def as_dict(tensor: Any, weigh: Affinity) -> dict[tuple[int, ...], float]:
    """Weights of a tensor, keyed by sorted flat correspondences; each hyper-edge once."""
    keys = [tuple(sorted(row)) for row in tensor.indices.tolist()]
    assert len(set(keys)) == len(keys)
    return dict(zip(keys, tensor.weights.tolist(), strict=True))


@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize("kind", [QR, QRBoth, SVD, Normalised, Joint])
def test_slabs_give_each_hyperedge_the_residual_of_its_own_kernel(problem: str, kind: type) -> None:
    """One row at a time and one hyper-edge at a time are different kernels of the same residual."""
    n, n_target, order = 6, 6, ORDER[problem]
    for seed, pairs in ((0, 0b1), (1, 0b10), (2, 0b111)):
        tables = scene(problem, n, n_target, seed)
        work = Enumeration.of(tables, kind(pairs), (n, n_target), order, None)
        codes, residuals, counts, evaluated = cpu.sweep(work, 0, work.ranks, ALL, capacity=1 << 14, chunks=1)
        assert counts[0] == evaluated[0] == enumeration.exhaustive_count(n, n_target, order)
        indices = cpu.decode(work, codes[0, : counts[0]])
        single = cpu.residuals(tables, kind(pairs), *np.divmod(indices.astype(np.int64), n_target))
        # Compiled apart, their roundings differ. P3P's |R| in closed form has a floor of its own.
        floor = 3e-8 if problem == "p3p" and kind in (QR, QRBoth) else 1e-9
        np.testing.assert_allclose(residuals[0, : counts[0]], single, rtol=1e-5, atol=floor)


def test_one_call_on_many_is_many_calls_on_one() -> None:
    tables = scene("p3p", 6, 7)
    edges = oracles.all_hyperedges(6, 7, 4)[::97]
    source, target = (np.array([edge[k] for edge in edges]) for k in (0, 1))
    together = cpu.residuals(tables, Joint(), source, target)
    single = [cpu.residuals(tables, Joint(), source[e : e + 1], target[e : e + 1])[0] for e in range(len(edges))]
    np.testing.assert_array_equal(together, single)


@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize(("n", "n_target"), [(5, 5), (5, 6), (6, 5), (4, 4), (7, 4)])
class TestExhaustive:
    """Sizes with clutter, with unseen source points (n > n'), and the least possible."""

    @pytest.mark.parametrize("name", ["joint", "normalised", "svd"])
    def test_keeps_exactly_the_hyperedges_under_the_gate(self, problem: str, n: int, n_target: int, name: str) -> None:
        order = ORDER[problem]
        tables = scene(problem, n, n_target, seed=n + n_target)
        residual = Residual(name)
        kind = residual.kernel_kind(PAIRS[problem])
        everything = enumerated(tables, kind, n, n_target, order)
        values = np.array(list(everything.values()))
        assert len(everything) == enumeration.exhaustive_count(n, n_target, order)
        # a gate in the widest gap near the middle, so that rounding decides nothing
        ranked = np.sort(values[values < 1e5])
        assert len(ranked) >= 3
        middle = len(ranked) // 2
        near = ranked[max(0, middle - 10) : middle + 10]
        wide = int(np.argmax(np.diff(near)))
        gate = 0.5 * (near[wide] + near[wide + 1])
        weigh = affinity(residual, rho=float(np.median(ranked)), gate=float(gate))
        tensor, evaluated = exhaustive_tensor(tables, kind, weigh, (n, n_target), order)
        kept = as_dict(tensor, weigh)
        expected = {key: value for key, value in everything.items() if value <= gate}
        assert set(kept) == set(expected)
        assert evaluated == len(everything)
        assert tensor.shape == (n, n_target)
        weights = weigh.weights(np.array([expected[key] for key in kept]))
        np.testing.assert_allclose(list(kept.values()), weights, rtol=1e-5)

    def test_without_a_gate_everything_is_kept_once(self, problem: str, n: int, n_target: int) -> None:
        order = ORDER[problem]
        tables = scene(problem, n, n_target)
        weigh = affinity("joint", gate=ALL)
        tensor, evaluated = exhaustive_tensor(tables, Joint(), weigh, (n, n_target), order)
        count = enumeration.exhaustive_count(n, n_target, order)
        assert len(as_dict(tensor, weigh)) == count == evaluated

    def test_a_candidate_mask_leaves_exactly_its_hyperedges(self, problem: str, n: int, n_target: int) -> None:
        order = ORDER[problem]
        tables = scene(problem, n, n_target)
        weigh = affinity("joint", gate=ALL)
        rng = np.random.default_rng(3)
        for share in (0.9, 0.6, 0.0):
            mask = rng.random((n, n_target)) < share
            tensor, evaluated = exhaustive_tensor(tables, Joint(), weigh, (n, n_target), order, candidates=mask)
            flat = mask.ravel()
            expected = {
                tuple(a * n_target + b for a, b in zip(i, j, strict=True))
                for i, j in oracles.all_hyperedges(n, n_target, order)
            }
            expected = {key for key in expected if flat[list(key)].all()}
            assert set(as_dict(tensor, weigh)) == expected
            assert len(expected) <= evaluated <= enumeration.exhaustive_count(n, n_target, order)


def test_codes_name_minimal_set_arrangement_and_last_correspondence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cpu, "DECODED", 7)  # several pieces
    n, n_target = 6, 5
    work = Enumeration.of(None, None, (n, n_target), 4, None)
    bases, arrangements = work.bases, work.arrangements
    rng = np.random.default_rng(0)
    codes, expected = [], []
    for base, order, last, target in rng.integers(0, (len(bases), len(arrangements), n, n_target), (40, 4)).tolist():
        codes.append(((base * len(arrangements) + order) * n + last) * n_target + target)
        pairs = [*zip(bases[base], arrangements[order], strict=True), (last, target)]
        expected.append([i * n_target + j for i, j in pairs])
    decoded = cpu.decode(work, np.array(codes))
    assert decoded.dtype == np.int32
    np.testing.assert_array_equal(decoded, expected)


def test_an_infinite_gate_keeps_hyperedges_only() -> None:
    """Entries of a row whose target is taken already are no hyper-edges, however wide the gate."""
    tables = scene("up2p", 5, 5)
    tensor, _ = exhaustive_tensor(tables, Joint(), affinity("joint", gate=np.inf), (5, 5), 3)
    targets = np.sort(tensor.indices % 5, axis=1)
    assert np.all(targets[:, 1:] > targets[:, :-1])
    assert tensor.size == enumeration.exhaustive_count(5, 5, 3)


class TestStrongest:
    """Streaming selection keeps the strongest, whatever the blocks are."""

    def run(self, limit: int, monkeypatch: pytest.MonkeyPatch, block: int) -> tuple[dict, dict]:
        monkeypatch.setattr("rootmatch.backends.cpu.BLOCK", block)
        tables = scene("p3p", 6, 6, seed=2)
        weigh = affinity("normalised", rho=50.0, gate=ALL)
        everything, _ = exhaustive_tensor(tables, Normalised(), weigh, (6, 6), 4)
        chosen, evaluated = exhaustive_tensor(tables, Normalised(), weigh, (6, 6), 4, max_hyperedges=limit)
        assert evaluated == enumeration.exhaustive_count(6, 6, 4)
        return as_dict(everything, weigh), as_dict(chosen, weigh)

    @pytest.mark.parametrize("limit", [1, 10, 137, 5000, 10_000])
    @pytest.mark.parametrize("block", [1, 300, 4_000_000])
    def test_the_strongest_are_kept(self, limit: int, block: int, monkeypatch: pytest.MonkeyPatch) -> None:
        everything, chosen = self.run(limit, monkeypatch, block)
        assert len(chosen) == min(limit, len(everything))
        weakest = min(chosen.values())
        better = {key for key, weight in everything.items() if weight > weakest}
        assert better <= set(chosen)
        assert all(everything[key] == weight for key, weight in chosen.items())

    def test_ties_keep_the_limit(self) -> None:
        """With a gate that all share (weights alike) the first of the stream are kept, no more than the limit."""
        tables = scene("up2p", 5, 5)
        weigh = affinity("joint", gate=ALL)
        sizes = [
            exhaustive_tensor(tables, Joint(), weigh, (5, 5), 3, max_hyperedges=limit)[0].size for limit in (1, 7, 600)
        ]
        assert sizes == [1, 7, 600]


@pytest.mark.parametrize("problem", PROBLEMS)
def test_the_result_does_not_depend_on_the_number_of_threads(problem: str) -> None:
    n, n_target, order = 8, 8, ORDER[problem]
    tables = scene(problem, n, n_target)
    weigh = affinity("joint")
    made = []
    before = numba.get_num_threads()
    try:
        for count in {1, numba.config.NUMBA_NUM_THREADS, before}:
            numba.set_num_threads(count)
            exhaustive, _ = exhaustive_tensor(tables, Joint(), weigh, (n, n_target), order, max_hyperedges=50)
            random, _ = random_tensor(tables, Joint(), weigh, (n, n_target), order, 20_000, seed=1)
            made.append((exhaustive.indices, exhaustive.weights, random.indices, random.weights))
    finally:
        numba.set_num_threads(before)
    for other in made[1:]:
        for one, two in zip(made[0], other, strict=True):
            np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize(("n", "n_target"), [(5, 6), (7, 5)])
def test_random_sampling_gives_the_weights_of_the_enumeration(problem: str, n: int, n_target: int) -> None:
    """A hyper-edge is drawn in any order of its correspondences; "joint" depends on that order beyond first order."""
    order = ORDER[problem]
    tables = scene(problem, n, n_target)
    weigh = affinity("joint", rho=1e3, gate=ALL)
    tensor, evaluated = random_tensor(tables, Joint(), weigh, (n, n_target), order, 3000, seed=4)
    assert evaluated == 3000
    count = enumeration.exhaustive_count(n, n_target, order)
    kept = as_dict(tensor, weigh)
    assert 0.5 * min(count, 3000) < len(kept) <= count
    for row, weight in itertools.islice(kept.items(), 200):
        i, j = np.divmod(np.array(row), n_target)
        values = [
            cpu.residuals(tables, Joint(), i[list(p)][None], j[list(p)][None])[0]
            for p in itertools.permutations(range(order))
        ]
        # the weight is that of one order of the correspondences
        assert np.isclose(weigh.weights(np.array(values)), weight, rtol=1e-9, atol=1e-300).any()


def test_random_sampling_respects_the_mask() -> None:
    mask = np.random.default_rng(5).random((6, 6)) < 0.6
    tables = scene("p3p", 6, 6)
    weigh = affinity("joint", gate=ALL)
    tensor, _ = random_tensor(tables, Joint(), weigh, (6, 6), 4, 2000, seed=6, candidates=mask)
    assert tensor.size > 50
    assert mask.ravel()[tensor.indices].all()


def test_the_first_samples_are_the_same_for_every_number_of_samples() -> None:
    """H_s for growing s is nested: what is in the smaller is in the larger too, with the same weight or a greater."""
    tables = scene("up2p", 6, 6)
    weigh = affinity("joint", gate=ALL)
    small, large = (random_tensor(tables, Joint(), weigh, (6, 6), 3, s, seed=7)[0] for s in (500, 5000))
    first, second = as_dict(small, weigh), as_dict(large, weigh)
    assert set(first) < set(second)
    assert all(second[key] >= weight for key, weight in first.items())


@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize("kind", [QR(), Normalised(), Joint()])
def test_room_behind_the_targets_changes_nothing(problem: str, kind: Any) -> None:
    """Loops over padded tables fill whole vectors; what is in the padding is never found."""
    n, n_target, order = 6, 9, ORDER[problem]
    tables = scene(problem, n, n_target)
    wider = pad_tables(tables, n_target)
    assert (target_columns(tables, n_target), target_columns(wider, n_target)) == (9, 16)
    gate = 1e-3 if isinstance(kind, QR) else 2.0
    every = [Enumeration.of(each, kind, (n, n_target), order, None) for each in (tables, wider)]
    found = [cpu.sweep(work, 0, 60 * len(work.bases), gate, capacity=1 << 16, chunks=3) for work in every]
    (codes, residuals, counts, evaluated), (codes2, residuals2, counts2, evaluated2) = found
    assert 0 < counts.max() <= 1 << 16
    np.testing.assert_array_equal(counts, counts2)
    np.testing.assert_array_equal(evaluated, evaluated2)
    for chunk, count in enumerate(counts):
        np.testing.assert_array_equal(codes[chunk, :count], codes2[chunk, :count])
        np.testing.assert_allclose(residuals[chunk, :count], residuals2[chunk, :count], rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("facing", [False, True])
def test_lists_give_each_hyperedge_the_residual_of_its_own_kernel_wherever_it_stands(facing: bool) -> None:
    """P3P's joint residual is computed for many at once in lists, and one hyper-edge at a time elsewhere."""
    rng = np.random.default_rng(5)
    made = instances.paper_scene("p3p", rng, 8)
    pixels = made.target + rng.normal(size=made.target.shape)
    normals = np.zeros((8, 3))
    normals[6:] = rng.normal(size=(2, 3)) if facing else 0.0
    tables = P3P(Camera(*made.intrinsics)).prepare(made.source, pixels, 1.0, normals)
    source = np.array([rng.permutation(8)[:4] for _ in range(1500)])
    target = np.where(rng.random((1500, 1)) < 0.5, source, np.array([rng.permutation(8)[:4] for _ in range(1500)]))
    whole = cpu.residuals(tables, Joint(1), source, target)
    alone = np.array([edge_residual(tables, Joint(1), i, j) for i, j in zip(source, target, strict=True)])
    assert np.array_equal(whole < 1e5, alone < 1e5)
    assert whole == pytest.approx(alone, rel=1e-6)
    assert 50 < (whole < 3.5).sum() < 1450
    for first, last in ((0, 1), (3, 66), (10, 74), (70, 1200)):
        assert np.array_equal(
            cpu.residuals(tables, Joint(1), source[first:last], target[first:last]), whole[first:last]
        )


def test_arrays_without_an_owner_are_the_same_arrays_and_nobody_counts_them() -> None:
    @numba.njit
    def through(pair, line):  # type: ignore[no-untyped-def]
        (first, second), line = borrow(pair), borrow(line)
        for k in range(line.size):
            part = first[k]
            line[k] = part[0] + second[k]
        return line.size

    first, second, line = np.arange(6.0).reshape(3, 2), np.ones(3), np.zeros(3)
    held = [sys.getrefcount(array) for array in (first, second, line)]
    assert through((first, second), line) == 3
    assert line.tolist() == [1.0, 3.0, 5.0]
    assert [sys.getrefcount(array) for array in (first, second, line)] == held
    assert borrow(line) is line
    loop = next(iter(through.inspect_llvm().values())).split("define", 2)[1]
    assert "NRT_incref" not in loop
