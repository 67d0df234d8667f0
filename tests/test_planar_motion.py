"""Planar motion against the plain epipolar equations, brute force over the motion, and scenes of a robot."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2

import oracles
import robot_scenes
from instances import axis_rotation
from plain_kernels import interpreted_kernels
from robot_scenes import DOWN, INTRINSICS
from rootmatch import match
from rootmatch.cameras.pinhole import Camera
from rootmatch.derivation.shipped import planar_motion
from rootmatch.errors import InputError
from rootmatch.problems.planar_motion import PlanarMotion
from rootmatch.problems.residual_kinds import QR, SVD, Joint, Normalised, QRBoth

CAMERA = Camera(*INTRINSICS)


@cache
def interpreted(kind: type) -> Callable:
    """The kernel of a residual as plain Python, which need not be compiled; `test_match` runs the compiled ones."""
    derived = PlanarMotion(CAMERA, axis=(0, 1, 0)).derived
    return interpreted_kernels(derived)[kind].edge


def problem_of(scene: robot_scenes.Scene) -> PlanarMotion:
    return PlanarMotion(CAMERA, axis=scene.vertical, axis2=scene.vertical)


def epipolar_determinant(first: np.ndarray, second: np.ndarray, angle: float) -> float:
    """Of two correspondences of rays: zero where some motion (tx, 0, tz) explains both at that turn."""
    rows = [np.cross(axis_rotation(DOWN, angle) @ p, q)[[0, 2]] for p, q in zip(first, second, strict=True)]
    return float(np.linalg.det(rows))


def test_quadratic_is_the_epipolar_determinant() -> None:
    """At ten angles, up to one factor: (1 + x²) comes from the determinant's x = tan(θ/2), another was taken off."""
    angles = np.linspace(-1.2, 1.3, 10)
    for seed in range(20):
        scene = robot_scenes.robot(4, noise=2.0, seed=seed)
        pixels = scene.source[:2], scene.target[scene.truth[:2]]
        found = PlanarMotion(CAMERA, axis=(0, 1, 0)).coefficients(pixels[0][None], pixels[1][None])[0]
        rays = [oracles.bearings(p, INTRINSICS) for p in pixels]
        expected = np.array([epipolar_determinant(*rays, a) / math.cos(a / 2.0) ** 2 for a in angles])
        # det · (1 + x²) is the quadratic: 1 / cos² = 1 + x²
        values = np.polyval(found, np.tan(angles / 2.0))
        ratio = values[0] / expected[0]
        np.testing.assert_allclose(values, ratio * expected, rtol=1e-9, atol=1e-12 * np.abs(values).max())


@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_the_truth_is_a_root(tilt: float) -> None:
    for seed in range(50):
        scene = robot_scenes.robot(2, seed=seed, tilt=tilt)
        found = problem_of(scene).coefficients(scene.source[None], scene.target[None, scene.truth])[0]
        turn = scene.angle
        assert oracles.relative_value(found, math.tan(turn / 2.0)) < 1e-9


def test_shipped_formulas_are_those_of_the_equation() -> None:
    fresh = planar_motion(CAMERA)
    scene = robot_scenes.robot(8, noise=1.0, seed=1)
    rng = np.random.default_rng(0)
    sets = np.array([rng.permutation(8)[:2] for _ in range(50)])
    args = scene.source[sets], scene.target[sets]
    np.testing.assert_allclose(
        fresh.coefficients(*args), PlanarMotion(CAMERA, axis=(0, 1, 0)).coefficients(*args), rtol=1e-9
    )
    shipped = PlanarMotion(CAMERA, axis=(0, 1, 0)).derived
    for name in ("minimal", "order", "degree", "constraints", "pair_count", "source_dimension", "target_dimension"):
        assert getattr(shipped, name) == getattr(fresh, name) == getattr(PlanarMotion(CAMERA, axis=(0, 1, 0)), name)


def best_motion_chi2(scene: robot_scenes.Scene, first: np.ndarray, second: np.ndarray, sigma: float) -> float:
    """Least squared reprojection error over σ² of three points in both views, over planar motions near the truth."""

    def residual(v: np.ndarray) -> np.ndarray:
        rotation = axis_rotation(DOWN, v[0])
        move = np.array([np.sin(v[1]), 0.0, np.cos(v[1])])
        points = v[2:].reshape(3, 3)
        fx, fy, cx, cy = INTRINSICS
        views = []
        for xyz, seen in ((points, first), (points @ rotation.T + move, second)):
            pixels = np.stack((fx * xyz[:, 0] / xyz[:, 2] + cx, fy * xyz[:, 1] / xyz[:, 2] + cy), axis=1)
            views.append((pixels - seen) / sigma)
        return np.concatenate(views).ravel()

    heading = math.atan2(scene.translation[0], scene.translation[2])
    start = np.concatenate(([scene.angle, heading], scene.points[:3].ravel() / np.linalg.norm(scene.translation)))
    return 2.0 * float(least_squares(residual, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14).cost)


