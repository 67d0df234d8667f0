"""The quadratic of two points under a known vertical against two independent libraries, an oracle and its symmetries.

An angle has no privileged zero, so a root is judged by |q(x)| / (|q| |(x^2, x, 1)|): the homogeneous value, the same
near x = 0, x = 1 and x = infinity. Two points within 1e-6 of one vertical line determine the angle no better than the
rounding of their coordinates (about 1e-15 of a point's distance) over that strength; there, and only there, the bound
grows.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest

import instances
import oracles
from instances import Instance
from libraries import UP2P_SOLVERS, polished_turn, ray_error
from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import InputError
from rootmatch.problems.up2p.problem import UP2P

INSTANCES = instances.up2p_instances(generic=400)


def bound(instance: Instance) -> float:
    if instance.family == "vertical line" and instance.strength < 1e-5:
        return 1e-13 / instance.strength
    return 1e-9


def quadratic(instance: Instance) -> np.ndarray:
    problem = UP2P(Camera(*instance.intrinsics), instance.vertical_camera, instance.vertical_world)
    return problem.coefficients(instance.source[None, :2], instance.target[None, :2])[0]


def homogeneous_value(q: np.ndarray, angle: float) -> float:
    c, s = math.cos(angle / 2.0), math.sin(angle / 2.0)
    powers = np.array([s * s, s * c, c * c])
    return float(abs(q @ powers) / (np.linalg.norm(q) * np.linalg.norm(powers)))


def angle_of(instance: Instance, rotation: np.ndarray) -> float:
    return oracles.up2p_angle(rotation, instance.vertical_camera, instance.vertical_world)


@pytest.fixture(scope="module")
def quadratics() -> list[np.ndarray]:
    return [quadratic(instance) for instance in INSTANCES]


def test_at_least_500_instances_are_held_to_the_plain_bound() -> None:
    assert sum(bound(instance) == 1e-9 for instance in INSTANCES) >= 600
    families = Counter((instance.family, instance.strength) for instance in INSTANCES)
    for family in ("vertical line", "same height", "angle 0", "angle pi"):
        assert all(families[family, strength] >= 10 for strength in instances.STRENGTHS)
    tilted = sum(abs(k.vertical_camera[1]) < 0.9 and abs(k.vertical_world[1]) < 0.9 for k in INSTANCES)
    assert tilted >= 250


def test_the_truth_is_a_root(quadratics: list[np.ndarray]) -> None:
    for instance, q in zip(INSTANCES, quadratics, strict=True):
        assert homogeneous_value(q, angle_of(instance, instance.rotation)) <= bound(instance), instance


def test_the_truth_is_a_root_term_by_term(quadratics: list[np.ndarray]) -> None:
    """|q(x)| / sum |c_k x^k| as well, where x is neither near 0 nor near infinity."""
    checked = 0
    for instance, q in zip(INSTANCES, quadratics, strict=True):
        x = math.tan(angle_of(instance, instance.rotation) / 2.0)
        if 1e-3 < abs(x) < 1e3:
            assert oracles.relative_value(q, x) <= bound(instance), instance
            checked += 1
    assert checked >= 500


@pytest.mark.parametrize("library", UP2P_SOLVERS)
def test_every_solution_of_the_library_is_a_root(library: str, quadratics: list[np.ndarray]) -> None:
    """Near a vertical line a small reprojection error says little of the angle, so these are polished, each of them."""
    counts: Counter[str] = Counter()
    answered = 0
    for instance, q in zip(INSTANCES, quadratics, strict=True):
        found = 0
        for rotation, translation in UP2P_SOLVERS[library](instance):
            np.testing.assert_allclose(rotation @ instance.vertical_world, instance.vertical_camera, atol=1e-9)
            if ray_error(instance, rotation, translation) > 1e-7:
                counts["spurious"] += 1
                continue
            if instance.family == "vertical line":
                polished = polished_turn(instance, rotation, translation)
                counts["spurious" if polished is None else "polished"] += 1
                if polished is None:
                    continue
                rotation = polished
            value = homogeneous_value(q, angle_of(instance, rotation))
            assert value <= bound(instance), (instance.family, instance.strength, value)
            found += 1
        counts["solutions"] += found
        answered += found > 0
    assert answered >= 620, (answered, counts)
    assert counts["spurious"] <= 0.04 * counts["solutions"], counts
    assert counts["polished"] <= 120, counts


def test_another_angle_is_no_root() -> None:
    generic = [k for k in INSTANCES if k.family == "generic"]
    values = [homogeneous_value(quadratic(k), angle_of(k, k.rotation) + 1e-3) for k in generic]
    assert np.quantile(values, 0.02) > 1e-6
    assert np.min(values) > 1e-9


def test_coefficients_are_those_of_the_interpolated_equation(quadratics: list[np.ndarray]) -> None:
    for instance, q in zip(INSTANCES, quadratics, strict=True):
        expected = oracles.up2p_polynomial(
            instance.source,
            oracles.bearings(instance.target, instance.intrinsics),
            instance.vertical_camera,
            instance.vertical_world,
        )
        q, expected = q / np.linalg.norm(q), expected / np.linalg.norm(expected)
        np.testing.assert_allclose(q * np.sign(q @ expected), expected, atol=bound(instance))


def test_exchanging_the_points_keeps_the_quadratic() -> None:
    for instance in INSTANCES[:50]:
        q = quadratic(instance)
        other = quadratic(instance._replace(source=instance.source[::-1], target=instance.target[::-1]))
        np.testing.assert_allclose(other * np.sign(q @ other), q, atol=1e-12 * np.linalg.norm(q))


def test_the_length_of_a_vertical_does_not_matter() -> None:
    for instance in INSTANCES[:20]:
        stretched = instance._replace(
            vertical_camera=7.0 * instance.vertical_camera, vertical_world=0.01 * instance.vertical_world
        )
        q = quadratic(instance)
        np.testing.assert_allclose(quadratic(stretched), q, atol=1e-12 * np.linalg.norm(q))


def test_up_in_both_frames_is_as_good_as_down() -> None:
    """Turning both verticals about: the same truth, at the angle that the other convention gives."""
    for instance in INSTANCES[:50]:
        if abs(instance.vertical_camera[1]) > 0.999999:
            continue
        up = instance._replace(vertical_camera=-instance.vertical_camera, vertical_world=-instance.vertical_world)
        assert homogeneous_value(quadratic(up), angle_of(up, up.rotation)) <= 1e-9


@pytest.mark.parametrize("tilt", [0.0, 1e-8, 1e-6, 2e-6, 1e-4])
@pytest.mark.parametrize("side", ["camera", "world", "both"])
def test_a_vertical_that_points_up_along_y(tilt: float, side: str) -> None:
    """Near -y the smallest turn onto y is ill-defined. Whichever is taken, all pairs of points must share a root."""
    rng = np.random.default_rng(5)
    y = np.array([0.0, 1.0, 0.0])
    for _ in range(10):
        up = np.array([tilt * rng.normal(), -1.0, tilt * rng.normal()])
        up /= np.linalg.norm(up)
        verticals = (y if side == "world" else up, y if side == "camera" else up)
        base = instances.up2p_generic(rng, 3, any_vertical=False)
        # re-label camera and world frames so that the same down is called by these names
        turns = [instances.axis_rotation(y, rng.uniform(0.0, 6.0)) for _ in verticals]
        turns = [_onto(y, v) @ turn for v, turn in zip(verticals, turns, strict=True)]
        rays = base.camera_points @ turns[0].T
        if rays[:, 2].min() < 0.1:  # the half turn about x looks backwards: look forward again by half a turn about up
            rays = rays @ instances.axis_rotation(verticals[0], math.pi).T
        if rays[:, 2].min() < 0.1:
            continue
        pixels = instances.project(rays, base.intrinsics)
        problem = UP2P(Camera(*base.intrinsics), *verticals)
        source = base.source @ turns[1].T
        pairs = [[0, 1], [0, 2], [1, 2]]
        first, second, third = problem.coefficients(source[pairs], pixels[pairs])
        assert max(oracles.svd(first, second), oracles.svd(first, third), oracles.svd(second, third)) < 1e-10
        source[2] += 0.5
        first, second, third = problem.coefficients(source[pairs], pixels[pairs])
        assert oracles.svd(first, second) > 1e-6


def _onto(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """A rotation that takes one unit vector to the other, antiparallel ones too, by way of the x axis."""
    x = np.array([1.0, 0.0, 0.0])
    return instances.shortest_arc(x, end) @ instances.shortest_arc(start, x)


class TestRefuses:
    """Each message says what is wrong."""

    camera = Camera(1000.0, 1000.0, 320.0, 240.0)
    source = np.random.default_rng(0).uniform(-1.0, 1.0, (6, 3))
    target = np.random.default_rng(1).uniform(0.0, 400.0, (7, 2))

    def test_good_input_is_taken(self) -> None:
        """What is changed below is good as it stands: its tables hold the geometry and the noise that were given."""
        tables = UP2P(self.camera, (0, 1, 0), (0, 1, 0)).prepare(self.source, self.target, noise=0.5)
        rays = np.column_stack([(self.target - (320.0, 240.0)) / 1000.0, np.ones(7)])
        np.testing.assert_allclose(tables.rays, (rays / np.linalg.norm(rays, axis=1, keepdims=True)).T, atol=1e-14)
        d2 = ((self.source[:, None] - self.source[None]) ** 2).sum(axis=2)
        moved = ((tables.points.T[:, None] - tables.points.T[None]) ** 2).sum(axis=2)
        np.testing.assert_allclose(moved / moved[0, 1], d2 / d2[0, 1], atol=1e-12)
        double = UP2P(self.camera, (0, 1, 0), (0, 1, 0)).prepare(self.source, self.target, noise=1.0)
        np.testing.assert_allclose(double.variance, 4.0 * tables.variance, rtol=1e-12)

    @pytest.mark.parametrize("vertical", [(0.0, 0.0, 0.0), (0.0, 1.0), (np.nan, 1.0, 0.0), (0.0, np.inf, 0.0), "down"])
    @pytest.mark.parametrize("name", ["vertical_camera", "vertical_world"])
    def test_bad_vertical(self, name: str, vertical: object) -> None:
        given = {"vertical_camera": (0, 1, 0), "vertical_world": (0, 1, 0), name: vertical}
        with pytest.raises(InputError, match=name):
            UP2P(self.camera, **given)  # type: ignore[arg-type]

    @pytest.mark.parametrize("name", ["vertical_camera", "vertical_world"])
    def test_no_vertical_is_assumed(self, name: str) -> None:
        given = {"vertical_camera": (0, 1, 0), "vertical_world": (0, 1, 0)}
        del given[name]
        with pytest.raises(InputError, match=rf"^{name}: none given; up2p needs one direction"):
            UP2P(self.camera, **given)

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            ({"source": source[:2]}, "at least 3"),
            ({"target": target[:2]}, "at least 3"),
            ({"source": source[:, :2]}, "shape"),
            ({"source": np.where(np.arange(18).reshape(6, 3) == 7, np.nan, source)}, "point 2"),
            ({"source": np.outer(np.arange(6.0), (0.0, 2.0, 0.0)) + 5.0}, "vertical line"),
            ({"noise": -1.0}, "noise"),
        ],
    )
    def test_bad_input(self, change: dict[str, object], text: str) -> None:
        arguments: dict[str, object] = {"source": self.source, "target": self.target, "noise": 1.0} | change
        with pytest.raises(InputError, match=text):
            UP2P(self.camera, (0, 1, 0), (0, 1, 0)).prepare(**arguments)  # type: ignore[arg-type]
