"""derive(): the three problems of the paper from their equations alone, against the hand-written ones and brute force.

The residuals' composition is tested as plain Python (compiling every kind of every problem takes minutes); that the
compiled kernels are the same text is tested on some.
"""

from __future__ import annotations

import math
import os
import pickle
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from scipy.stats import chi2

import instances
import oracles
from plain_kernels import interpreted_kernels
from rootmatch import residuals
from rootmatch.backends import cpu
from rootmatch.cameras.pinhole import Camera
from rootmatch.derivation import derive as derive_module
from rootmatch.derivation.derive import Bearings, DerivedProblem, Points, derive
from rootmatch.errors import InputError, RootmatchError
from rootmatch.problems.base import Problem
from rootmatch.problems.derived import compile as compile_module
from rootmatch.problems.derived import store
from rootmatch.problems.kernels import ResidualKernels
from rootmatch.problems.residual_kinds import QR, SVD, Joint, Normalised, QRBoth
from rootmatch.simulation import Scene, p3p_scene, three_plus_one_scene, up2p_scene

CAMERA = Camera(1000.0, 1000.0, 320.0, 240.0)
RAYS = Bearings(CAMERA)
x = sp.Symbol("x")
T = sp.Matrix(sp.symbols("tx ty tz"))
TURN = sp.Matrix([[1 - x**2, 0, 2 * x], [0, 1 + x**2, 0], [-2 * x, 0, 1 - x**2]])  # (1 + x²) R


@pytest.fixture(scope="module", autouse=True)
def cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Generated code of these tests stays out of the user's folder."""
    folder = tmp_path_factory.mktemp("cache") / "derived"
    old = os.environ.get("ROOTMATCH_CACHE_DIR")
    os.environ["ROOTMATCH_CACHE_DIR"] = str(folder)
    yield folder
    os.environ.pop("ROOTMATCH_CACHE_DIR")
    if old is not None:
        os.environ["ROOTMATCH_CACHE_DIR"] = old


# ------------------------------------------------------------------ the paper's three problems, stated


def up2p_by_rotation() -> DerivedProblem:
    """The rays' plane holds the turned difference of both points."""
    equation = lambda X, u: u[0].cross(u[1]).dot(TURN * (X[1] - X[0]))  # noqa: E731
    return derive("up2p", equation, minimal=2, shared=x, source=Points(3), target=RAYS)


def up2p_by_projection() -> DerivedProblem:
    """Each point lies on its ray: depth · u = R X + t."""
    depth = sp.Symbol("depth")
    each = lambda X, u: depth * u - TURN * X - T  # noqa: E731
    return derive(
        "up2p-each", each=each, minimal=2, shared=x, eliminate=list(T), local=[depth], source=Points(3), target=RAYS
    )


def p3p_by_cosines() -> DerivedProblem:
    """Three cosine laws and b = x a."""
    a, b, c = sp.symbols("a b c")

    def laws(X, u):  # type: ignore[no-untyped-def]
        def law(i, j, s, t):  # type: ignore[no-untyped-def]
            return s**2 + t**2 - 2 * s * t * u[i].dot(u[j]) - (X[i] - X[j]).dot(X[i] - X[j])

        return [law(0, 1, a, b), law(1, 2, b, c), law(2, 0, c, a), b - x * a]

    return derive(
        "p3p", laws, minimal=3, shared=x, eliminate=[a, b, c], source=Points(3), target=RAYS, interval=(0, None)
    )


def three_plus_one_by_epipolar_planes() -> DerivedProblem:
    """q' · (t × R q) = 0."""
    each = lambda p, q: q.dot(T.cross(TURN * p))  # noqa: E731
    return derive("3p1", each=each, minimal=3, shared=x, eliminate=list(T), source=RAYS, target=RAYS)


def _p3p(seed: int, noise: float) -> Scene:
    return p3p_scene(n=8, noise=noise, seed=seed)


def _up2p(seed: int, noise: float) -> Scene:
    return up2p_scene(n=8, noise=noise, seed=seed)


def _three_plus_one(seed: int, noise: float) -> Scene:
    return three_plus_one_scene(n=8, noise=noise, seed=seed, baseline=4.0)


MAKERS: dict[str, tuple[Callable[[], DerivedProblem], Callable[[int, float], Scene]]] = {
    "up2p": (up2p_by_rotation, _up2p),
    "up2p-each": (up2p_by_projection, _up2p),
    "p3p": (p3p_by_cosines, _p3p),
    "3p1": (three_plus_one_by_epipolar_planes, _three_plus_one),
}
_DERIVED: dict[str, DerivedProblem] = {}


def derived(name: str) -> DerivedProblem:
    if name not in _DERIVED:
        _DERIVED[name] = MAKERS[name][0]()
    return _DERIVED[name]


