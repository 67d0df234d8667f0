"""The quartic of three points against two independent libraries, an oracle and its own symmetries."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest

import instances
import oracles
from instances import Instance
from libraries import P3P_SOLVERS, polished_depths, ray_depths, ray_error
from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import InputError
from rootmatch.problems.p3p.problem import P3P

INSTANCES = instances.p3p_instances(generic=300)


def quartic(instance: Instance) -> np.ndarray:
    problem = P3P(Camera(*instance.intrinsics))
    return problem.coefficients(instance.source[None, :3], instance.target[None, :3])[0]


@pytest.fixture(scope="module")
def quartics() -> list[np.ndarray]:
    return [quartic(instance) for instance in INSTANCES]


def test_there_are_at_least_500_instances_near_degenerate_ones_among_them() -> None:
    assert len(INSTANCES) >= 500
    families = Counter((instance.family, instance.strength) for instance in INSTANCES)
    for family in ("collinear", "danger cylinder", "equal bearings", "far"):
        assert all(families[family, strength] >= 10 for strength in instances.STRENGTHS)
    assert families["wide", math.inf] >= 50


def test_the_truth_is_a_root(quartics: list[np.ndarray]) -> None:
    for instance, q in zip(INSTANCES, quartics, strict=True):
        x = instance.depths[1] / instance.depths[0]
        assert oracles.relative_value(q, x) <= 1e-9, (instance.family, instance.strength)


@pytest.mark.parametrize("library", P3P_SOLVERS)
def test_every_solution_of_the_library_is_a_root(library: str, quartics: list[np.ndarray]) -> None:
    """A solution is one whose own reprojection error is small; a sloppy one is first polished by Newton's method."""
    counts: Counter[str] = Counter()
    answered = 0
    for instance, q in zip(INSTANCES, quartics, strict=True):
        found = 0
        for rotation, translation in P3P_SOLVERS[library](instance):
            error = ray_error(instance, rotation, translation)
            depths = ray_depths(instance, rotation, translation)
            if error > 1e-10:
                polished = polished_depths(instance, depths) if error < 1e-3 else None
                counts["spurious" if polished is None else "polished"] += 1
                if polished is None:
                    continue
                depths = polished
            value = oracles.relative_value(q, depths[1] / depths[0])
            assert value <= 1e-9, (instance.family, instance.strength, value, error)
            found += 1
        counts["solutions"] += found
        answered += found > 0
    # Unanswered and spurious: triples within 1e-6 of a line and cameras 1e6 object sizes away.
    assert answered >= 540, (answered, counts)
    assert counts["solutions"] >= 1100, counts
    assert counts["polished"] <= 0.1 * counts["solutions"], counts
    assert counts["spurious"] <= 0.1 * counts["solutions"], counts


def test_another_ratio_is_no_root() -> None:
    """The bound 1e-9 tells roots from others: a thousandth off is no root (far cameras crowd all roots about 1)."""
    for instance in (k for k in INSTANCES if k.family in ("generic", "wide")):
        x = 1.001 * instance.depths[1] / instance.depths[0]
        assert oracles.relative_value(quartic(instance), x) > 2e-9


def test_real_roots_of_the_quartic_are_solutions_of_the_cosine_laws() -> None:
    """The other direction: the quartic has no root but those of the three equations (with y = N / 2D)."""
    checked = 0
    for instance in (k for k in INSTANCES if k.family in ("generic", "wide")):
        rays = oracles.bearings(instance.target, instance.intrinsics)
        roots = np.roots(quartic(instance))
        for x in roots[np.abs(roots.imag) < 1e-9].real:
            y = oracles.p3p_third(instance.source, rays, x)
            points = np.array([1.0, x, y])[:, None] * rays
            sides = [np.linalg.norm(points[i] - points[j]) for i, j in ((0, 1), (1, 2), (2, 0))]
            truth = [np.linalg.norm(instance.source[i] - instance.source[j]) for i, j in ((0, 1), (1, 2), (2, 0))]
            np.testing.assert_allclose(np.divide(sides, sides[0]), np.divide(truth, truth[0]), rtol=1e-5)
            checked += 1
    assert checked >= 500


def test_coefficients_are_those_of_the_interpolated_resultant(quartics: list[np.ndarray]) -> None:
    for instance, q in zip(INSTANCES, quartics, strict=True):
        expected = oracles.p3p_polynomial(instance.source, oracles.bearings(instance.target, instance.intrinsics))
        q, expected = q / np.linalg.norm(q), expected / np.linalg.norm(expected)
        np.testing.assert_allclose(q * np.sign(q @ expected), expected, atol=1e-9)


