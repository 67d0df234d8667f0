"""Residuals of hyper-edges against the oracles: true, noisy and wrong ones, every choice of pairs, degenerate ones.

Where closed form and factorisation part in float64 is stated with each tolerance.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest

import instances
import oracles
import rootmatch
from instances import Instance
from rootmatch.backends import cpu
from rootmatch.cameras.pinhole import Camera
from rootmatch.problems.base import Problem
from rootmatch.problems.p3p.problem import P3P
from rootmatch.problems.residual_kinds import QR, SVD, Joint, Normalised, QRBoth
from rootmatch.problems.up2p.problem import UP2P

SIGMA = 0.5
SHARED_PAIRS = tuple(itertools.combinations(range(4), 2))  # P3P: bit k of `pairs` shares the k-th pair
UPRIGHT_ORDERS = ((0, 1, 2), (1, 0, 2), (2, 0, 1))  # up2p: bit k compares the quadratics of (a, b) and (a, c)
LARGE = 1e5


def problem_of(instance: Instance, tilt: float = 0.0) -> Problem:
    """P3P for four points, up2p for three."""
    camera = Camera(*instance.intrinsics)
    if len(instance.source) == 4:
        return P3P(camera)
    return UP2P(camera, instance.vertical_camera, instance.vertical_world, tilt)


def residual(instance: Instance, target: np.ndarray, kind: object, sigma: float = SIGMA, tilt: float = 0.0) -> float:
    """Residual of the hyper-edge that matches point k to pixel k."""
    tables = problem_of(instance, tilt).prepare(instance.source, target, sigma)
    index = np.arange(len(target))[None]
    return float(cpu.residuals(tables, kind, index, index)[0])


def cases(makers: list, count: int, seed: int) -> list[tuple[str, Instance, np.ndarray]]:
    """Exact, noisy (SIGMA) and wrong hyper-edges: pixels exchanged and moved by 20 px."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(count):
        for maker in makers:
            instance = maker(rng)
            size = instance.target.shape
            made.append(("true", instance, instance.target))
            made.append(("noisy", instance, instance.target + SIGMA * rng.normal(size=size)))
            made.append(("wrong", instance, instance.target[rng.permutation(size[0])] + 20.0 * rng.normal(size=size)))
    return made


P3P_CASES = cases(
    [
        lambda rng: instances.p3p_generic(rng, 4),
        lambda rng: instances.p3p_wide(rng, 4),
        lambda rng: instances.paper_scene("p3p", rng, 4),
    ],
    12,
    1,
)
UP2P_CASES = cases(
    [lambda rng: instances.up2p_generic(rng, 3), lambda rng: instances.paper_scene("up2p", rng, 3)], 15, 2
)