def hyperedges(scene: Scene, order: int, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The first half true, the others of random targets."""
    rng = np.random.default_rng(seed)
    source = np.array([rng.permutation(len(scene.source))[:order] for _ in range(count)])
    target = scene.truth[source]
    wrong = np.array([rng.permutation(len(scene.target))[:order] for _ in range(count - count // 2)])
    target[count // 2 :] = wrong
    return source, target


_INTERPRETED: dict[tuple[str, float], dict[type, ResidualKernels]] = {}


def interpreted(problem: DerivedProblem) -> dict[type, ResidualKernels]:
    key = problem.tag, compile_module.BLUR
    if key not in _INTERPRETED:
        _INTERPRETED[key] = interpreted_kernels(problem)
    return _INTERPRETED[key]


# ------------------------------------------------------------------ the polynomial


@pytest.mark.parametrize("name", MAKERS)
def test_coefficients_are_the_hand_written_ones(name: str) -> None:
    problem = derived(name)
    m = problem.minimal
    worst = 0.0
    for seed in range(20):
        scene = MAKERS[name][1](seed, 1.0)
        source, target = hyperedges(scene, m, 40, seed)
        ours = problem.coefficients(scene.source[source], scene.target[target])
        theirs = scene.problem.coefficients(scene.source[source], scene.target[target])
        ours /= np.linalg.norm(ours, axis=1, keepdims=True)
        theirs /= np.linalg.norm(theirs, axis=1, keepdims=True)
        worst = max(worst, np.abs(ours * np.sign((ours * theirs).sum(axis=1))[:, None] - theirs).max())
    assert worst < 1e-9


@pytest.mark.parametrize(
    ("name", "sizes"),
    [
        ("up2p", (3, 2, 2, 2, 3)),
        ("up2p-each", (3, 2, 2, 2, 3)),
        ("p3p", (4, 3, 4, 2, 6)),
        ("3p1", (4, 3, 4, 1, 6)),
    ],
)
def test_sizes(name: str, sizes: tuple[int, ...]) -> None:
    problem = derived(name)
    assert isinstance(problem, Problem)
    assert sizes == (problem.order, problem.minimal, problem.degree, problem.constraints, problem.pair_count)
    assert problem.name == name
    assert problem.target_dimension == 2


def test_factor_of_the_rotation_is_taken_off_and_said() -> None:
    assert "Factors taken off: x**2 + 1." in derived("3p1").code


def test_repeated_and_constant_factors_are_taken_off() -> None:
    """A linear polynomial dressed up: squared, and times factors that mean nothing."""
    points = Points(2, noisy=True)
    s = sp.Symbol("s")

    def dressed(X, u):  # type: ignore[no-untyped-def]
        d = (X[1] - X[0]).dot(X[1] - X[0])
        e = (u[1] - u[0]).dot(u[1] - u[0])
        return [(s * d - e * (x - 3) / (x - 3)) ** 2 * (x**2 + x + 1), s - x]

    def sample(rng):  # type: ignore[no-untyped-def]
        first = rng.normal(size=(3, 2))
        return first, rng.uniform(0.5, 2.0) * first + 1.0

    problem = derive(
        "dressed", dressed, minimal=2, shared=x, eliminate=[s], source=points, target=points, sample=sample
    )
    assert problem.degree == 1
    rng = np.random.default_rng(0)
    X, u = rng.normal(size=(2, 5, 2, 2))
    found = problem.coefficients(X, u)
    squared = [((points[:, 1] - points[:, 0]) ** 2).sum(axis=1) for points in (X, u)]
    np.testing.assert_allclose(-found[:, 1] / found[:, 0], squared[1] / squared[0], rtol=1e-12)


@pytest.mark.parametrize("dressed", [False, True])
def test_upright_weak_perspective(dressed: bool) -> None:
    """Its value at x and its coefficients are made of other leaves; dressed, 1 + x² comes in three times."""
    tx, ty, s = sp.symbols("tx ty s")

    def each(X, u):  # type: ignore[no-untyped-def]
        turned = TURN * X
        other = (u[1] - ty) * (1 + x**2) - s * turned[1] if dressed else u[1] - ty - s * X[1]
        return [(1 + x**2) * (u[0] - tx) - s * turned[0], other]

    problem = derive(
        f"weak-{dressed}",
        each=each,
        minimal=2,
        shared=x,
        eliminate=[tx, ty, s],
        source=Points(3),
        target=Points(2, noisy=True),
    )
    assert (problem.degree, problem.constraints) == (2, 2)
    X, u = np.random.default_rng(0).normal(size=(2, 5, 2, 3))
    (dx, dy, dz), (du, dv, _) = (np.moveaxis(points[:, 1] - points[:, 0], 1, 0) for points in (X, u))
    # du / dv is that of the turned difference
    expected = np.array([-dx * dv - dy * du, 2.0 * dz * dv, dx * dv - dy * du]).T
    found = problem.coefficients(X, u[:, :, :2])
    np.testing.assert_allclose(found / found[:, :1], expected / expected[:, :1], rtol=1e-9)


def plane_similarity(eliminate: list) -> DerivedProblem:
    tx, ty, s = sp.symbols("tx ty s")
    turn = sp.Matrix([[1 - x**2, -2 * x], [2 * x, 1 - x**2]])  # (1 + x²) R
    points = Points(2, noisy=True)
    each = lambda X, u: s * turn * X + (1 + x**2) * (sp.Matrix([tx, ty]) - u)  # noqa: E731
    unknowns = [{"s": s, "tx": tx, "ty": ty}[name] for name in eliminate]
    return derive("plane", each=each, minimal=2, shared=x, eliminate=unknowns, source=points, target=points)


@pytest.mark.parametrize("order", [["s", "tx", "ty"], ["tx", "s", "ty"], ["tx", "ty", "s"]])
def test_a_factor_that_comes_in_several_times_is_taken_off(order: list) -> None:
    """Such a root is inaccurate, and exact as that of a derivative."""
    problem = plane_similarity(order)
    assert "Factors taken off: x**2 + 1, x**2 + 1, x**2 + 1." in problem.code
    assert (problem.degree, problem.constraints) == (2, 2)
    rng = np.random.default_rng(0)
    X = rng.normal(size=(2, 2))
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    roots = np.roots(problem.coefficients(X[None], (1.7 * X @ turn.T + 0.3)[None])[0])
    assert np.abs(roots - np.tan(0.35)).min() < 1e-9


def test_numbers_such_as_pi_are_printed() -> None:
    equation = lambda X, u: u[0].cross(u[1]).dot(TURN * (X[1] - X[0])) * (sp.pi + X[0][0] * sp.E) / 7  # noqa: E731
    arguments = {"minimal": 2, "shared": x, "source": Points(3), "target": RAYS}
    problem = derive("pi", equation, **arguments)  # type: ignore[arg-type]
    assert problem.degree == 2


def test_two_nonlinear_equations_by_resultants() -> None:
    """A made-up problem with a known answer: y² = p₀ x + q₀ and q₁ y = p₁ x² + x of the sums p and q."""
    y = sp.Symbol("y")

    def equations(X, u):  # type: ignore[no-untyped-def]
        p, q = X[1] + X[0], u[1] + u[0]
        return [y**2 - p[0] * x - q[0], y * q[1] - x**2 * p[1] - x]

    problem = derive("sums", equations, minimal=2, shared=x, eliminate=[y], source=Points(2), target=Points(2, True))
    assert problem.degree == 4
    rng = np.random.default_rng(1)
    X, u = rng.normal(size=(2, 6, 2, 2))
    for coefficients, a, b in zip(problem.coefficients(X, u), X, u, strict=True):
        p, q = a[1] + a[0], b[1] + b[0]
        for root in np.roots(coefficients):
            y_value = (root**2 * p[1] + root) / q[1]
            assert abs(y_value**2 - p[0] * root - q[0]) < 1e-8 * (1.0 + abs(y_value) ** 2)


# ------------------------------------------------------------------ the residuals


def total_gradient(problem: Problem, scene: Scene, source: np.ndarray, target: np.ndarray, sigma: float) -> float:
    """|q(x̂)| / σ for one hyper-edge: the roots of p and q there by differences in every pixel, least over the roots."""
    m = problem.minimal
    both = problem.source_dimension == 2

    def value(shift: np.ndarray, near: complex) -> tuple[float, complex]:
        points = scene.source[source] + (shift[:, :2] if both else 0.0)
        pixels = scene.target[target] + shift[:, -2:]
        swept = [*range(m - 1), m]
        p = problem.coefficients(points[None, :m], pixels[None, :m])[0]
        q = problem.coefficients(points[None, swept], pixels[None, swept])[0]
        roots = np.roots(p)
        root = roots[np.argmin(np.abs(roots - near))]
        return float(np.polyval(q, root).real), root

    width = 4 if both else 2
    zero = np.zeros((m + 1, width))
    p = problem.coefficients(scene.source[source][None, :m], scene.target[target][None, :m])[0]
    best = math.inf
    for root in np.roots(p):
        if abs(root.imag) > 1e-9 * abs(root):
            continue
        step = 1e-3
        gradient = []
        for k in range(zero.size):
            shift = zero.copy()
            shift.flat[k] = step
            gradient.append((value(shift, root)[0] - value(-shift, root)[0]) / (2.0 * step))
        best = min(best, abs(value(zero, root)[0]) / (sigma * float(np.linalg.norm(gradient))))
    return best


@pytest.mark.parametrize("name", ["up2p", "p3p", "3p1"])
def test_normalised_is_the_polynomial_over_its_deviation_in_pixels(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """By differences of the hand-written polynomials, roots moving along; without the bound near double roots."""
    problem = derived(name)
    scene = MAKERS[name][1](0, 0.05)
    problem.prepare(scene.source, scene.target)  # registers its kernels as they are
    monkeypatch.setattr("rootmatch.problems.derived.compile.BLUR", 0.0)
    edge = interpreted(problem)[Normalised].edge
    errors = []
    for seed in range(5):
        scene = MAKERS[name][1](seed, 0.05)
        tables = problem.prepare(scene.source, scene.target, 0.05)
        source, target = hyperedges(scene, problem.order, 8, seed)
        for i, j in zip(source[:4], target[:4], strict=True):
            expected = total_gradient(scene.problem, scene, i, j, 0.05)
            errors.append(abs(edge(tables, Normalised(), i, j) - expected) / max(expected, 0.1))
    assert np.quantile(errors, 0.75) < 1e-3


@pytest.mark.parametrize("name", ["up2p", "p3p"])
def test_joint_is_the_reprojection_error_of_the_best_pose(name: str) -> None:
    problem = derived(name)
    sigma = 0.02
    edge = interpreted(problem)[Joint].edge
    errors = []
    rng = np.random.default_rng(3)
    for _ in range(40):
        if name == "p3p":
            made = instances.p3p_generic(rng, 4)
        else:
            made = instances.up2p_generic(rng, 3, any_vertical=False)
        target = made.target + sigma * rng.normal(size=made.target.shape)
        seen = problem.measured(target=Bearings(Camera(*made.intrinsics)))
        tables = seen.prepare(
            np.concatenate((made.source, made.source[:1] + 1.0)), np.concatenate((target, target[:1] + 50.0)), sigma
        )
        axis = None if name == "p3p" else made.vertical_world
        expected = oracles.reprojection_chi2(
            made.source, target, made.intrinsics, made.rotation, made.translation, sigma, axis
        )
        index = np.arange(problem.order)
        errors.append(abs(edge(tables, Joint(), index, index) ** 2 - expected) / max(expected, 0.1))
    assert np.quantile(errors, 0.5) < 0.02
    assert np.quantile(errors, 0.85) < 0.1


@pytest.mark.parametrize("kind", [QR, QRBoth, SVD])
@pytest.mark.parametrize("name", ["up2p", "3p1"])
def test_resultant_residuals_are_those_of_the_sylvester_matrix(name: str, kind: type) -> None:
    problem = derived(name)
    oracle = {QR: oracles.qr, QRBoth: oracles.qr_both, SVD: oracles.svd}[kind]
    edge = interpreted(problem)[kind].edge
    scene = MAKERS[name][1](1, 0.5)
    tables = problem.prepare(scene.source, scene.target, 0.5)
    source, target = hyperedges(scene, problem.order, 8, 1)
    swept = [*range(problem.minimal - 1), problem.minimal]
    for i, j in zip(source, target, strict=True):
        points, pixels = scene.source[i], scene.target[j]
        sets = [list(range(problem.minimal)), swept]
        p, q = (scene.problem.coefficients(points[None, s], pixels[None, s])[0] for s in sets)
        assert edge(tables, kind(), i, j) == pytest.approx(oracle(p, q), rel=1e-6, abs=1e-14)


@pytest.mark.parametrize("kind", [QR, QRBoth, SVD, Normalised, Joint])
@pytest.mark.parametrize("name", ["up2p", "p3p", "3p1"])
def test_slab_is_edge_by_edge(name: str, kind: type) -> None:
    problem = derived(name)
    kernels = interpreted(problem)[kind]
    edge, slab = kernels.edge, kernels.slab
    scene = MAKERS[name][1](2, 0.5)
    tables = problem.prepare(scene.source, scene.target, 0.5)
    m = problem.minimal
    for mask in (1, 0b101) if kind is not Joint else (1,):
        chosen, first = kind(mask), m
        i, j = np.append(np.arange(m), -1), np.append(scene.truth[:m], -1)
        out = np.empty((len(scene.source) - first, len(scene.target)))
        slab(tables, chosen, i, j, first, None, out)
        for r in range(len(out)):
            for k in set(range(len(scene.target))) - set(j[:m]):
                expected = edge(tables, chosen, np.append(i[:m], first + r), np.append(j[:m], k))
                assert out[r, k] == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("name", ["up2p", "p3p", "3p1"])
def test_several_pairs_give_the_greatest(name: str) -> None:
    problem = derived(name)
    scene = MAKERS[name][1](3, 0.5)
    tables = problem.prepare(scene.source, scene.target, 0.5)
    source, target = hyperedges(scene, problem.order, 6, 3)
    for kind in (QR, Normalised):
        edge = interpreted(problem)[kind].edge
        for i, j in zip(source, target, strict=True):
            single = [edge(tables, kind(1 << bit), i, j) for bit in range(problem.pair_count)]
            assert edge(tables, kind(0b111), i, j) == max(single[:3])


@pytest.mark.parametrize(("name", "within"), [("p3p", 0.96), ("up2p", 0.95), ("3p1", 0.95)])
def test_joint_is_calibrated_and_tells_true_from_wrong(name: str, within: float) -> None:
    """√χ² of as many degrees of freedom as constraints; wrong ones pass hardly more often than by hand."""
    problem = derived(name)
    edge = interpreted(problem)[Joint].edge
    values, by_hand = [], []
    for seed in range(30):
        scene = MAKERS[name][1](seed, 0.1)
        tables = problem.prepare(scene.source, scene.target, 0.1)
        source, target = hyperedges(scene, problem.order, 40, seed)
        values.append([edge(tables, Joint(), i, j) for i, j in zip(source, target, strict=True)])
        by_hand.append(residuals(scene.source, scene.target, scene.problem, source, target, "joint", 0.1))
    true, wrong = np.array(values)[:, :20].ravel(), np.array(values)[:, 20:].ravel()
    for share in (0.5, 0.9):
        assert abs(np.mean(true**2 < chi2.ppf(share, problem.constraints)) - share) < 0.07
    assert np.mean(true < 3.5) > within
    # 3P1 without conditions lets points behind a camera pass, of which the kernels by hand know
    spare = 0.05 if name == "3p1" else 0.005
    assert np.mean(wrong < 3.5) <= np.mean(np.array(by_hand)[:, 20:] < 3.5) + spare


def test_compiled_and_interpreted_agree() -> None:
    problem = derived("up2p")
    scene = _up2p(5, 0.5)
    tables = problem.prepare(scene.source, scene.target, 0.5)
    source, target = hyperedges(scene, 3, 40, 5)
    edge = interpreted(problem)[Joint].edge
    expected = [edge(tables, Joint(), i, j) for i, j in zip(source, target, strict=True)]
    found = cpu.residuals(tables, Joint(), source, target)
    near = found < 10.0  # beyond, wrong ones may be near a singularity, where rounding decides
    assert near.sum() >= 20
    np.testing.assert_allclose(found[near], np.array(expected)[near], rtol=1e-6)
    assert np.all(np.array(expected)[~near] >= 9.0)


def test_another_camera_needs_no_new_derivation(monkeypatch: pytest.MonkeyPatch) -> None:
    first = derived("up2p")
    monkeypatch.setattr(derive_module, "_derive", None)
    other = Camera(700.0, 720.0, 300.0, 200.0)
    seen = first.measured(target=Bearings(other))
    scene = _up2p(1, 0.0)
    moved = other.project(CAMERA.bearings(scene.target))
    p = first.coefficients(scene.source[None, :2], scene.target[None, scene.truth[:2]])
    np.testing.assert_allclose(seen.coefficients(scene.source[None, :2], moved[None, scene.truth[:2]]), p, atol=1e-12)


def test_conditions_stop_roots_that_no_camera_sees() -> None:
    """The scale of two segments, with a condition that no instance fulfils, and with one that all fulfil."""
    values = {}
    for name, sign in (("always", 1), ("never", -1)):
        problem = derive(
            f"scale-{name}",
            lambda X, u: (u[1] - u[0]).dot(u[1] - u[0]) - x * (X[1] - X[0]).dot(X[1] - X[0]),
            positive=lambda X, u, sign=sign: [sign * (x + (u[1] - u[0]).dot(u[1] - u[0]))],
            minimal=2,
            shared=x,
            source=Points(2),
            target=Points(2, noisy=True),
        )
        rng = np.random.default_rng(0)
        points = rng.normal(size=(4, 2))
        tables = problem.prepare(points, 2.0 * points, 0.01)
        index = np.arange(3)
        kernels = interpreted(problem)[Joint]
        edge, slab = kernels.edge, kernels.slab
        values[name] = edge(tables, Joint(), index, index)
        out = np.empty((2, 4))
        slab(tables, Joint(), index.copy(), index.copy(), 2, None, out)
        assert out[0, 2] == values[name]
    assert values["always"] < 1e-6
    assert values["never"] >= 1e6


def test_interval_bounds_the_shared_variable() -> None:
    make = lambda name, interval: derive(  # noqa: E731
        name,
        lambda X, u: (u[1] - u[0]).dot(u[1] - u[0]) - x * (X[1] - X[0]).dot(X[1] - X[0]),
        minimal=2,
        shared=x,
        source=Points(2),
        target=Points(2, noisy=True),
        interval=interval,
        sample=lambda rng: sample(rng, interval),
    )

    def sample(rng, interval):  # type: ignore[no-untyped-def]
        low, high = (0.2 if interval[0] is None else interval[0], 3.0 if interval[1] is None else interval[1])
        first = rng.normal(size=(3, 2))
        return first, math.sqrt(rng.uniform(low, high)) * first

    points = np.random.default_rng(0).normal(size=(4, 2))
    index = np.arange(3)
    for name, interval, inside in (("up", (1.0, None), True), ("down", (None, 1.0), False)):
        problem = make(name, interval)
        edge = interpreted(problem)[Normalised].edge
        value = edge(problem.prepare(points, 2.0 * points, 0.01), Normalised(), index, index)
        assert (value < 1e-6) == inside


def test_noise_of_both_sets() -> None:
    problem = derived("3p1")
    scene = _three_plus_one(1, 0.5)
    both, apart = (problem.prepare(scene.source, scene.target, noise) for noise in (0.5, (0.5, 0.5)))
    for one, other in zip(both[:-1], apart[:-1], strict=True):
        np.testing.assert_array_equal(one, other)
    uneven = problem.prepare(scene.source, scene.target, (1.0, 0.5))
    np.testing.assert_allclose(uneven.source_noise, 2.0 * both.source_noise)
    np.testing.assert_allclose(uneven.target_noise, both.target_noise)


def radial_camera() -> DerivedProblem:
    """An upright camera of unknown lens: the image lies on the ray from the centre towards the point's foot."""
    turned = lambda X: TURN * X + T  # noqa: E731
    return derive(
        "radial",
        each=lambda X, u: u[0] * turned(X)[1] - u[1] * turned(X)[0],
        minimal=3,
        shared=x,
        eliminate=list(T[:2]),
        source=Points(3),
        target=Points(2, noisy=True),
    )


def radial_scene() -> tuple[np.ndarray, np.ndarray, float]:
    """Eight points and their images in pixels about the centre, in the same order, with noise."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-2.0, 2.0, (8, 3))
    c, s = math.cos(0.4), math.sin(0.4)
    seen = points @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T + [0.3, -0.2, 6.0]
    lens = 800.0 * (1.0 + 0.2 * np.linalg.norm(seen[:, :2], axis=1, keepdims=True))
    return points, lens * seen[:, :2] / seen[:, 2:] + rng.normal(0.0, 0.4, (8, 2)), 0.4


UNITS = (1e-6, 1e-3, 1.0, 1e3, 1e6)


@pytest.mark.parametrize("kind", [QR, QRBoth, SVD, Normalised, Joint])
def test_no_residual_depends_on_the_unit(kind: type) -> None:
    """Of the source, and of a target whose coordinates are not pixels of a camera; five true and five false each."""
    scene = p3p_scene(n=8, noise=0.5, seed=4)
    radial = radial_scene()
    cases: list[tuple[DerivedProblem, np.ndarray, np.ndarray, float, np.ndarray, list[float]]] = [
        (derived("p3p"), scene.source, scene.target, 0.5, scene.truth, [1.0]),
        (radial_camera(), *radial, np.arange(8), list(UNITS)),
    ]
    rng = np.random.default_rng(0)
    for problem, source, target, noise, truth, target_units in cases:
        kernels = interpreted(problem)[kind]
        edge, slab = kernels.edge, kernels.slab
        i = np.array([rng.permutation(8)[:4] for _ in range(10)])
        j = np.concatenate([truth[i[:5]], [rng.permutation(8)[:4] for _ in range(5)]])

        def values(length: float, pixel: float) -> list[float]:
            tables = problem.prepare(source * length, target * pixel, noise * pixel)  # noqa: B023
            out = np.empty((1, len(target)))  # noqa: B023
            slab(tables, kind(), i[0].copy(), j[0].copy(), i[0, 3], None, out)  # noqa: B023
            return [edge(tables, kind(), a, b) for a, b in zip(i, j, strict=True)] + [out[0, j[0, 3]]]  # noqa: B023

        expected = values(1.0, 1.0)
        assert kind not in (Normalised, Joint) or max(expected[:5]) < 3.5 < min(expected[5:10])
        for length in UNITS:
            for pixel in target_units:
                # roots of P3P near a double one keep about ten digits, and resultants are known to rounding alone
                np.testing.assert_allclose(values(length, pixel), expected, rtol=1e-5, atol=1e-12)


# ------------------------------------------------------------------ checks of a statement


def test_a_sampler_is_used_and_a_wrong_one_refused() -> None:
    def right(rng):  # type: ignore[no-untyped-def]
        made = instances.up2p_generic(rng, 3, any_vertical=False)
        return made.source, CAMERA.project(made.camera_points)

    def wrong(rng):  # type: ignore[no-untyped-def]
        source, target = right(rng)
        return source, target + 20.0 * rng.normal(size=target.shape)

    state = lambda sample: derive(  # noqa: E731
        "sampled",
        lambda X, u: u[0].cross(u[1]).dot(TURN * (X[1] - X[0])),
        minimal=2,
        shared=x,
        source=Points(3),
        target=RAYS,
        sample=sample,
        cached=False,
    )
    assert state(right).constraints == 2
    with pytest.raises(RootmatchError, match=r"does not vanish|no root in common"):
        state(wrong)
    with pytest.raises(InputError, match="sample: source of shape"):
        state(lambda rng: (rng.normal(size=(3, 2)), rng.normal(size=(3, 2))))


def test_constraints_can_be_limited() -> None:
    problem = derive(
        "stopped_early",
        lambda X, u: u[0].cross(u[1]).dot(TURN * (X[1] - X[0])),
        minimal=2,
        shared=x,
        source=Points(3),
        target=RAYS,
        constraints=1,
    )
    assert problem.constraints == 1


@pytest.mark.parametrize(("name", "stated"), [("up2p", 2), ("up2p-each", 2), ("p3p", 2), ("3p1", 1)])
def test_the_constraints_of_the_equations_are_counted(name: str, stated: int) -> None:
    """Twice the points less the unknowns of the pose; a baseline's length, which no image shows, is none."""
    problem = derived(name)
    assert (problem.surplus_constraints, problem.stated_constraints) == (0, stated)
    assert f"Constraints of a hyper-edge: {stated}, used: {problem.constraints}." in problem.code


def test_an_over_determined_minimal_set_is_named() -> None:
    each = lambda p, q: q.dot(T.cross(TURN * p))  # noqa: E731
    statement = {"each": each, "shared": x, "eliminate": list(T), "source": RAYS, "target": RAYS, "cached": False}
    with pytest.raises(RootmatchError, match=r"4 correspondences over-determine .* left over: 1\).* give minimal=3"):
        derive("four", minimal=4, **statement)  # type: ignore[arg-type]


def test_what_elimination_brought_in_is_said_where_a_minimal_set_is_over_determined() -> None:
    """Fewer correspondences would not help: the polynomial depends on the last one."""
    tx, ty = sp.symbols("tx ty")
    turn = sp.Matrix([[1 - x**2, -2 * x], [2 * x, 1 - x**2]])

    def dressed(X, u):  # type: ignore[no-untyped-def]
        each = [turn * p + (1 + x**2) * (sp.Matrix([tx, ty]) - q) for p, q in zip(X, u, strict=True)]
        return [(x**2 + X[0][0] ** 2) * e for e in each]

    points = Points(2, noisy=True)
    with pytest.raises(RootmatchError, match="one that elimination brought in"):
        derive("dressed", dressed, minimal=2, shared=x, eliminate=[tx, ty], source=points, target=points, cached=False)


def test_level_camera_at_known_height() -> None:
    """Two points give a constraint too many, and 1 + x² comes in several times with the eliminated depths."""
    tx, tz, depth = sp.symbols("tx tz depth")
    each = lambda X, u: (1 + x**2) * (depth * u - sp.Matrix([tx, sp.Rational(7, 5), tz])) - TURN * X  # noqa: E731
    problem = derive(
        "level",
        each=each,
        minimal=2,
        shared=x,
        eliminate=[tx, tz],
        local=[depth],
        source=Points(3),
        target=RAYS,
        cached=False,
    )
    assert problem.surplus_constraints == 1
    assert problem.degree == 2


def test_code_that_cannot_be_used_is_not_blamed_on_the_equations(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = store.compile_vetted

    def refused(text: str, where: str = "generated") -> store.Generated:
        if where == "derived":
            text += "\nimport os\n"
        return compiled(text, where)

    monkeypatch.setattr(store, "compile_vetted", refused)
    with pytest.raises(RootmatchError, match="a fault of rootmatch and not of the equations"):
        derive("fault", cached=False, **STATEMENT)  # type: ignore[arg-type]


STATEMENT = {
    "equations": lambda X, u: u[0].cross(u[1]).dot(TURN * (X[1] - X[0])),
    "minimal": 2,
    "shared": x,
    "source": Points(3),
    "target": RAYS,
}


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"equations": None}, "either equations= or each="),
        ({"each": lambda X, u: u}, "either equations= or each="),
        ({"minimal": 0}, "minimal: 0"),
        ({"minimal": "2"}, "minimal"),
        ({"shared": "x"}, "shared: 'x' given"),
        ({"eliminate": [x]}, "named twice"),
        ({"local": [sp.Symbol("a")]}, "goes with each="),
        ({"source": CAMERA}, "source: .* given"),
        ({"target": None}, "target: None given"),
        ({"target": Points(3)}, "both sets are exact"),
        ({"shared": sp.Symbol("w")}, "neither measured nor unknown"),
        ({"equations": lambda X, u: X[0][0] - u[0][0]}, "does not occur"),
        ({"equations": lambda X, u: x - 1}, "nothing measured"),
        ({"equations": lambda X, u: sp.sin(x) * u[0][0] - X[0][0]}, "no polynomial"),
        ({"equations": lambda X, u: x * sp.Abs(u[0][0]) - X[0][0]}, "equations: Abs given, other than arithmetic"),
        ({"equations": lambda X, u: x * u[0][0] - sp.I * X[0][0]}, "equations: the imaginary unit given"),
        ({"positive": lambda X, u: [sp.Abs(x)]}, "positive: Abs given"),
        *(
            ({"equations": lambda X, u, y=y: y * u[0][0] - X[0][0], "shared": y}, "shared: a symbol of the name")
            for y in sp.symbols("A θ lambda d0 s0_0 sqrt")
        ),
        ({"equations": lambda X, u: x * sp.Symbol("focal") - u[0][0]}, "focal"),
        ({"interval": (2.0, 1.0)}, "interval"),
        ({"name": "../up"}, "name: '../up'"),
        ({"positive": lambda X, u: [sp.Symbol("depth")]}, "positive: depth"),
        ({"positive": lambda X, u: 1 / 0}, r"positive: the function failed with ZeroDivisionError"),
        (
            {"equations": lambda X, u: TURN * X[0] + 1},
            r"equations: the function failed with TypeError .*column vectors",
        ),
        ({"equations": lambda X, u: X[7]}, "equations: the function failed with IndexError"),
        ({"equations": lambda X: X[0]}, "equations: the function failed with TypeError"),
        ({"equations": lambda X, u: None}, "equations: None returned"),
        ({"equations": lambda X, u: "x"}, "equations: 'x' returned"),
        ({"equations": lambda X, u: [u[0][0] * x == X[0][0]]}, "False returned, a comparison"),
        ({"equations": lambda X, u: u[0][0] * x - math.nan}, "NaN or infinity"),
    ],
)
def test_a_statement_that_cannot_be_meant_is_refused(change: dict[str, object], text: str) -> None:
    arguments: dict[str, object] = {"name": "bad", "cached": False, **STATEMENT, **change}
    with pytest.raises(InputError, match=text):
        derive(**arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("equations", "eliminate", "text"),
    [
        # t has one equation too few
        (lambda X, u: [T[0] * u[0][0] - x * X[0][0] - T[1]], T[:2], "occur in one equation each|nothing is left"),
        # the shared variable cancels
        (lambda X, u: [T[0] - x, T[0] - x + u[0][0] - X[0][0]], T[:1], "nothing is left"),
    ],
)
def test_too_few_equations(equations: object, eliminate: list, text: str) -> None:
    with pytest.raises(InputError, match=text):
        derive("few", equations, minimal=2, shared=x, eliminate=eliminate, source=Points(3), target=RAYS, cached=False)