def test_exchanging_the_first_two_points_reverses_the_quartic() -> None:
    """x = b/a becomes 1/x."""
    for instance in INSTANCES[:50]:
        q = quartic(instance)
        turned = quartic(instance._replace(source=instance.source[[1, 0, 2]], target=instance.target[[1, 0, 2]]))
        q, turned = q / np.linalg.norm(q), turned[::-1] / np.linalg.norm(turned)
        np.testing.assert_allclose(q * np.sign(q @ turned), turned, atol=1e-11)


def test_coefficients_do_not_depend_on_the_unit_of_length() -> None:
    for instance in INSTANCES[:50]:
        q = quartic(instance)
        np.testing.assert_allclose(quartic(instance._replace(source=1e-3 * instance.source)), q, rtol=1e-9, atol=1e-12)


def test_coefficients_of_many_triples_are_those_of_each() -> None:
    camera = Camera(*INSTANCES[0].intrinsics)
    source = np.array([k.source for k in INSTANCES[:20]])
    target = np.array([k.target for k in INSTANCES[:20]])
    together = P3P(camera).coefficients(source, target)
    assert together.shape == (20, 5)
    for k in range(20):
        np.testing.assert_allclose(
            P3P(camera).coefficients(source[k : k + 1], target[k : k + 1])[0], together[k], rtol=1e-13
        )


class TestPrepareRefuses:
    """Each message says what is wrong."""

    problem = P3P(Camera(1000.0, 1000.0, 320.0, 240.0))
    source = np.random.default_rng(0).uniform(-1.0, 1.0, (6, 3))
    target = np.random.default_rng(1).uniform(0.0, 400.0, (7, 2))

    def test_good_input_is_taken(self) -> None:
        """What is changed below is good as it stands: its tables hold the geometry and the noise that were given."""
        tables = self.problem.prepare(self.source, self.target, noise=0.5)
        d2 = ((self.source[:, None] - self.source[None]) ** 2).sum(axis=2)
        np.testing.assert_allclose(tables.distance2 / tables.distance2[0, 1], d2 / d2[0, 1], atol=1e-12)
        rays = np.column_stack([(self.target - (320.0, 240.0)) / 1000.0, np.ones(7)])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        np.testing.assert_allclose(tables.rays, rays.T, atol=1e-14)
        np.testing.assert_allclose(1.0 - tables.versine, rays @ rays.T, atol=1e-12)
        each = self.problem.prepare(self.source, self.target, noise=np.linspace(0.5, 3.5, 7))
        np.testing.assert_allclose(each.variance / tables.variance, np.arange(1.0, 8.0) ** 2, rtol=1e-12)

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            ({"source": source[:3]}, "at least 4"),
            ({"target": target[:3]}, "at least 4"),
            ({"source": source[:, :2]}, "shape"),
            ({"target": np.ones((7, 3))}, "shape"),
            ({"source": np.zeros(3)}, "shape"),
            ({"source": np.where(np.arange(18).reshape(6, 3) == 7, np.nan, source)}, "point 2"),
            ({"target": np.where(np.arange(14).reshape(7, 2) == 3, np.inf, target)}, "point 1"),
            ({"source": np.concatenate((source, source[2:3]))}, "2 and 6"),
            ({"source": np.outer(np.arange(6.0), (1.0, 2.0, 3.0)) + 5.0}, "line"),
            ({"source": [["a", "b", "c"]] * 6}, "numbers"),
            ({"noise": -1.0}, "noise"),
            ({"noise": np.nan}, "noise"),
            ({"noise": np.ones(6)}, "noise"),
            ({"noise": "loud"}, "noise"),
        ],
    )
    def test_bad_input(self, change: dict[str, object], text: str) -> None:
        arguments: dict[str, object] = {"source": self.source, "target": self.target, "noise": 1.0} | change
        with pytest.raises(InputError, match=text):
            self.problem.prepare(**arguments)  # type: ignore[arg-type]


def test_tables_of_points_that_came_before_are_those_of_new_ones() -> None:
    rng = np.random.default_rng(0)
    problem, pixels = P3P(Camera(800.0, 800.0, 320.0, 240.0)), rng.uniform(0, 400, (2, 9, 2))
    for count in (8, 80):  # kept, and too many for that
        source, other = rng.uniform(-1.0, 1.0, (2, count, 3))
        first = problem.prepare(source, pixels[0])
        problem.prepare(other, pixels[0])
        again = problem.prepare(source, pixels[1])
        distances = ((source[:, None] - source) ** 2).sum(axis=2)
        spread = ((source - source.mean(axis=0)) ** 2).mean()
        for tables in (first, again):
            np.testing.assert_allclose(tables.distance2, distances / spread, atol=1e-12)
            np.testing.assert_array_equal(tables.points, first.points)
    line = np.arange(5.0)[:, None] * [1.0, 2.0, 3.0]
    for _ in range(2):
        with pytest.raises(InputError, match="collinear"):
            problem.prepare(line, pixels[0])