class TestResultants:
    """The paper's residuals against plain QR and SVD of the Sylvester matrix of interpolated polynomials."""

    @pytest.mark.parametrize("bit", range(6))
    @pytest.mark.parametrize(
        # Closed forms have a floor (see below); factorisations of both kinds agree to the polynomials' own rounding.
        ("kind", "oracle", "tolerance"),
        [(QR, oracles.qr, 2e-9), (QRBoth, oracles.qr_both, 2e-9), (SVD, oracles.svd, 1e-12)],
    )
    def test_p3p(self, kind: type, oracle: object, tolerance: float, bit: int) -> None:
        for what, instance, target in P3P_CASES:
            rays = oracles.bearings(target, instance.intrinsics)
            p, q = (f(rays) for f in oracles.p3p_polynomials(instance.source, SHARED_PAIRS[bit]))
            value = residual(instance, target, kind(1 << bit))
            np.testing.assert_allclose(value, oracle(p, q), rtol=1e-6, atol=tolerance, err_msg=what)

    @pytest.mark.parametrize("bit", range(3))
    @pytest.mark.parametrize(
        # "qr" loses digits as |x| grows, where it means least; "qr-both" does not.
        ("kind", "oracle", "tolerance"),
        [(QR, oracles.qr, 1e-9), (QRBoth, oracles.qr_both, 1e-13), (SVD, oracles.svd, 1e-13)],
    )
    def test_up2p(self, kind: type, oracle: object, tolerance: float, bit: int) -> None:
        a, b, c = UPRIGHT_ORDERS[bit]
        for what, instance, target in UP2P_CASES:
            rays = oracles.bearings(target, instance.intrinsics)
            verticals = instance.vertical_camera, instance.vertical_world
            made = oracles.up2p_polynomials(instance.source, [(a, b), (a, c)], *verticals)
            p, q = (f(rays) for f in made)
            value = residual(instance, target, kind(1 << bit))
            np.testing.assert_allclose(value, oracle(p, q), rtol=1e-9, atol=tolerance, err_msg=what)

    def test_where_closed_form_and_factorisation_part(self) -> None:
        """Roots of P3P crowd about x = 1, where a resultant of coefficients in x cancels: 1e-11 off, at worst 2e-8.

        The kernel takes them in x − 1 and keeps its digits, so that it parts from the factorisation only where that
        rounds, against values of 2e-8 in the median of wrong hyper-edges of the paper's scenes.
        """
        rng = np.random.default_rng(15)
        errors, values = [], []
        for _ in range(60):
            instance = instances.paper_scene("p3p", rng, 6)
            target = instance.target + SIGMA * rng.normal(size=(6, 2))
            tables = problem_of(instance._replace(source=instance.source[:4])).prepare(instance.source, target)
            rays = oracles.bearings(target, instance.intrinsics)
            for _ in range(8):
                i, j = rng.permutation(6)[:4], rng.permutation(6)[:4]
                p, q = (f(rays[j]) for f in oracles.p3p_polynomials(instance.source[i], (0, 1)))
                values.append(oracles.qr(p, q))
                errors.append(abs(cpu.residuals(tables, QR(), i[None], j[None])[0] - values[-1]))
        assert 1e-9 < np.median(values) < 1e-6
        assert np.max(errors) < 1e-13

    def test_the_one_sided_residual_blows_up_where_the_common_root_is_large(self) -> None:
        """|R| = sigma_min |y| / |y_last|: beyond |x| = 1 only the lesser over both orders follows sigma_min."""
        rng = np.random.default_rng(6)
        one, both = [], []
        for _ in range(200):
            instance = instances.up2p_angle_pi(rng, 3, 0.02, any_vertical=False)
            target = instance.target + 0.5 * rng.normal(size=(3, 2))
            minimum = residual(instance, target, SVD())
            one.append(residual(instance, target, QR()) / minimum)
            both.append(residual(instance, target, QRBoth()) / minimum)
        assert np.median(one) > 50.0
        assert np.median(both) < 4.0


def isolated(source: np.ndarray, rays: np.ndarray) -> bool:
    """Whether no two roots of the triple's quartic are close, complex pairs among them.

    Such a pair is taken at its real part by the package, because noise makes a double root complex; an oracle that
    knows only real roots differs there on purpose.
    """
    roots = np.roots(oracles.p3p_polynomial(source, rays, oracles.CHART))
    return bool(oracles.p3p_root_gap(source, rays) > 0.1 * max(1.0, np.abs(roots).max()))