def test_joint_is_the_reprojection_error_of_the_best_motion() -> None:
    sigma = 0.05
    errors = []
    index = np.arange(3)
    edge = interpreted(Joint)
    for seed in range(30):
        scene = robot_scenes.robot(3, noise=sigma, seed=seed)
        target = scene.target[scene.truth]
        value = edge(PlanarMotion(CAMERA, axis=(0, 1, 0)).prepare(scene.source, target, sigma), Joint(), index, index)
        expected = best_motion_chi2(scene, scene.source, target, sigma)
        errors.append(abs(value**2 - expected) / max(expected, 0.1))
    assert np.quantile(errors, 0.5) < 0.05
    assert np.quantile(errors, 0.8) < 0.2


@pytest.mark.parametrize(("noise", "tolerance"), [(0.02, 0.06), (0.2, 0.12)])
def test_calibration(noise: float, tolerance: float) -> None:
    """χ² with one degree of freedom to first order.

    At 0.2 px first order is left behind, and the better of two roots counts: 60 % lie below the median, of the least
    reprojection errors of such triples (`best_motion_chi2`) 51 %.
    """
    true, wrong = [], []
    edge = interpreted(Joint)
    for seed in range(60):
        scene = robot_scenes.robot(8, noise=noise, seed=seed, tilt=0.2)
        rng = np.random.default_rng(seed)
        source = np.array([rng.permutation(8)[:3] for _ in range(40)])
        other = np.array([rng.permutation(8)[:3] for _ in range(40)])
        tables = problem_of(scene).prepare(scene.source, scene.target, noise)
        true.append([edge(tables, Joint(), i, scene.truth[i]) for i in source])
        wrong.append([edge(tables, Joint(), i, j) for i, j in zip(source, other, strict=True)])
    squares = np.concatenate(true) ** 2
    for share in (0.5, 0.9):
        assert abs(np.mean(squares < chi2.ppf(share, 1)) - share) < tolerance
    assert np.mean(np.concatenate(true) < 3.5) > 0.94
    assert np.mean(np.concatenate(wrong) < 3.5) < 0.05


@pytest.mark.parametrize(("outliers", "noise", "minimum"), [(0, 0.5, 0.97), (5, 0.3, 0.95)])
def test_match(outliers: int, noise: float, minimum: float) -> None:
    accuracy = []
    for seed in range(12):
        scene = robot_scenes.robot(10, outliers, noise, seed, tilt=0.2)
        found = match(scene.source, scene.target, problem_of(scene), noise=noise)
        accuracy.append(np.mean(found.assignment == scene.truth))
    assert np.mean(accuracy) >= minimum


def test_a_robot_among_few_points_and_clutter() -> None:
    """Seven to fourteen points that a robot sees twice: by all hyper-edges' score a third had another assignment."""
    camera, trusted = Camera(600.0, 600.0, 640.0, 480.0), 0
    tilt = axis_rotation(np.array([1.0, 0.0, 0.0]), 0.15)
    for seed in range(12):
        rng = np.random.default_rng([seed, 84])
        points = np.column_stack([rng.uniform(-5, 5, 14), rng.uniform(-1.5, 1.0, 14), rng.uniform(4, 14, 14)])
        bearing, far = rng.uniform(-math.pi, math.pi), rng.uniform(0.5, 2.0)
        images, owners = [], []
        for turn, place in ((0.0, 0.0), (rng.uniform(-0.5, 0.5), far)):
            moved = points - place * np.array([math.sin(bearing), 0.0, math.cos(bearing)])
            pixels = camera.project(moved @ (tilt @ axis_rotation(DOWN, turn)).T)
            shown = np.flatnonzero((np.abs(pixels - (640, 480)) < (640, 480)).all(axis=1) & (rng.random(14) < 0.93))
            clutter = rng.uniform((0, 300), (1280, 700), (2, 2))
            order = rng.permutation(len(shown) + 2)
            images.append((np.vstack([pixels[shown], clutter]) + rng.normal(0.0, 0.4, (len(order), 2)))[order])
            owners.append(np.concatenate([shown, [-1 - len(images), -3 - len(images)]])[order])
        same = owners[0][:, None] == owners[1]
        truth = np.where(same.any(axis=1), same.argmax(axis=1), -1)
        problem = PlanarMotion(camera, axis=tilt @ DOWN)
        found = match(images[0], images[1], problem, noise=0.4)
        matched = found.assignment >= 0
        if found:
            trusted += 1
            assert (found.assignment[matched] == truth[matched]).all()
    assert trusted >= 10


