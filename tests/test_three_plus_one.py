"""3P1: its quartic against two independent libraries, its residuals against slow restatements, their calibration.

A root is judged by |h(x)| / Σ |c_k x^k|. An angle has no privileged zero, though, and x = tan(θ/2) has 0 and infinity:
within 0.1 of no turn or of half a turn, where rounding of the pixels alone may move x by 1e-9 of itself, the
homogeneous value |h(x)| / (|h| |(x⁴ … 1)|) judges instead.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import NamedTuple

import numpy as np
import poselib
import pytest
import pytheia
from scipy.spatial.transform import Rotation

from instances import random_unit
from rootmatch.backends import cpu
from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import InputError
from rootmatch.jit.decorators import driver
from rootmatch.problems.residual_dispatch import PANEL_ROWS, SCRATCH_ROWS, fill_panel, slab_residual
from rootmatch.problems.residual_kinds import QR, SVD, Joint, Normalised, QRBoth
from rootmatch.problems.three_plus_one.problem import ThreePlusOne
from rootmatch.simulation import Scene, three_plus_one_scene

Y = np.array([0.0, 1.0, 0.0])
LARGE = 1e6
TRIPLES = ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))
# bit k of `pairs` compares these two triples: any two share two correspondences
PAIRS = ((0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3))


# ------------------------------------------------------------------ instances


class Instance(NamedTuple):
    """Pixels of the same points in two images, cameras, axes, and the truth."""

    family: str
    source: np.ndarray
    target: np.ndarray
    camera: Camera
    camera2: Camera
    axis: np.ndarray
    axis2: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    angle: float

    @property
    def problem(self) -> ThreePlusOne:
        return ThreePlusOne(self.camera, self.camera2, self.axis, self.axis2)

    @property
    def rays(self) -> tuple[np.ndarray, np.ndarray]:
        return rays_of(self.source, self.camera), rays_of(self.target, self.camera2)


def rays_of(pixels: np.ndarray, camera: Camera) -> np.ndarray:
    rays = np.array([((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0) for u, v in pixels])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def to_y(axis: np.ndarray) -> np.ndarray:
    """The shortest turn that brings the axis to y."""
    sine = np.cross(axis, Y)
    size = np.linalg.norm(sine)
    if size == 0.0:
        return np.eye(3)
    return Rotation.from_rotvec(math.atan2(size, axis @ Y) * sine / size).as_matrix()


def random_camera(rng: np.random.Generator) -> Camera:
    f = rng.uniform(500.0, 2000.0)
    return Camera(f, f * rng.uniform(0.9, 1.1), rng.uniform(200.0, 500.0), rng.uniform(150.0, 400.0))


def make(
    rng: np.random.Generator,
    points: int = 4,
    angle: float | None = None,
    baseline: float | None = None,
    upright: bool = False,
    family: str = "generic",
) -> Instance:
    """Points before both cameras, which a turn by the angle and a baseline relate.

    Without a baseline it is what takes one cloud of points, at (0, 0, 8), to another; with one, turns are drawn until
    both cameras see the points.
    """
    turn = rng.uniform(-0.95, 0.95) * math.pi if angle is None else angle
    while True:
        axis, axis2 = (Y if upright else random_unit(rng) for _ in range(2))
        rotation = to_y(axis2).T @ Rotation.from_rotvec(turn * Y).as_matrix() @ to_y(axis)
        second = np.array([0.0, 0.0, 8.0]) + rng.uniform(-3.0, 3.0, (points, 3))
        if baseline is None:
            translation = np.array([0.0, 0.0, 8.0]) - rotation @ [0.0, 0.0, 8.0] + rng.uniform(-1.0, 1.0, 3)
        else:
            translation = baseline * rng.uniform(1.0, 2.0) * random_unit(rng)
        first = (second - translation) @ rotation
        if first[:, 2].min() > 1.0 and np.abs(first[:, :2]).max() < 2.0 * first[:, 2].min():
            break
        turn = rng.uniform(-0.95, 0.95) * math.pi if angle is None else angle
    camera, camera2 = random_camera(rng), random_camera(rng)
    source, target = camera.project(first), camera2.project(second)
    return Instance(family, source, target, camera, camera2, axis, axis2, rotation, translation, turn)


def all_instances() -> list[Instance]:
    rng = np.random.default_rng(0)
    made = [make(rng, upright=k % 3 == 0, family="upright" if k % 3 == 0 else "generic") for k in range(420)]
    for strength in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6):
        for _ in range(15):
            made.append(make(rng, baseline=strength, family="short baseline"))
            made.append(make(rng, angle=strength * rng.choice((-1.0, 1.0)), family="small angle"))
            made.append(make(rng, angle=math.pi - strength, family="near half a turn"))
    made += [make(rng, angle=0.0, upright=True, family="no turn") for _ in range(15)]
    return made


INSTANCES = all_instances()


def quartic_of(instance: Instance, triple: tuple[int, ...] = (0, 1, 2)) -> np.ndarray:
    index = list(triple)
    return instance.problem.coefficients(instance.source[None, index], instance.target[None, index])[0]


def relative_value(h: np.ndarray, angle: float) -> float:
    """How far an angle is from being a root: see the top of this file."""
    s, c = math.sin(0.5 * angle), math.cos(0.5 * angle)
    powers = np.array([s**4, s**3 * c, s**2 * c**2, s * c**3, c**4])
    value = abs(h @ powers)
    near_zero = min(abs(angle), math.pi - abs(angle)) <= 0.1
    return float(value / (np.linalg.norm(h) * np.linalg.norm(powers) if near_zero else np.abs(h) @ np.abs(powers)))


def angle_of(instance: Instance, rotation: np.ndarray) -> float:
    """Angle about y once both axes are y."""
    upright = to_y(instance.axis2) @ rotation @ to_y(instance.axis).T
    return math.atan2(upright[0, 2] - upright[2, 0], upright[0, 0] + upright[2, 2])


def by_poselib(instance: Instance) -> list[np.ndarray]:
    """poselib turns about y."""
    first, second = (r[:3] @ to_y(a).T for r, a in zip(instance.rays, (instance.axis, instance.axis2), strict=True))
    poses = poselib.relpose_upright_3pt(first, second)
    return [to_y(instance.axis2).T @ pose.R @ to_y(instance.axis) for pose in poses]


def by_pytheia(instance: Instance) -> list[np.ndarray]:
    """pytheia takes any axis, the same in both views: only the first is turned. Its quaternions are w, x, y, z."""
    between = to_y(instance.axis2).T @ to_y(instance.axis)
    first, second = instance.rays
    found, _ = pytheia.sfm.ThreePointRelativePosePartialRotation(
        instance.axis2, list(first[:3] @ between.T), list(second[:3])
    )
    turns = [Rotation.from_quat(np.ravel(q), scalar_first=True).as_matrix() for q in found]
    return [turn @ between for turn in turns]


def polished(instance: Instance, angle: float) -> float:
    """Two secant steps of at most 1e-4 on det[n₁ n₂ n₃], computed without the polynomial."""
    q, p = turned_rays(instance)
    for _ in range(2):
        ends = [float(np.linalg.det(normals(q[:3], p[:3], angle + step))) for step in (-1e-5, 0.0, 1e-5)]
        angle -= float(np.clip(ends[1] * 2e-5 / (ends[2] - ends[0]), -1e-4, 1e-4))
    return angle


def epipolar_error(instance: Instance, rotation: np.ndarray) -> float:
    """How far three n = (R q) × q' are from one plane: least singular value of unit vectors."""
    first, second = instance.rays
    n = np.cross(first[:3] @ rotation.T, second[:3])
    return float(np.linalg.svd(n / np.linalg.norm(n, axis=1, keepdims=True))[1][-1])