class TestUnitsOfTheNoise:
    """ "normalised" and "joint" against derivatives by differences, on any hyper-edge."""

    @pytest.mark.parametrize("bit", range(6))
    def test_p3p_normalised(self, bit: int) -> None:
        compared = 0
        shared = SHARED_PAIRS[bit]
        triple = [*shared, min(k for k in range(4) if k not in shared)]
        for what, instance, target in P3P_CASES:
            rays = oracles.bearings(target, instance.intrinsics)
            if isolated(instance.source[triple], rays[triple]):
                sigma = oracles.solid_angle_sigma(target, instance.intrinsics, SIGMA)
                expected = min(oracles.p3p_normalised(instance.source, rays, sigma, shared), 1e6)
                value = residual(instance, target, Normalised(1 << bit))
                np.testing.assert_allclose(value, expected, rtol=1e-4, atol=1e-7, err_msg=what)
                compared += 1
        assert compared > 0.5 * len(P3P_CASES)

    def test_p3p_joint(self) -> None:
        compared = 0
        for what, instance, target in P3P_CASES:
            rays = oracles.bearings(target, instance.intrinsics)
            if isolated(instance.source[:3], rays[:3]):
                # a hundredth of the noise: no prediction is too vague to count
                sigma = oracles.solid_angle_sigma(target, instance.intrinsics, 0.01 * SIGMA)
                expected = min(oracles.p3p_joint(instance.source, rays, sigma), 1e6)
                value = residual(instance, target, Joint(), 0.01 * SIGMA)
                np.testing.assert_allclose(value, expected, rtol=1e-4, atol=1e-6, err_msg=what)
                compared += 1
        assert compared > 0.5 * len(P3P_CASES)

    @pytest.mark.parametrize("tilt", [0.0, 0.01])
    @pytest.mark.parametrize("bit", range(3))
    def test_up2p(self, bit: int, tilt: float) -> None:
        order = UPRIGHT_ORDERS[bit]
        for what, instance, target in UP2P_CASES:
            rays = oracles.bearings(target, instance.intrinsics)
            sigma = oracles.solid_angle_sigma(target, instance.intrinsics, SIGMA)
            upright = oracles.Upright(instance.source, rays, instance.vertical_camera, instance.vertical_world)
            value = residual(instance, target, Normalised(1 << bit), tilt=tilt)
            expected = upright.normalised(order, sigma, tilt)
            np.testing.assert_allclose(value, min(expected, 1e6), rtol=1e-6, atol=1e-8, err_msg=what)
            value = residual(instance, target, Joint(1 << bit), tilt=tilt)
            expected = upright.joint(order, sigma, tilt)
            np.testing.assert_allclose(value, min(expected, 1e6), rtol=1e-6, atol=1e-8, err_msg=what)


@pytest.mark.parametrize("problem", ["p3p", "up2p"])
class TestAgainstBruteForce:
    """At 0.01 px the first order is all there is: the package's approximations against the pixels themselves.

    What remains is the isotropic noise of a ray against the round noise of a pixel: about 1 % within the paper's field
    of view. One up2p hyper-edge in fifty lies near a double root of its first pair, where first order fails.
    """

    sigma = 0.01

    def made(self, problem: str) -> list[tuple[Instance, np.ndarray]]:
        rng = np.random.default_rng(7)
        count = 4 if problem == "p3p" else 3
        chosen = [instances.paper_scene(problem, rng, count) for _ in range(150)]
        return [(k, k.target + self.sigma * rng.normal(size=k.target.shape)) for k in chosen]

    def test_joint_is_the_least_reprojection_error_over_all_poses(self, problem: str) -> None:
        errors = []
        for k, target in self.made(problem):
            axis = None if problem == "p3p" else k.vertical_world
            chi2 = oracles.reprojection_chi2(
                k.source, target, k.intrinsics, k.rotation, k.translation, self.sigma, axis
            )
            errors.append(abs(residual(k, target, Joint(), self.sigma) ** 2 - chi2) / max(chi2, 0.1))
        assert np.quantile(errors, 0.5) < 0.01
        assert np.quantile(errors, 0.95) < 0.05

    def test_normalised_is_the_resultant_over_its_deviation_in_pixels(self, problem: str) -> None:
        errors = []
        for k, target in self.made(problem):
            if problem == "p3p":
                p, q = oracles.p3p_polynomials(k.source, (0, 1), oracles.CHART)
            else:
                verticals = k.vertical_camera, k.vertical_world
                p, q = oracles.up2p_polynomials(k.source, [(0, 1), (0, 2)], *verticals)
            expected = oracles.normalised_by_pixels(p, q, target, k.intrinsics, self.sigma)
            errors.append(abs(residual(k, target, Normalised(), self.sigma) - expected) / max(expected, 0.1))
        assert np.quantile(errors, 0.5) < 0.01
        assert np.quantile(errors, 0.95) < 0.05

    def test_joint_hardly_depends_on_the_order_of_the_correspondences(self, problem: str) -> None:
        spreads = []
        for k, target in self.made(problem)[:60]:
            tables = problem_of(k).prepare(k.source, target, self.sigma)
            orders = np.array(list(itertools.permutations(range(len(target)))))
            values = cpu.residuals(tables, Joint(), orders, orders)
            spreads.append((np.quantile(values, 0.8) - np.quantile(values, 0.2)) / max(np.median(values), 0.3))
        assert np.quantile(spreads, 0.9) < 0.03


