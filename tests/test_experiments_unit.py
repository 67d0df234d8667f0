"""A unit's rows are what the pipeline finds on the first draws of the stream, whatever else is in the unit."""

import math
from dataclasses import replace

import numba
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import rootmatch as rm
from rootmatch.hypergraph.affinity import affinity
from rootmatch.hypergraph.enumeration import random_hyperedges
from rootmatch.research.paper.settings import DEFAULT_PIPELINE, Method, Setting
from rootmatch.research.paper.work_unit import Stream, Task, Unit, evaluate, nested_tensors
from rootmatch.solvers import MultiStartAscent

RHO = {"p3p": 1e-8, "up2p": 1e-2, "3p1": 1e-6}
SETTINGS = [Setting("p3p", 0, 0.1), Setting("up2p", 5, 0.5), Setting("3p1", 0, 0.1, 1.0), Setting("up2p", motions=2)]


@pytest.fixture(scope="module")
def stream():
    return Stream((6, 7), 3, 5000, seed=3)


def test_stream_is_the_one_of_the_library_and_repeats_are_known(stream):
    blocks = list(random_hyperedges(6, 7, 3, 5000, 3))
    source, target = (np.concatenate([block[k] for block in blocks]) for k in (0, 1))
    assert_array_equal(stream.source, source)
    assert_array_equal(stream.target, target)
    numbers = {}
    for e in range(5000):
        key = frozenset(zip(source[e].tolist(), target[e].tolist(), strict=True))
        assert stream.group[e] == numbers.setdefault(key, len(numbers))
        assert stream.seen[e] == len(numbers)
    assert len(numbers) < 5000 / 1.2  # there are repeats: 4200 different ones exist
    assert [frozenset(divmod(a, 7) for a in row) for row in stream.indices.tolist()] == list(numbers)


def test_tensors_of_growing_samples_against_a_dictionary(stream):
    rng = np.random.default_rng(0)
    residual = rng.exponential(size=5000)
    weigh = affinity("qr", rho=0.05)
    tensors = dict(nested_tensors(stream, stream.indices, residual, weigh, (6, 7), (3000, 10, 5000)))
    assert list(tensors) == [10, 3000, 5000]
    for size, tensor in tensors.items():
        minimum = {}
        for e in range(size):
            key = frozenset((stream.source[e] * 7 + stream.target[e]).tolist())
            minimum[key] = min(minimum.get(key, math.inf), residual[e])
        expected = {key: math.exp(-r / 0.05) for key, r in minimum.items() if r <= 28 * 0.05}
        found = dict(zip(map(frozenset, tensor.indices.tolist()), tensor.weights.tolist(), strict=True))
        assert found.keys() == expected.keys()
        assert len(found) == tensor.size
        assert_allclose([found[key] for key in expected], list(expected.values()), rtol=1e-12)


@pytest.mark.parametrize("setting", SETTINGS, ids=str)
@pytest.mark.parametrize("solver", ["power-l1", "power-l1-start", "power-l1-balanced", "power-dense"])
def test_a_row_of_the_papers_method_is_what_match_finds(setting, solver):
    method = Method("qr", solver, RHO[setting.problem])
    rows = evaluate(Unit(5, (Task(setting, ((method, (2000, 20_000)),)),)))
    scene = setting.scene(5)
    for row in rows:
        match = rm.match(
            scene.source,
            scene.target,
            scene.problem,
            preset="paper",
            samples=row.samples,
            rho=method.rho,
            solver=solver,
            seed=5,
        )
        assert row.accuracy == scene.accuracy(match.assignment)
        assert row.hyperedges == match.tensor.size
        assert row.score == pytest.approx(match.score, rel=1e-9)


def test_a_row_of_3p1_is_written_in_the_unknown_of_its_method():
    setting, found = Setting("3p1", 0, 0.5, 1.0), {}
    for residual, unknown in (("qr-cos", "cos"), ("qr", "tan")):
        method = Method(residual, "power-l1", 1e-7)
        (row,) = evaluate(Unit(5, (Task(setting, ((method, (20_000,)),)),)))
        scene = setting.scene(5)
        problem = replace(scene.problem, unknown=unknown)
        match = rm.match(scene.source, scene.target, problem, preset="paper", samples=20_000, rho=1e-7, seed=5)
        assert row.score == pytest.approx(match.score, rel=1e-9)
        assert row.hyperedges == match.tensor.size
        found[unknown] = row.hyperedges
    assert found["cos"] != found["tan"]