class TestQuartic:
    def test_at_least_500_instances_and_near_degenerate_ones(self) -> None:
        assert len(INSTANCES) >= 500
        for family in ("generic", "upright", "short baseline", "small angle", "near half a turn", "no turn"):
            assert sum(k.family == family for k in INSTANCES) >= 15

    def test_the_truth_is_a_root(self) -> None:
        for instance in INSTANCES:
            assert angle_of(instance, instance.rotation) == pytest.approx(instance.angle, abs=1e-9)
            for triple in TRIPLES:
                assert relative_value(quartic_of(instance, triple), instance.angle) <= 1e-9, instance.family

    @pytest.mark.parametrize(("library", "no_solutions"), [(by_poselib, 0.005), (by_pytheia, 0.2)])
    def test_every_solution_of_a_library_is_a_root(self, library: object, no_solutions: float) -> None:
        """What solves the epipolar equations to 1e-6 is a root, once the library's rounding is polished away.

        Some answers do not (1e-5 and more): poselib's where no turn is a root, pytheia's where roots
        are complex and at small angles.
        """
        answers, dropped, truths = 0, 0, 0
        for instance in INSTANCES:
            h = quartic_of(instance)
            near = False
            for rotation in library(instance):  # type: ignore[operator]
                answers += 1
                if not np.isfinite(rotation).all():
                    dropped += 1
                    continue
                angle = angle_of(instance, rotation)
                if relative_value(h, angle) > 1e-9:
                    if epipolar_error(instance, rotation) > 1e-6:
                        dropped += 1
                        continue
                    angle = polished(instance, angle)
                assert relative_value(h, angle) <= 1e-9, (instance.family, angle)
                near |= abs(math.remainder(angle - instance.angle, math.tau)) < 1e-4
            truths += near
        assert dropped <= no_solutions * answers
        assert answers >= 2 * len(INSTANCES)
        assert truths >= 0.9 * len(INSTANCES)

    def test_every_real_root_solves_the_epipolar_equations(self) -> None:
        """The other way round: no root is invented."""
        for instance in INSTANCES:
            if instance.family not in ("generic", "upright"):
                continue
            for x in np.roots(quartic_of(instance)):
                if abs(x.imag) > 1e-9 or abs(x) > 1e3:
                    continue
                turn = Rotation.from_rotvec(2.0 * math.atan(x.real) * Y).as_matrix()
                rotation = to_y(instance.axis2).T @ turn @ to_y(instance.axis)
                assert epipolar_error(instance, rotation) < 1e-6

    def test_against_interpolated_determinants(self) -> None:
        """h(x) = (1 + x²)² D(θ) at nine angles, as a polynomial of degree 4 through them."""
        for instance in INSTANCES[:60]:
            h = quartic_of(instance)
            np.testing.assert_allclose(h, slow_quartic(instance, (0, 1, 2)), atol=1e-13)

    def test_an_axis_may_have_any_length(self) -> None:
        instance = INSTANCES[1]
        longer = ThreePlusOne(instance.camera, instance.camera2, 3.0 * instance.axis, 0.1 * instance.axis2)
        source, target = instance.source[None, :3], instance.target[None, :3]
        np.testing.assert_allclose(longer.coefficients(source, target)[0], quartic_of(instance), atol=1e-15)

    def test_both_axes_may_be_reversed(self) -> None:
        """Another angle then, but still one that all triples share."""
        for instance in INSTANCES[:20]:
            opposite = ThreePlusOne(instance.camera, instance.camera2, -instance.axis, -instance.axis2)
            indices = np.array(TRIPLES)
            quartics = opposite.coefficients(instance.source[indices], instance.target[indices])
            roots = [np.roots(h) for h in quartics]
            gaps = [max(np.abs(other - r).min() for other in roots[1:]) / (1.0 + abs(r)) for r in roots[0]]
            assert min(gaps) < 1e-6

    def test_no_minimal_sets(self) -> None:
        assert INSTANCES[0].problem.coefficients(np.empty((0, 3, 2)), np.empty((0, 3, 2))).shape == (0, 5)