class TestDegenerate:
    """What the class says about configurations that determine nothing."""

    def test_a_turn_alone_says_little(self) -> None:
        """Wrong hyper-edges must not be better than 3.5 more often than chance allows; nothing is NaN."""
        index = np.arange(3)
        values = []
        edge = interpreted(Joint)
        for seed in range(40):
            scene = robot_scenes.robot(3, noise=0.2, seed=seed, step=1e-6)
            target = scene.target[scene.truth]
            for turned in (target, target[[1, 2, 0]]):
                value = edge(
                    PlanarMotion(CAMERA, axis=(0, 1, 0)).prepare(scene.source, turned, 0.2), Joint(), index, index
                )
                assert np.isfinite(value)
                assert value >= 0.0
            values.append(value)
        assert np.mean(np.array(values) > 3.5) > 0.7

    def test_points_on_the_horizon_say_nothing(self) -> None:
        """Their rays lie in the plane of the motion, so every pair's quadratic vanishes altogether."""
        rng = np.random.default_rng(0)
        source = np.column_stack((rng.uniform(100.0, 500.0, 4), np.full(4, INTRINSICS[3])))
        target = np.column_stack((rng.uniform(100.0, 500.0, 4), np.full(4, INTRINSICS[3])))
        assert np.all(PlanarMotion(CAMERA, axis=(0, 1, 0)).coefficients(source[None, :2], target[None, :2]) == 0.0)
        index = np.arange(3)
        tables = PlanarMotion(CAMERA, axis=(0, 1, 0)).prepare(source, target, 0.5)
        for kind in (QR, QRBoth, SVD, Normalised, Joint):
            assert interpreted(kind)(tables, kind(), index, index) >= 1.4

    def test_half_a_turn_is_only_far_out(self) -> None:
        """θ near π: the root is near infinity, where reversed coefficients find it."""
        found = 0
        for seed in range(20):
            scene = robot_scenes.robot(3, noise=0.0, seed=seed)
            # count the angle from another zero: turn the second camera's frame about the vertical
            about = axis_rotation(DOWN, math.pi - scene.angle - 1e-3)
            rays = oracles.bearings(scene.target[scene.truth], INTRINSICS) @ about.T
            if rays[:, 2].max() > -0.1:
                continue
            pixels = CAMERA.project(-rays)  # the same lines, seen behind
            value = PlanarMotion(CAMERA, axis=(0, 1, 0)).coefficients(scene.source[None, :2], pixels[None, :2])[0]
            assert oracles.relative_value(value, math.tan((math.pi - 1e-3) / 2.0)) < 1e-9
            found += 1
        assert found >= 5


@pytest.mark.parametrize("change", [{"axis": (0.0, 0.0, 0.0)}, {"axis2": (0.0, 1.0)}, {"axis": (np.nan, 1.0, 0.0)}])
def test_bad_axis(change: dict[str, tuple[float, ...]]) -> None:
    with pytest.raises(InputError, match="axis"):
        PlanarMotion(CAMERA, **{"axis": (0.0, 1.0, 0.0)} | change)


def test_the_second_normal_is_the_first_by_default() -> None:
    assert PlanarMotion(CAMERA, axis=(1, 2, 0)).axis2 == (1.0, 2.0, 0.0)
    with pytest.raises(InputError, match="axis: none given; planar needs a direction"):
        PlanarMotion(CAMERA)


def test_bad_points() -> None:
    scene = robot_scenes.robot(4, seed=0)
    with pytest.raises(InputError, match="at least 3"):
        PlanarMotion(CAMERA, axis=(0, 1, 0)).prepare(scene.source[:2], scene.target)
    with pytest.raises(InputError, match="normals"):
        PlanarMotion(CAMERA, axis=(0, 1, 0)).prepare(scene.source, scene.target, 1.0, np.ones((4, 3)))