@pytest.mark.parametrize("kind", [QR, QRBoth, SVD, Normalised, Joint])
@pytest.mark.parametrize("problem", ["p3p", "up2p"])
class TestInvariance:
    """What must not matter does not."""

    def made(self, problem: str) -> list[tuple[Instance, np.ndarray]]:
        return [(k, target) for what, k, target in (P3P_CASES if problem == "p3p" else UP2P_CASES) if what == "noisy"]

    def test_unit_and_origin_of_the_source(self, problem: str, kind: type) -> None:
        for k, target in self.made(problem):
            value = residual(k, target, kind())
            for unit in (1e-3, 1e4):
                moved = k._replace(source=unit * (k.source + np.array([3.0, -2.0, 5.0])))
                np.testing.assert_allclose(residual(moved, target, kind()), value, rtol=1e-5, atol=1e-9)

    def test_frame_of_the_source(self, problem: str, kind: type) -> None:
        """Any turn for P3P; for up2p a turn of points and vertical, which may shift the angle's zero: not "qr"."""
        if problem == "up2p" and kind in (QR, QRBoth, SVD):
            pytest.skip("the size of a resultant depends on where the angle is counted from")
        rng = np.random.default_rng(8)
        for k, target in self.made(problem):
            turn = instances.random_rotation(rng)
            turned = k._replace(source=k.source @ turn.T, vertical_world=turn @ k.vertical_world)
            np.testing.assert_allclose(
                residual(turned, target, kind()), residual(k, target, kind()), rtol=1e-5, atol=1e-9
            )

    def test_several_pairs_give_the_greatest(self, problem: str, kind: type) -> None:
        if kind is Joint:
            pytest.skip("joint has all constraints already")
        for k, target in self.made(problem)[:10]:
            single = [residual(k, target, kind(1 << bit)) for bit in range(6 if problem == "p3p" else 3)]
            for mask in (0b11, 0b101, 0b111):
                chosen = [value for bit, value in enumerate(single) if mask >> bit & 1]
                assert residual(k, target, kind(mask)) == max(chosen)


def test_noise_scales_residuals_in_its_units_and_no_others() -> None:
    for _, instance, target in (c for c in P3P_CASES + UP2P_CASES if c[0] == "noisy"):
        for kind in (Normalised, Joint):
            one, three = (residual(instance, target, kind(), sigma) for sigma in (0.01, 0.03))
            assert one == pytest.approx(3.0 * three, rel=1e-6) or one == pytest.approx(1e6)
        for kind in (QR, QRBoth, SVD):
            assert residual(instance, target, kind(), 0.01) == residual(instance, target, kind(), 3.0)


def test_noise_of_each_target_counts_for_itself() -> None:
    """Half of the noise on all pixels but one, ten times on that one: as the oracle has it."""
    sigma_px = np.array([0.05, 0.5, 0.05, 0.05])
    compared = 0
    for _, instance, target in (c for c in P3P_CASES if c[0] == "noisy"):
        rays = oracles.bearings(target, instance.intrinsics)
        if isolated(instance.source[:3], rays[:3]):
            sigma = sigma_px * oracles.solid_angle_sigma(target, instance.intrinsics, 1.0)
            value = residual(instance, target, Joint(), sigma_px)  # type: ignore[arg-type]
            expected = oracles.p3p_joint(instance.source, rays, sigma)
            if value < LARGE:
                np.testing.assert_allclose(value, expected, rtol=1e-4)
                compared += 1
    assert compared >= 10