# ------------------------------------------------------------------ slow restatements of the residuals


def turned_rays(instance: Instance) -> tuple[np.ndarray, np.ndarray]:
    first, second = instance.rays
    return first @ to_y(instance.axis).T, second @ to_y(instance.axis2).T


def normals(q: np.ndarray, p: np.ndarray, angle: float | np.ndarray) -> np.ndarray:
    """Normals of the epipolar planes; of several angles, or several sets of rays, one after another."""
    turn = Rotation.from_rotvec(np.multiply.outer(angle, Y)).as_matrix()
    return np.cross(q @ np.swapaxes(turn, -1, -2), p)


def slow_quartic(instance: Instance, triple: tuple[int, ...], p: np.ndarray | None = None) -> np.ndarray:
    q, second = turned_rays(instance)
    p = second if p is None else p
    angles = np.linspace(-2.0, 2.0, 9)
    values = np.linalg.det(normals(q[list(triple)], p[list(triple)], angles))
    x = np.tan(0.5 * angles)
    return np.polyfit(x, values * (1.0 + x * x) ** 2, 4)


def sylvester(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    rows = [np.concatenate((np.zeros(m), f / np.linalg.norm(f), np.zeros(3 - m))) for f in (p, q) for m in range(4)]
    return np.array(rows)


def by_qr(p: np.ndarray, q: np.ndarray) -> float:
    return float(abs(np.linalg.qr(sylvester(p, q))[1][-1, -1]))


def by_svd(p: np.ndarray, q: np.ndarray) -> float:
    return float(np.linalg.svd(sylvester(p, q))[1][-1])


def determinant_slopes(q: np.ndarray, p: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """D, D' and D'' of three correspondences, by differences."""
    step = 1e-4
    low, middle, high = (np.linalg.det(normals(q, p, angle + k * step)) for k in (-1, 0, 1))
    return middle, (high - low) / (2.0 * step), (high - 2.0 * middle + low) / step**2


def solved(q: np.ndarray, p: np.ndarray, start: float) -> tuple[np.ndarray, np.ndarray]:
    """Roots of D near an angle by Newton's method, of each set of three correspondences, and the baselines."""
    angle = np.full(len(q), start)
    for _ in range(8):
        value, slope, _ = determinant_slopes(q, p, angle)
        angle = angle - value / slope
    return angle, np.linalg.svd(normals(q, p, angle))[2][:, -1]


def slow_residuals(q: np.ndarray, p: np.ndarray, sigma: np.ndarray, sigma2: np.ndarray) -> list[tuple[float, bool]]:
    """|e₄| / σ at every real root of the first three, the σ by turning each ray a little and solving again.

    With each, whether all four points lie in front of both cameras.
    """
    step = 1e-6
    first, second, deviations = [q], [p], []
    for k, side in itertools.product(range(4), range(2)):
        for direction in np.linalg.svd((q, p)[side][k][None])[2][1:]:
            for sign in (step, -step):
                moved = [q.copy(), p.copy()]
                moved[side][k] += sign * direction
                first.append(moved[0])
                second.append(moved[1])
            deviations.append((sigma, sigma2)[side][k])
    every, every2 = np.array(first), np.array(second)
    found = []
    for start in [math.atan(x.real) * 2.0 for x in real_roots(q[:3], p[:3])]:
        angle, t = solved(every[:, :3], every2[:, :3], start)
        t = np.where(t @ t[0] > 0.0, 1.0, -1.0)[:, None] * t
        e4, *ends = (normals(every[:, 3:], every2[:, 3:], angle)[:, 0] * t).sum(axis=1)
        slopes = (np.array(ends[::2]) - np.array(ends[1::2])) / (2.0 * step)
        variance = float(((slopes * deviations) ** 2).sum())
        found.append((abs(e4) / math.sqrt(variance), in_front(q, p, float(angle[0]), t[0])))
    return found


def real_roots(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    angles = np.linspace(-2.0, 2.0, 9)
    x = np.tan(0.5 * angles)
    values = np.linalg.det(normals(q, p, angles))
    roots = np.roots(np.polyfit(x, values * (1.0 + x * x) ** 2, 4))
    return roots[np.abs(roots.imag) < 1e-9]


def in_front(q: np.ndarray, p: np.ndarray, angle: float, t: np.ndarray) -> bool:
    """Whether the rays meet at positive depths, least squares, for t or for −t."""
    u = Rotation.from_rotvec(angle * Y).apply(q)
    depths = np.array([np.linalg.lstsq(np.stack((-a, b), axis=1), t, rcond=None)[0] for a, b in zip(u, p, strict=True)])
    return bool((depths > 0.0).all() or (depths < 0.0).all())


def residual(instance: Instance, target: np.ndarray, kind: object, sigma: float = 0.5) -> float:
    index = np.arange(4)[None]
    return float(cpu.residuals(instance.problem.prepare(instance.source, target, sigma), kind, index, index)[0])


def cases(count: int = 40) -> list[tuple[Instance, np.ndarray]]:
    """True, noisy and wrong hyper-edges."""
    rng = np.random.default_rng(1)
    made = []
    for _ in range(count):
        instance = make(rng, angle=rng.uniform(-1.2, 1.2))
        made.append((instance, instance.target))
        made.append((instance, instance.target + 0.5 * rng.normal(size=(4, 2))))
        made.append((instance, instance.target[rng.permutation(4)] + 20.0 * rng.normal(size=(4, 2))))
    return made


class TestResultants:
    @pytest.mark.parametrize("bit", range(6))
    @pytest.mark.parametrize(("kind", "oracle"), [(QR, by_qr), (SVD, by_svd)])
    def test_against_factorisations(self, kind: type, oracle: object, bit: int) -> None:
        for instance, target in cases():
            p = rays_of(target, instance.camera2) @ to_y(instance.axis2).T
            h, g = (slow_quartic(instance, TRIPLES[k], p) for k in PAIRS[bit])
            wanted = oracle(h, g)  # type: ignore[operator]
            assert residual(instance, target, kind(1 << bit)) == pytest.approx(wanted, rel=1e-6, abs=1e-11)

    def test_both_orders(self) -> None:
        for instance, target in cases():
            p = rays_of(target, instance.camera2) @ to_y(instance.axis2).T
            h, g = (slow_quartic(instance, TRIPLES[k], p) for k in (0, 1))
            wanted = min(by_qr(h, g), by_qr(h[::-1], g[::-1]))
            assert residual(instance, target, QRBoth()) == pytest.approx(wanted, rel=1e-6, abs=1e-12)

    @pytest.mark.parametrize("kind", [QR, QRBoth, SVD, Normalised, Joint])
    def test_several_pairs_mean_the_greatest(self, kind: type) -> None:
        for instance, target in cases(10):
            each = [residual(instance, target, kind(1 << bit)) for bit in range(6)]
            assert residual(instance, target, kind(0b111111)) == pytest.approx(max(each), rel=1e-9, abs=1e-15)
            assert residual(instance, target, kind(0b010100)) == pytest.approx(
                max(each[2], each[4]), rel=1e-9, abs=1e-15
            )


def by_cosine(instance: Instance) -> Instance:
    """The same instance; its problem has the paper's unknown."""
    return CosineInstance(*instance)


class CosineInstance(Instance):
    @property
    def problem(self) -> ThreePlusOne:
        return dataclasses.replace(Instance(*self).problem, unknown="cos")


def slow_cosine_quartic(instance: Instance, triple: tuple[int, ...], p: np.ndarray | None = None) -> np.ndarray:
    """D(θ) D(−θ) interpolated as a polynomial in cos θ."""
    q, second = turned_rays(instance)
    p = second if p is None else p
    angles = np.linspace(0.2, 2.9, 9)
    both = [np.linalg.det(normals(q[list(triple)], p[list(triple)], sign * angles)) for sign in (1.0, -1.0)]
    return np.polyfit(np.cos(angles), both[0] * both[1], 4)


class TestCosine:
    """The unknown x = cos θ."""

    def test_the_true_cosine_is_a_root(self) -> None:
        for instance in all_instances():
            h = quartic_of(by_cosine(instance))
            assert abs(np.polyval(h, math.cos(instance.angle))) < 1e-9 * np.abs(h).sum()

    def test_it_is_the_product_of_the_determinants_of_both_turns(self) -> None:
        for instance, _ in cases():
            h, wanted = quartic_of(by_cosine(instance)), slow_cosine_quartic(instance, (0, 1, 2))
            np.testing.assert_allclose(h, wanted, rtol=1e-6, atol=1e-9 * np.abs(wanted).max())

    @pytest.mark.parametrize(("kind", "oracle"), [(QR, by_qr), (SVD, by_svd)])
    def test_residuals_against_factorisations(self, kind: type, oracle: object) -> None:
        for instance, target in cases():
            p = rays_of(target, instance.camera2) @ to_y(instance.axis2).T
            h, g = (slow_cosine_quartic(instance, TRIPLES[k], p) for k in (0, 1))
            wanted = oracle(h, g)  # type: ignore[operator]
            assert residual(by_cosine(instance), target, kind()) == pytest.approx(wanted, rel=1e-5, abs=1e-9)

    def test_residuals_in_units_of_the_noise_do_not_depend_on_the_unknown(self) -> None:
        for instance, target in cases(10):
            for kind in (Normalised(), Joint()):
                found = residual(by_cosine(instance), target, kind)
                assert found == pytest.approx(residual(instance, target, kind), rel=1e-12)


class TestNormalised:
    def test_against_differences_through_newtons_method(self) -> None:
        """Wherever the roots lie well apart, to which the first order is confined; the least over those in front."""
        rng = np.random.default_rng(2)
        compared = 0
        for _ in range(60):
            instance = make(rng, angle=rng.uniform(-1.8, 1.8))
            sigma = 0.01
            target = instance.target + sigma * rng.normal(size=(4, 2))
            q, p = rays_of(instance.source, instance.camera), rays_of(target, instance.camera2)
            q, p = q @ to_y(instance.axis).T, p @ to_y(instance.axis2).T
            roots = np.roots(slow_quartic(instance, (0, 1, 2), p))
            gaps = [abs(a - b) for a, b in itertools.combinations(roots, 2)]
            if min(gaps) < 0.1 or np.abs(roots.imag[np.abs(roots.imag) > 1e-9]).min(initial=1.0) < 0.1:
                continue
            tables = instance.problem.prepare(instance.source, target, sigma)
            all_found = slow_residuals(q, p, tables.source_deviation, tables.target_deviation)
            wanted = min((z for z, front in all_found if front), default=math.inf)
            value = residual(instance, target, Normalised(), sigma)
            assert value == pytest.approx(min(wanted, LARGE), rel=0.01)
            compared += 1
        assert compared >= 25

    def test_joint_is_the_same(self) -> None:
        """One constraint: nothing to join."""
        for instance, target in cases():
            assert residual(instance, target, Joint()) == residual(instance, target, Normalised())

    def test_all_pairs_agree_to_first_order(self) -> None:
        rng = np.random.default_rng(3)
        spread = []
        for _ in range(60):
            instance = make(rng, baseline=3.0)
            target = instance.target + 0.02 * rng.normal(size=(4, 2))
            each = [residual(instance, target, Normalised(1 << bit), 0.02) for bit in range(6)]
            spread.append(max(each) / min(each) - 1.0)
        assert np.median(spread) < 0.05

    def test_noise_scales_it(self) -> None:
        rng = np.random.default_rng(4)
        instance = make(rng, baseline=3.0)
        target = instance.target + 0.02 * rng.normal(size=(4, 2))
        one, two = residual(instance, target, Normalised(), 0.02), residual(instance, target, Normalised(), 0.04)
        assert one == pytest.approx(2.0 * two, rel=0.02)

    def test_half_a_turn_does_no_harm(self) -> None:
        rng = np.random.default_rng(5)
        values = [
            residual(instance, instance.target, Normalised(), 1e-3)
            for instance in (make(rng, angle=math.pi - 10.0**-k) for k in range(1, 12))
        ]
        assert max(values) < 1e-3

    def test_exact_data_agree(self) -> None:
        """Zero noise means 1e-6 px; even so, exact hyper-edges stay within a fraction of it, short baselines too."""
        rng = np.random.default_rng(6)
        instances = [make(rng, baseline=10.0 ** rng.uniform(-2.0, 0.5)) for _ in range(200)]
        values = [residual(instance, instance.target, Normalised(), 0.0) for instance in instances]
        assert np.quantile(values, 0.95) < 0.5


class TestInFront:
    def test_a_point_behind_one_camera(self) -> None:
        """Its ray meets the epipolar line all the same: only the depth tells."""
        rng = np.random.default_rng(7)
        refused = 0
        for _ in range(100):
            instance = make(rng, points=3, baseline=3.0, upright=True)
            ray = rays_of(np.array([[320.0, 240.0]]) + rng.uniform(-100.0, 100.0, (1, 2)), instance.camera)[0]
            behind = instance.rotation @ (-rng.uniform(0.5, 2.0) * ray) + instance.translation
            if behind[2] < 0.2 or np.abs(behind[:2]).max() > 3.0 * behind[2]:
                continue
            source = np.concatenate((instance.source, instance.camera.project(ray[None])))
            target = np.concatenate((instance.target, instance.camera2.project(behind[None])))
            value = residual(instance._replace(source=source), target, Normalised(), 0.01)
            refused += 1
            assert value > 30.0
        assert refused >= 10

    def test_sides_are_decided_beyond_the_noise_only(self) -> None:
        """Points 1e6 away: in front and behind are the same within noise, and must not be refused."""
        rng = np.random.default_rng(8)
        passed = []
        for _ in range(100):
            instance = make(rng, baseline=3.0, upright=True, angle=rng.uniform(-0.3, 0.3))
            far = 1e6 * rays_of(instance.source[3:], instance.camera)
            source = np.concatenate((instance.source[:3], instance.camera.project(far)))
            pixels = instance.camera2.project(far @ instance.rotation.T + instance.translation)
            target = np.concatenate((instance.target[:3], pixels)) + 0.3 * rng.normal(size=(4, 2))
            passed.append(residual(instance._replace(source=source), target, Normalised(), 0.3) < 3.0)
        assert np.mean(passed) >= 0.9


class TestDegenerate:
    def tables(self, index: list[int]) -> object:
        """Tables of one exact instance in which correspondences are repeated."""
        instance = make(np.random.default_rng(9), points=4, baseline=3.0)
        tables = instance.problem.prepare(instance.source, instance.target, 0.5)
        return tables._replace(
            source=np.ascontiguousarray(tables.source[:, index]), target=np.ascontiguousarray(tables.target[:, index])
        )

    @pytest.mark.parametrize("index", [[0, 0, 1, 2], [0, 1, 1, 2], [0, 0, 0, 0]])
    def test_a_repeated_correspondence_says_nothing(self, index: list[int]) -> None:
        """Determinants that vanish at every angle: no information is not agreement."""
        tables, four = self.tables(index), np.arange(4)[None]
        assert cpu.residuals(tables, Normalised(), four, four)[0] == LARGE
        assert cpu.residuals(tables, Joint(), four, four)[0] == LARGE
        for kind in (QR(), QRBoth(), SVD()):
            assert not np.isnan(cpu.residuals(tables, kind, four, four)[0])

    def test_the_fourth_repeats_the_third(self) -> None:
        """The prediction is the third's own, so the fourth adds nothing and its variance is that of the noise."""
        tables, four = self.tables([0, 1, 2, 2]), np.arange(4)[None]
        assert np.isfinite(cpu.residuals(tables, Normalised(), four, four)[0])

    @pytest.mark.parametrize("noise", [0.0, 0.3])
    def test_pure_rotation_gives_no_nan(self, noise: float) -> None:
        rng = np.random.default_rng(10)
        values = []
        for _ in range(100):
            instance = make(rng, baseline=0.0)
            target = instance.target + noise * rng.normal(size=(4, 2))
            for kind in (QR(), QRBoth(), SVD(), Normalised(), Joint()):
                value = residual(instance, target, kind, max(noise, 0.1))
                assert 0.0 <= value <= LARGE
            values.append(value)
        if noise:
            assert np.mean(np.array(values) < 3.0) >= 0.9

    def test_an_uncertain_prediction_says_nothing(self) -> None:
        """Noise of twice the focal length: anything would fit."""
        rng = np.random.default_rng(11)
        for _ in range(20):
            instance = make(rng, baseline=1.0)
            assert residual(instance, instance.target, Normalised(), 2.0 * instance.camera2.fx) == LARGE


@driver()
def slab(tables, kind, i, j, first, panel, scratch, out):  # type: ignore[no-untyped-def]
    """Both steps of a slab, kept on disk: they take longer to compile than all other tests of this file."""
    fill_panel(tables, kind, i, j, panel)
    slab_residual(tables, kind, i, j, first, panel, scratch, out)


class TestSlab:
    @pytest.mark.parametrize("kind", [QR(), QRBoth(), SVD(), Normalised(), Joint(), Normalised(0b100010), QR(0b11)])
    def test_a_slab_is_its_edges(self, kind: object) -> None:
        scene = three_plus_one_scene(n=9, outliers=3, noise=0.5, seed=2, baseline=5.0)
        tables = scene.problem.prepare(scene.source, scene.target, 0.5)
        rng = np.random.default_rng(12)
        finite = 0
        for _ in range(30):
            i = np.sort(rng.choice(8, 3, replace=False))
            j = rng.choice(12, 3, replace=False) if rng.random() < 0.5 else scene.truth[i]
            first = int(i[2]) + 1
            out = np.full((9 - first, 12), -1.0)
            rooms = np.empty((PANEL_ROWS, 12)), np.empty((SCRATCH_ROWS, 9))
            slab(tables, kind, np.append(i, first), np.append(j, 0), first, *rooms, out)
            rest = [k for k in range(12) if k not in j]
            sources = np.array([[*i, first + r] for r in range(9 - first) for _ in rest])
            targets = np.array([[*j, k] for _ in range(9 - first) for k in rest])
            wanted = cpu.residuals(tables, kind, sources, targets).reshape(9 - first, len(rest))
            np.testing.assert_allclose(out[:, rest], wanted, rtol=1e-6, atol=1e-14)
            finite += int((wanted < LARGE).sum())
        assert finite > 20


# ------------------------------------------------------------------ calibration


def hyperedges(scene: Scene, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    n, n_target = len(scene.source), len(scene.target)
    i = np.array([rng.permutation(n)[:4] for _ in range(count)])
    j = np.array([rng.permutation(n_target)[:4] for _ in range(count)])
    return i, scene.truth[i], j


def measured(noise: float, baseline: float, scenes: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of true hyper-edges and of random ones (true by chance in 1 of 5040)."""
    rng = np.random.default_rng(13)
    true, false = [], []
    for seed in range(scenes):
        scene = three_plus_one_scene(noise=noise, seed=seed, baseline=baseline)
        tables = scene.problem.prepare(scene.source, scene.target, noise)
        i, truth, j = hyperedges(scene, rng, 150)
        true.append(cpu.residuals(tables, Normalised(), i, truth))
        false.append(cpu.residuals(tables, Normalised(), i, j))
    return np.concatenate(true), np.concatenate(false)


class TestCalibration:
    @pytest.mark.parametrize(
        # share of false hyper-edges within 3σ: what the residual is for
        ("noise", "baseline", "false"),
        [(0.1, 5.0, 0.006), (0.5, 5.0, 0.025), (1.0, 5.0, 0.06), (0.1, 1.0, 0.006), (1.0, 1.0, 0.06)],
    )
    def test_true_hyperedges_pass_and_false_ones_do_not(self, noise: float, baseline: float, false: float) -> None:
        true, others = measured(noise, baseline)
        assert np.mean(true < 3.0) >= 0.97
        assert np.mean(true < 2.0) >= 0.93
        assert np.mean(others < 3.0) <= false

    def test_follows_the_normal_distribution_for_small_noise(self) -> None:
        """The least over roots lowers it a little, never raises it: 69 % within 1σ become 72 %."""
        true, _ = measured(0.1, 5.0)
        for sigmas, share in ((0.5, 0.383), (1.0, 0.683), (2.0, 0.954)):
            assert -0.03 < np.mean(true < sigmas) - share < 0.12

    def test_variance_by_monte_carlo(self) -> None:
        """Of one hyper-edge with roots apart: the residual's rms over noise in both images is 1."""
        scene = three_plus_one_scene(noise=0.0, seed=3, baseline=5.0)
        rng = np.random.default_rng(14)
        noise = 0.02
        within = []
        for _ in range(12):
            i = rng.permutation(10)[:4]
            four = np.arange(4)[None]
            values = []
            for _ in range(200):
                source = scene.source[i] + noise * rng.normal(size=(4, 2))
                target = scene.target[scene.truth[i]] + noise * rng.normal(size=(4, 2))
                tables = scene.problem.prepare(source, target, noise)
                values.append(cpu.residuals(tables, Normalised(), four, four)[0])
            within.append(np.sqrt(np.mean(np.square(values))))
        assert np.median(within) == pytest.approx(1.0, abs=0.08)

    def test_noise_of_each_image_apart(self) -> None:
        """Noise in the first image only; told so the residual is calibrated, told the reverse it is not."""
        rng = np.random.default_rng(15)
        told, reversed_ = [], []
        for seed in range(30):
            scene = three_plus_one_scene(noise=0.0, seed=seed, baseline=5.0)
            source = scene.source + 0.3 * rng.normal(size=scene.source.shape)
            i, truth, _ = hyperedges(scene, rng, 60)
            for values, pair in ((told, (0.3, 0.0)), (reversed_, (0.0, 0.003))):
                tables = scene.problem.prepare(source, scene.target, pair)
                values.append(cpu.residuals(tables, Normalised(), i, truth))
        assert np.mean(np.concatenate(told) < 3.0) >= 0.96
        assert np.mean(np.concatenate(reversed_) < 3.0) < 0.3

    def test_noise_of_the_axis(self) -> None:
        """Both axes off by 1 mrad; told so the residual is calibrated, not told it is not."""
        rng = np.random.default_rng(16)
        told, untold = [], []
        for seed in range(150):
            scene = three_plus_one_scene(noise=0.05, seed=seed, baseline=5.0)
            axes = [(1e-3 * rng.normal(), 1.0, 1e-3 * rng.normal()) for _ in range(2)]
            i, truth, _ = hyperedges(scene, rng, 10)
            for values, spread in ((told, 1e-3), (untold, 0.0)):
                problem = ThreePlusOne(*scene.cameras, *axes, axis_noise=spread)
                tables = problem.prepare(scene.source, scene.target, 0.05)
                values.append(cpu.residuals(tables, Normalised(), i, truth))
        assert np.mean(np.concatenate(told) < 3.0) >= 0.96
        assert np.mean(np.concatenate(told) < 1.0) <= 0.85
        assert np.mean(np.concatenate(untold) < 3.0) < 0.9


class TestBadInput:
    def points(self) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(17)
        return rng.uniform(0.0, 640.0, (5, 2)), rng.uniform(0.0, 640.0, (6, 2))

    @pytest.mark.parametrize(
        ("settings", "text"),
        [
            ({"axis": (0, 0, 0)}, "axis: its length is 0"),
            ({"axis2": (0, float("nan"), 0)}, "axis2"),
            ({"axis_noise": -1.0}, "axis_noise"),
            ({"axis": ()}, "axis: none given; 3p1 needs a direction that both images share.* five-point solver"),
            ({"axis2": ()}, "axis2: none given"),
            ({"unknown": "sin"}, "give 'tan'"),
        ],
    )
    def test_of_the_problem(self, settings: dict[str, object], text: str) -> None:
        with pytest.raises(InputError, match=text):
            ThreePlusOne(Camera(1000, 1000, 320, 240), **{"axis": (0, 1, 0), "axis2": (0, 1, 0)} | settings)

    def test_of_the_points(self) -> None:
        problem = ThreePlusOne(Camera(1000, 1000, 320, 240), axis=(0, 1, 0), axis2=(0, 1, 0))
        source, target = self.points()
        with pytest.raises(InputError, match="source"):
            problem.prepare(source[:3], target)
        with pytest.raises(InputError, match="target"):
            problem.prepare(source, np.full((6, 2), np.nan))
        with pytest.raises(InputError, match="noise of the source"):
            problem.prepare(source, target, (-1.0, 1.0))
        with pytest.raises(InputError, match="noise"):
            problem.prepare(source, target, np.ones(5))
        with pytest.raises(InputError, match="normals"):
            problem.prepare(source, target, 1.0, np.ones((5, 3)))

    def test_noise_of_each_point(self) -> None:
        """n' numbers are the target's; the source gets their root mean square."""
        problem = ThreePlusOne(Camera(1000, 1000, 320, 240), axis=(0, 1, 0), axis2=(0, 1, 0))
        source, target = self.points()
        noise = np.array([1.0, 2.0, 3.0, 1.0, 2.0, 3.0])
        tables = problem.prepare(source, target, noise)
        plain = problem.prepare(source, target, 1.0)
        np.testing.assert_allclose(tables.target_deviation, noise * plain.target_deviation)
        np.testing.assert_allclose(tables.source_deviation, np.sqrt(28.0 / 6.0) * plain.source_deviation)

    def test_the_second_camera_is_the_first_by_default(self) -> None:
        camera = Camera(1000, 900, 320, 240)
        assert ThreePlusOne(camera, axis=(0, 1, 0), axis2=(0, 1, 0)).cameras == (camera, camera)
        assert ThreePlusOne(camera, Camera(1, 1, 0, 0), axis=(0, 1, 0), axis2=(0, 1, 0)).cameras[1] == Camera(
            1, 1, 0, 0
        )