def test_prepare_refuses_what_it_cannot_use() -> None:
    problem = derived("p3p")
    scene = _p3p(0, 0.0)
    with pytest.raises(InputError, match="normals"):
        problem.prepare(scene.source, scene.target, 1.0, normals=np.ones((8, 3)))
    with pytest.raises(InputError, match="shape"):
        problem.prepare(scene.source[:, :2], scene.target)
    with pytest.raises(InputError, match="at least 4"):
        problem.prepare(scene.source[:3], scene.target)
    with pytest.raises(InputError, match="derived for"):
        problem.measured(target=Points(2))


# ------------------------------------------------------------------ generated code on disk


def test_generated_code_is_found_again_and_is_private(cache_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = up2p_by_rotation()
    (path,) = (
        cache_folder.glob("up2p-*[0-9a-f].py")
        if not list(cache_folder.glob("up2p-each*"))
        else [p for p in cache_folder.glob("up2p-*.py") if "each" not in p.name]
    )
    assert path.read_text() == first.code
    assert "Equations, each 0:" in first.code
    if hasattr(os, "getuid"):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert stat.S_IMODE(cache_folder.stat().st_mode) == 0o700
    monkeypatch.setattr(derive_module, "_derive", None)  # would be called were it not found
    assert up2p_by_rotation().tag == first.tag


def test_a_file_with_other_numbers_is_made_anew(cache_folder: Path) -> None:
    first = up2p_by_rotation()
    path = next(p for p in cache_folder.glob("up2p-*.py") if "each" not in p.name)
    spoilt = first.code.replace("def polynomial", "def unused").replace("def row", "def polynomial", 1)
    assert spoilt != first.code
    path.write_text(spoilt)
    assert up2p_by_rotation().code == first.code
    assert path.read_text() == first.code


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="permissions of POSIX")
def test_a_file_that_others_could_write_is_not_read(cache_folder: Path) -> None:
    first = up2p_by_rotation()
    path = next(p for p in cache_folder.glob("up2p-*.py") if "each" not in p.name)
    stem = path.stem
    assert store.load(stem) is not None
    path.chmod(0o666)
    assert store.load(stem) is None
    path.chmod(0o600)
    cache_folder.chmod(0o777)
    assert store.load(stem) is None
    assert store.save(first.code, stem) is None
    cache_folder.chmod(0o700)
    assert store.load(stem) is not None