class TestDegenerate:
    """No information is not agreement: a large finite residual, never 0 and never NaN."""

    kinds = (QR, QRBoth, SVD, Normalised, Joint)

    def floor(self, kind: type) -> float:
        # The residual of two unit polynomials is at most about sqrt 2, and that of random ones is about 0.3.
        return LARGE if kind in (Normalised, Joint) else 1.4

    @pytest.mark.parametrize("kind", kinds)
    def test_up2p_two_points_on_one_vertical_line_seen_in_its_plane(self, kind: type) -> None:
        """Their quadratic is zero in all coefficients; whatever the third point is, it says nothing."""
        rng = np.random.default_rng(9)
        camera = Camera(1000.0, 1000.0, 320.0, 240.0)
        for third in range(20):
            source = np.array([[0.3, -1.0, 2.0], [0.3, 1.5, 2.0], rng.uniform(-1.0, 1.0, 3)])
            target = np.array([[320.0, 100.0], [320.0, 300.0], rng.uniform(50.0, 400.0, 2)])
            assert np.all(UP2P(camera, (0, 1, 0), (0, 1, 0)).coefficients(source[None, :2], target[None, :2]) == 0.0)
            index = np.arange(3)[None]
            value = cpu.residuals(
                UP2P(camera, (0, 1, 0), (0, 1, 0)).prepare(source, target, 1.0), kind(), index, index
            )[0]
            assert np.isfinite(value), third
            assert value >= self.floor(kind), third

    @pytest.mark.parametrize("kind", kinds)
    @pytest.mark.parametrize("pairs", [1, 2, 4, 7])
    def test_up2p_three_points_on_one_vertical_line(self, kind: type, pairs: int) -> None:
        camera = Camera(1000.0, 1000.0, 320.0, 240.0)
        source = np.array([[0.3, -1.0, 2.0], [0.3, 1.5, 2.0], [0.3, 0.2, 2.0], [1.0, 1.0, 1.0]])
        target = np.array([[320.0, 100.0], [320.0, 300.0], [320.0, 350.0], [10.0, 20.0]])
        tables = UP2P(camera, (0, 1, 0), (0, 1, 0)).prepare(source, target, 1.0)
        index = np.arange(3)[None]
        value = cpu.residuals(tables, kind(pairs), index, index)[0]
        assert np.isfinite(value)
        assert value >= self.floor(kind)

    @pytest.mark.parametrize("kind", kinds)
    def test_p3p_repeated_bearings(self, kind: type) -> None:
        """Two image points in one place: where they are seen by chance only."""
        rng = np.random.default_rng(10)
        values = []
        for _ in range(30):
            instance = instances.p3p_generic(rng, 4)
            for first, second in itertools.combinations(range(4), 2):
                target = instance.target.copy()
                target[second] = target[first]
                # prepare() refuses repeated points, so the tables are those of a shift far below rounding of the image
                target[second, 0] = np.nextafter(target[second, 0], np.inf)
                value = residual(instance, target, kind())
                assert np.isfinite(value)
                assert value > 0.0
                values.append(value)
        if kind in (Normalised, Joint):
            # one constraint is met by chance more often than two
            assert np.mean(np.array(values) > 4.0) > (0.95 if kind is Joint else 0.8)

    @pytest.mark.parametrize("kind", kinds)
    @pytest.mark.parametrize("maker", [*instances.P3P_DEGENERATE, instances.p3p_wide])
    def test_p3p_near_degenerate_is_finite(self, kind: type, maker: object) -> None:
        rng = np.random.default_rng(11)
        for strength in (*instances.STRENGTHS, 1e-9, 1e-12):
            instance = maker(rng, 4, strength)
            for target in (instance.target, instance.target + 0.5 * rng.normal(size=(4, 2))):
                for bit in range(6):
                    value = residual(instance, target, kind(1 << bit))
                    assert np.isfinite(value)
                    assert value >= 0.0

    @pytest.mark.parametrize("kind", [Normalised, Joint])
    def test_p3p_collinear_triples_of_a_grid(self, kind: type) -> None:
        """A model with exactly collinear triples: their hyper-edges may be lost, but wrong ones do not agree."""
        rng = np.random.default_rng(14)
        grid = np.stack(np.meshgrid(np.arange(3.0), np.arange(3.0), [0.0]), axis=-1).reshape(-1, 3)
        edges = np.array([i for i in itertools.permutations(range(9), 4) if _collinear(grid[list(i)])])
        for _ in range(5):
            camera = instances.paper_scene("p3p", rng, 4)
            pixels = instances.project(grid @ camera.rotation.T + camera.translation, camera.intrinsics)
            tables = P3P(Camera(*camera.intrinsics)).prepare(grid, pixels, 0.1)
            right = cpu.residuals(tables, kind(0b111111 if kind is Normalised else 1), edges, edges)
            wrong = cpu.residuals(tables, kind(0b111111 if kind is Normalised else 1), edges, np.roll(edges, 1, axis=1))
            assert np.all(np.isfinite(right))
            assert np.all(right >= 0.0)
            assert np.all(np.isfinite(wrong))
            assert np.mean(wrong > 4.0) > 0.9

    @pytest.mark.parametrize("kind", kinds)
    @pytest.mark.parametrize("maker", instances.UP2P_DEGENERATE)
    def test_up2p_near_degenerate_is_finite(self, kind: type, maker: object) -> None:
        rng = np.random.default_rng(12)
        for strength in (*instances.STRENGTHS, 1e-9, 1e-12, 0.0):
            for any_vertical in (False, True):
                instance = maker(rng, 3, strength, any_vertical)
                for target in (instance.target, instance.target + 0.5 * rng.normal(size=(3, 2))):
                    for bit in range(3):
                        value = residual(instance, target, kind(1 << bit))
                        assert np.isfinite(value)
                        assert value >= 0.0

    def test_a_point_behind_the_camera_does_not_agree(self) -> None:
        """The mirrored ray of a true point solves the same polynomials: only depths tell."""
        rng = np.random.default_rng(13)
        behind = 0
        for _ in range(50):
            instance = instances.paper_scene("p3p", rng, 4)
            # the pose turned half about: every point behind the centre, the same lines through it
            points = -instance.camera_points
            pixels = instances.project(points, instance.intrinsics)
            np.testing.assert_allclose(pixels, instance.target, atol=1e-9)
            # seen by a camera that looks the other way, the object is its mirror image: no solution in front fits
            mirrored = instance._replace(source=instance.source * (-1.0, 1.0, 1.0))
            behind += residual(mirrored, instance.target, Joint(), 0.01) > 4.0
        assert behind >= 45