def test_a_hyperedge_drawn_again_in_another_order_has_the_least_of_its_residuals():
    """One entry of the tensor for each set of correspondences, whatever the order and the number of its draws."""
    scene, rho = Setting("up2p", 0, 0.5).scene(4), 1e-2
    match = rm.match(scene.source, scene.target, scene.problem, preset="paper", samples=30_000, rho=rho, seed=4)
    source, target = next(random_hyperedges(10, 10, 3, 30_000, 4))
    residual = rm.residuals(scene.source, scene.target, scene.problem, source, target, kind="qr")
    minimum = {}
    for i, k, r in zip(source.tolist(), target.tolist(), residual.tolist(), strict=True):
        key = frozenset(10 * a + b for a, b in zip(i, k, strict=True))
        minimum[key] = min(minimum.get(key, math.inf), r)
    expected = {key: math.exp(-r / rho) for key, r in minimum.items() if r <= 28 * rho}
    found = dict(zip(map(frozenset, match.tensor.indices.tolist()), match.tensor.weights.tolist(), strict=True))
    assert found.keys() == expected.keys()
    assert_allclose([found[key] for key in expected], list(expected.values()), rtol=1e-9)
    assert len(found) == match.tensor.size < np.sum(residual <= 28 * rho)


@pytest.mark.parametrize("setting", [*SETTINGS, Setting("p3p", 10, 0.5)], ids=str)
def test_a_row_of_the_default_pipeline_is_from_the_tensor_of_match(setting):
    """Up to 15 image points all hyper-edges are looked at, with more those drawn."""
    rows = evaluate(Unit(5, (Task(setting, ((DEFAULT_PIPELINE, (2000, 60_000)),)),)))
    scene = setting.scene(5)
    for row in rows:
        match = rm.match(
            scene.source, scene.target, scene.problem, noise=max(scene.noise, 0.01), seed=5,
            sampler="random", samples=row.samples, motions=scene.motions.max() + 1,
        )  # fmt: skip
        assert row.hyperedges == match.tensor.size > 0
        solution = MultiStartAscent(keep=0)(match.tensor, seed=5)
        assert row.score == pytest.approx(solution.score, rel=1e-9)
        assert row.accuracy == scene.accuracy(solution.assignment)


def test_more_samples_find_what_fewer_do_not():
    method = Method("qr", "power-l1", 1e-2)
    rows = evaluate(Unit(1, (Task(Setting("up2p"), ((method, (30, 30_000)), (DEFAULT_PIPELINE, (30_000,)))),)))
    few, many, pipeline = (row.accuracy for row in rows)
    assert few < 0.5
    assert many == pipeline == 1.0


def test_rows_do_not_depend_on_what_else_is_in_the_unit():
    sizes = (700, 20_000)
    methods = tuple(
        (m, sizes) for m in (Method("qr", "power-l1", 1e-2), Method("svd", "power-dense", 0.1), DEFAULT_PIPELINE)
    )
    settings = (Setting("up2p", 0, 0.5), Setting("up2p", 0, 0.5, motions=2))
    together = evaluate(Unit(2, tuple(Task(s, methods) for s in settings)))
    alone = [
        row
        for s in settings
        for method, _ in methods
        for size in sizes
        for row in evaluate(Unit(2, (Task(s, ((method, (size,)),)),)))
    ]
    key = lambda row: (row.setting, row.method, row.samples)  # noqa: E731
    assert sorted(together, key=key) == sorted(alone, key=key)
    assert len(together) == 12


def test_the_number_of_threads_is_given_back():
    before = numba.get_num_threads()
    evaluate(Unit(0, (Task(Setting("up2p"), ((Method("qr", "power-l1", 1e-2), (100,)),)),)))
    assert numba.get_num_threads() == before


def test_no_hyperedge_above_the_weight_that_counts_matches_nothing():
    (row,) = evaluate(Unit(0, (Task(Setting("up2p", 0, 1.0), ((Method("qr", "power-l1", 1e-12), (100,)),)),)))
    assert (row.hyperedges, row.accuracy, row.score) == (0, 0.0, 0.0)