PLAIN = 'plan = {"a": 1}\n\n\ndef f(x):\n    y = x * 2.0\n    return (y, sqrt(y),)\n'
HARMFUL = [
    "import os",
    "from os import system",
    "plan = __import__('os')",
    "f = (lambda: 1)()",
    "x = [y for y in (1,)]",
    "print('hello')",
    "def f(x):\n    return (__import__('os').system('true'),)",
    "def f(x):\n    return (x.real,)",
    "def f(x):\n    return (x[0],)",
    "def f(x=print()):\n    return (x,)",
    "def f(x: print()):\n    return (x,)",
    "def f(x) -> print():\n    return (x,)",
    "@print\ndef f(x):\n    return (x,)",
    "def f(*x):\n    return (x,)",
    "def f(x):\n    print(x)\n    return (x,)",
    "def f(x):\n    return (print,)",
    "def f(x):\n    return (eval(x),)",
    "def f(x):\n    return (sqrt(x, x),)",
    "def f(x):\n    return (sqrt(*x),)",
    "def f(x):\n    return ((y := x),)",
    "def f(x):\n    return (f'{x}',)",
    "def f(x):\n    return ('a',)",
    "def f(x):\n    return (x if x else 1.0,)",
    "def f(x):\n    return (2.0 ** x,)",
    "def f(x):\n    return (later,)",
    "def f(x):\n    sqrt = x\n    return (x,)",
    "def f(x):\n    __class__ = x\n    return (x,)",
    "def f(x):\n    while x:\n        x = x - 1.0\n    return (x,)",
    "def f(x):\n    def g(y):\n        return (y,)\n    return (x,)",
    "def f(x):\n    x.y = 1.0\n    return (x,)",
    "def f(x):\n    a, b = x\n    return (x,)",
    "async def f(x):\n    return (x,)",
    "class A:\n    pass",
    "def f(x):\n    return x",
    "def sqrt(x):\n    return (x,)",
    "if True:\n    pass",
    "not python (",
]