def _collinear(points: np.ndarray) -> bool:
    """Whether three of four points lie on a line."""
    return any(
        np.linalg.norm(np.cross(points[b] - points[a], points[c] - points[a])) == 0.0
        for a, b, c in itertools.combinations(range(4), 3)
    )


class TestNormals:
    """A point is seen only from its front; a side that is unknown or right changes nothing."""

    @pytest.mark.parametrize("points", [3, 4])
    def test_a_point_seen_from_behind_rules_its_hyperedges_out(self, points: int) -> None:
        rng = np.random.default_rng(16)
        index = np.arange(points)[None]
        for _ in range(20):
            instance = instances.up2p_generic(rng, 3) if points == 3 else instances.paper_scene("p3p", rng, 4)
            centre = -instance.rotation.T @ instance.translation
            normals = centre - instance.source + 0.3 * rng.normal(size=(points, 3))
            target = instance.target + 0.1 * rng.normal(size=(points, 2))

            def joint(facing: np.ndarray | None) -> float:
                tables = problem_of(instance).prepare(instance.source, target, 0.1, facing)  # noqa: B023
                return float(cpu.residuals(tables, Joint(), index, index)[0])

            plain = joint(None)
            if plain > 3.0:  # next to a double root
                continue
            np.testing.assert_allclose(joint(normals), plain, rtol=1e-9)
            np.testing.assert_allclose(joint(1e-3 * normals), plain, rtol=1e-9)
            for k in range(points):
                turned, unknown = normals.copy(), normals.copy()
                turned[k] *= -1.0
                unknown[k] = 0.0
                # another solution of the minimal set may fit by chance, but not as well
                assert joint(turned) > 3.0
                np.testing.assert_allclose(joint(unknown), plain, rtol=1e-9)


class TestPublicFunction:
    """``rootmatch.residuals``: what the kernels say, and one clear error for what cannot be used."""

    rng = np.random.default_rng(17)
    instance = instances.paper_scene("p3p", rng, 8)
    problem = P3P(Camera(*instance.intrinsics))
    source_index = np.array([[0, 1, 2, 3], [4, 5, 6, 7], [3, 1, 0, 7]])
    target_index = np.array([[0, 1, 2, 3], [4, 5, 6, 7], [1, 3, 7, 0]])

    def call(self, **change: object) -> np.ndarray:
        arguments = {"source_index": self.source_index, "target_index": self.target_index} | change
        source, target = self.instance.source, self.instance.target
        return rootmatch.residuals(source, target, self.problem, **arguments)  # type: ignore[arg-type]

    @pytest.mark.parametrize(
        ("name", "oracle"), [("qr", oracles.qr), ("qr-both", oracles.qr_both), ("svd", oracles.svd)]
    )
    def test_kinds_of_the_paper_by_name(self, name: str, oracle: Callable[..., float]) -> None:
        """Against the factorisation of the Sylvester matrix of both quartics, each hyper-edge by itself."""
        found = self.call(kind=name)
        rays = oracles.bearings(self.instance.target, self.instance.intrinsics)
        for e, (i, k) in enumerate(zip(self.source_index, self.target_index, strict=True)):
            p, q = (f(rays[k]) for f in oracles.p3p_polynomials(self.instance.source[i], (0, 1)))
            assert found[e] == pytest.approx(oracle(p, q), rel=1e-6, abs=1e-12)
        assert max(found[:2]) < 1e-9 < 10.0 * found[2]

    @pytest.mark.parametrize(("name", "kind"), [("normalised", Normalised), ("joint", Joint)])
    def test_kinds_in_units_of_the_noise_by_name(self, name: str, kind: type) -> None:
        found, wider = self.call(kind=name, noise=0.3), self.call(kind=name, noise=0.6)
        assert max(found[:2]) < 1e-6 < found[2]
        assert found[2] == pytest.approx(2.0 * wider[2], rel=1e-6)
        tables = self.problem.prepare(self.instance.source, self.instance.target, 0.3)
        np.testing.assert_array_equal(found, cpu.residuals(tables, kind(), self.source_index, self.target_index))

    def test_joint_and_one_pixel_are_the_defaults(self) -> None:
        np.testing.assert_array_equal(self.call(), self.call(kind="joint", noise=1.0))

    def test_pairs_by_object(self) -> None:
        several = self.call(kind=rootmatch.Residual("svd", pairs=(0, 3)))
        each = [self.call(kind=rootmatch.Residual("svd", pairs=(bit,))) for bit in (0, 3)]
        np.testing.assert_array_equal(several, np.maximum(*each))

    def test_no_hyperedges_give_no_residuals(self) -> None:
        none = np.empty((0, 4), dtype=int)
        assert self.call(source_index=none, target_index=none).shape == (0,)

    @pytest.mark.parametrize(
        "change",
        [
            {"source_index": [[0, 1, 2]]},
            {"source_index": [0, 1, 2, 3]},
            {"source_index": source_index[:2]},
            {"source_index": source_index + 1},
            {"target_index": target_index - 1},
            {"target_index": target_index.astype(float) + 0.5},
            {"source_index": [[0, 1, 2, 2]] * 3},
            {"target_index": [[5, 5, 2, 3]] * 3},
            {"kind": "determinant"},
            {"noise": -1.0},
            {"noise": np.nan},
        ],
    )
    def test_refuses(self, change: dict[str, object]) -> None:
        with pytest.raises(rootmatch.InputError):
            self.call(**change)

    def test_refuses_a_pair_that_the_problem_has_not(self) -> None:
        upright = UP2P(Camera(*self.instance.intrinsics), (0, 1, 0), (0, 1, 0))
        with pytest.raises(rootmatch.InputError, match="pair"):
            rootmatch.residuals(
                self.instance.source,
                self.instance.target,
                upright,
                self.source_index[:, :3],
                self.target_index[:, :3],
                rootmatch.Residual("svd", pairs=(3,)),
            )


def test_true_hyperedges_have_small_residuals_and_wrong_ones_have_not() -> None:
    """A floor under all of the above: the residual tells true from wrong."""
    for made in (P3P_CASES, UP2P_CASES):
        for kind in (Normalised, Joint):
            values = {what: [] for what in ("true", "noisy", "wrong")}
            for what, instance, target in made:
                values[what].append(residual(instance, target, kind()))
            assert np.median(values["true"]) < 1e-6
            assert 0.3 < np.median(values["noisy"]) < 2.0
            assert np.median(values["wrong"]) > 20.0
    assert math.isfinite(np.max(values["wrong"]))