def test_plain_arithmetic_passes() -> None:
    generated = store.compile_vetted(PLAIN)
    assert generated.plan == {"a": 1}
    assert generated.functions["f"](8.0) == (16.0, 4.0)


@pytest.mark.parametrize("harm", HARMFUL)
def test_anything_else_is_refused_unseen(harm: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[object] = []
    monkeypatch.setattr("builtins.exec", lambda *a: ran.append(a))
    for text in (PLAIN + "\n\n" + harm, harm + "\n\n" + PLAIN):
        with pytest.raises(RootmatchError):
            store.compile_vetted(text)
    assert ran == []


def test_a_plan_is_a_literal() -> None:
    with pytest.raises(RootmatchError, match="Call does not occur"):
        store.compile_vetted(PLAIN.replace('{"a": 1}', "dict(a=1)"))
    with pytest.raises(RootmatchError, match="no plan"):
        store.compile_vetted(PLAIN.replace('{"a": 1}', "3"))


def test_pickled_and_back() -> None:
    problem = derived("p3p")
    again = pickle.loads(pickle.dumps(problem))
    assert again.tag == problem.tag
    scene = _p3p(1, 0.0)
    args = scene.source[None, :3], scene.target[None, scene.truth[:3]]
    np.testing.assert_array_equal(again.coefficients(*args), problem.coefficients(*args))


COMPILED = """
import numpy as np, sympy as sp
from rootmatch.backends import cpu
from rootmatch.problems.residual_kinds import QR
from rootmatch.derivation.derive import derive
from rootmatch.problems.derived.measurements import Points

x = sp.Symbol("x")
problem = derive("scale", lambda X, u: (u[1] - u[0]).dot(u[1] - u[0]) - x * (X[1] - X[0]).dot(X[1] - X[0]),
                 minimal=2, shared=x, source=Points(2), target=Points(2, noisy=True))
points = np.random.default_rng(0).normal(size=(5, 2))
index = np.arange(3)[None]
value = cpu.residuals(problem.prepare(points, 2.0 * points, 0.01), QR(), index, index)[0]
print(value < 1e-6, sum(cpu.evaluate.stats.cache_hits.values()))
"""
CODE = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
import test_derivation as t
print(t.up2p_by_rotation().code, t.p3p_by_cosines().code)
"""


def in_a_process(script: str, folder: Path, **variables: str) -> str:
    """What a process prints that keeps code and kernels in a folder."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder), "ROOTMATCH_CACHE_DIR": str(folder / "derived")}
    command = [sys.executable, "-c", script]
    return subprocess.run(command, env=environment | variables, capture_output=True, text=True, check=True).stdout


def test_code_is_the_same_in_every_process_and_the_next_one_finds_compiled_kernels(tmp_path: Path) -> None:
    """Sets of symbols have another order under another hash seed; the code must not, or compiled kernels are missed.

    Compiled drivers are found by the problem's tag, also where the process that compiled them has gone.
    """
    other = "1" if os.environ.get("PYTHONHASHSEED") == "0" else "0"
    compiled, _, there = in_a_process(COMPILED + CODE, tmp_path, PYTHONHASHSEED=other).partition("\n")
    assert compiled == "True 0"
    assert len(there) > 10_000
    assert there == f"{derived('up2p').code} {derived('p3p').code}\n"
    assert len(list((tmp_path / "derived").iterdir())) == 3  # nothing was read of what this process had left
    assert in_a_process(COMPILED, tmp_path) == "True 1\n"
