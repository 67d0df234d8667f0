"""Upright pose with unknown focal length against elimination by numbers, brute force over the pose, and scenes."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares

import oracles
import robot_scenes
from instances import axis_rotation
from plain_kernels import interpreted_kernels
from robot_scenes import DOWN
from rootmatch.derivation.shipped import up2pf
from rootmatch.errors import InputError
from rootmatch.hypergraph.affinity import affinity
from rootmatch.problems.residual_kinds import Joint, Normalised
from rootmatch.problems.up2pf import UP2PF
from rootmatch.samplers.exhaustive import exhaustive_tensor
from rootmatch.solvers import get_solver

CENTRE = (320.0, 240.0)


def problem_of(scene: robot_scenes.Scene) -> UP2PF:
    return UP2PF(CENTRE, scene.vertical, (0, 1, 0))


def pair_equation(points: np.ndarray, pixels: np.ndarray, rotations: np.ndarray, focal: float) -> np.ndarray:
    """n · R (X₂ − X₁) for rotations (K, 3, 3), n the normal of the plane of both rays."""
    rays = np.column_stack((pixels - CENTRE, np.full(2, focal)))
    return np.cross(rays[0], rays[1]) @ rotations @ (points[1] - points[0])


def eliminated(points: np.ndarray, pixels: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """The two equations of points 0, 1 and 0, 2 are linear in f (after one f is divided out): their resultant in f."""
    rows = []
    for k in (1, 2):
        one, two = (pair_equation(points[[0, k]], pixels[[0, k]], rotations, f) for f in (1000.0, 2000.0))
        rows.append(((two - one) / 1000.0, 2.0 * one - two))  # a f + b
    (a, b), (c, d) = rows
    return a * d - b * c


def rotation_of(scene: robot_scenes.Scene, angle: float) -> np.ndarray:
    """The camera's rotation with the turn about the vertical changed by ``angle``."""
    return scene.rotation @ axis_rotation(DOWN, angle)


def rotations_of(scene: robot_scenes.Scene, angles: np.ndarray) -> np.ndarray:
    """That for each of K angles, (K, 3, 3)."""
    return np.array([rotation_of(scene, angle) for angle in angles])


@pytest.mark.parametrize("tilt", [0.0, 0.5])
def test_quartic_is_the_resultant_of_two_pairs(tilt: float) -> None:
    """Its real roots are the turns at which the numerical resultant changes sign, counted from the optical axis."""
    seen = 0
    for seed in range(7):
        scene = robot_scenes.zoomed(4, noise=3.0, seed=seed, tilt=tilt)
        points, pixels = scene.source[:3], scene.target[scene.truth[:3]]
        found = problem_of(scene).coefficients(points[None], pixels[None])[0]
        # the problem's own zero of the angle is unknown here: compare the differences of all roots
        roots = np.roots(found)
        ours = np.sort(2.0 * np.arctan(roots[np.abs(roots.imag) < 1e-7 * np.abs(roots)].real))
        angles = np.linspace(-math.pi, math.pi, 501)
        signs = np.sign(eliminated(points, pixels, rotations_of(scene, angles)))
        changes = np.flatnonzero(signs[1:] != signs[:-1])
        assert len(changes) <= len(ours)  # a coarse grid may miss a close pair
        zeros, high = angles[changes], angles[changes + 1]
        for _ in range(40 if len(zeros) else 0):
            middle = 0.5 * (zeros + high)
            same = np.sign(eliminated(points, pixels, rotations_of(scene, middle))) == signs[changes]
            zeros, high = np.where(same, middle, zeros), np.where(same, high, middle)
        if not len(zeros):
            continue  # so much noise leaves some triples without a real root
        seen += 1
        # one shift takes all zeros found to roots
        shifts = [[math.remainder(r - z, 2.0 * math.pi) for r in ours] for z in zeros]
        best = min(
            max(min(abs(math.remainder(s - t, 2.0 * math.pi)) for t in row) for row in shifts) for s in shifts[0]
        )
        assert best < 1e-6
    assert seen >= 4


def test_the_truth_is_a_root_of_all_triples() -> None:
    for seed in range(30):
        scene = robot_scenes.zoomed(5, seed=seed)
        rng = np.random.default_rng(seed)
        sets = np.array([rng.permutation(5)[:3] for _ in range(6)])
        found = problem_of(scene).coefficients(scene.source[sets], scene.target[scene.truth[sets]])
        common = [
            max(oracles.relative_value(q, r.real) for q in found[1:])
            for r in np.roots(found[0])
            if abs(r.imag) < 1e-6 * abs(r)
        ]
        assert min(common) < 1e-7


def test_shipped_formulas_are_those_of_the_equations() -> None:
    fresh = up2pf()
    # three points give six equations for the five unknowns, and the polynomial is that of five
    assert (fresh.surplus_constraints, fresh.stated_constraints, fresh.constraints) == (1, 3, 3)
    assert "A minimal set is over-determined; constraints that the polynomial lacks: 1." in fresh.code
    scene = robot_scenes.zoomed(6, noise=1.0, seed=1)
    rng = np.random.default_rng(0)
    sets = np.array([rng.permutation(6)[:3] for _ in range(30)])
    ours = UP2PF(CENTRE, scene.vertical, (0, 1, 0)).derived
    other = fresh.measured(target=ours.target)
    args = scene.source[sets], scene.target[sets]
    one, two = ours.coefficients(*args), other.coefficients(*args)
    np.testing.assert_allclose(one, two, atol=1e-9 * np.abs(one).max())
    for name in ("minimal", "order", "degree", "constraints", "pair_count", "source_dimension", "target_dimension"):
        assert getattr(ours, name) == getattr(fresh, name) == getattr(UP2PF(CENTRE, (0, 1, 0), (0, 1, 0)), name)
    # among orders of the first three that say the same the choice is not left to rounding
    assert ours.generated.plan["orders"] == fresh.generated.plan["orders"] == ((1, 0, 2), (0, 1, 3), (2, 0, 3))


@cache
def interpreted(kind: type) -> Callable:
    """The kernel of a residual as plain Python: compiling each takes ten seconds."""
    derived = UP2PF(CENTRE, (0, 1, 0), (0, 1, 0)).derived
    return interpreted_kernels(derived)[kind].edge


def best_pose_chi2(scene: robot_scenes.Scene, pixels: np.ndarray, sigma: float) -> float:
    """Least squared reprojection error over σ², over turn, translation and focal length near the truth."""

    def residual(v: np.ndarray) -> np.ndarray:
        xyz = scene.source[: len(pixels)] @ rotation_of(scene, v[0]).T + scene.translation + v[1:4]
        focal = scene.focal * math.exp(v[4])
        return ((focal * xyz[:, :2] / xyz[:, 2:] + CENTRE - pixels) / sigma).ravel()

    return 2.0 * float(least_squares(residual, np.zeros(5), x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14).cost)


def test_joint_is_the_reprojection_error_of_the_best_pose() -> None:
    """Three degrees of freedom, at a noise so small that first order holds for all but nearly degenerate sets."""
    sigma = 1e-4
    errors = []
    index = np.arange(4)
    edge = interpreted(Joint)
    for seed in range(40):
        scene = robot_scenes.zoomed(4, noise=sigma, seed=seed)
        pixels = scene.target[scene.truth]
        tables = problem_of(scene).prepare(scene.source, pixels, sigma)
        value = edge(tables, Joint(), index, index)
        expected = best_pose_chi2(scene, pixels, sigma)
        errors.append(abs(value**2 - expected) / max(expected, 0.1))
    assert np.quantile(errors, 0.5) < 0.02
    assert np.quantile(errors, 0.8) < 0.15


def test_normalised_follows_the_normal_distribution() -> None:
    values = []
    edge = interpreted(Normalised)
    for seed in range(60):
        scene = robot_scenes.zoomed(8, noise=0.05, seed=seed)
        rng = np.random.default_rng(seed)
        source = np.array([rng.permutation(8)[:4] for _ in range(20)])
        tables = problem_of(scene).prepare(scene.source, scene.target, 0.05)
        values.append([edge(tables, Normalised(), i, scene.truth[i]) for i in source])
    flat = np.concatenate(values)
    assert abs(np.mean(flat < 0.6745) - 0.5) < 0.08
    assert np.mean(flat < 3.0) > 0.9


@pytest.mark.parametrize(("outliers", "noise"), [(0, 0.5), (3, 0.2)])
def test_all_hyperedges_and_the_ascent_find_the_truth(outliers: int, noise: float) -> None:
    accuracy = []
    for seed in range(8):
        scene = robot_scenes.zoomed(8, outliers, noise, seed)
        problem = problem_of(scene)
        weigh = affinity("joint")
        shape = len(scene.source), len(scene.target)
        tables = problem.prepare(scene.source, scene.target, noise)
        tensor, _ = exhaustive_tensor(
            tables, weigh.residual.kernel_kind(problem.pair_count), weigh, shape, problem.order
        )
        accuracy.append(np.mean(get_solver("ascent")(tensor, seed=0).assignment == scene.truth))
    assert np.mean(accuracy) >= 0.97
    # what was compiled is what is interpreted elsewhere
    edge = interpreted(Joint)
    for flat, weight in zip(tensor.indices[:20], tensor.weights[:20], strict=True):
        value = edge(tables, Joint(), *np.divmod(flat, shape[1]))
        assert weight == pytest.approx(math.exp(-0.5 * value**2), rel=1e-6, abs=1e-9)


def test_any_frame_of_the_world() -> None:
    """A world whose vertical is not y: the same residuals."""
    scene = robot_scenes.zoomed(5, noise=0.1, seed=3)
    turn = axis_rotation(np.array([0.6, 0.0, 0.8]), 1.1)
    index = np.arange(4)
    edge = interpreted(Joint)
    values = [
        edge(problem.prepare(points, scene.target[scene.truth], 0.1), Joint(), index, index)
        for points, problem in (
            (scene.source, problem_of(scene)),
            (scene.source @ turn.T, UP2PF(CENTRE, scene.vertical, turn @ DOWN)),
        )
    ]
    assert values[0] == pytest.approx(values[1], rel=1e-6)


class TestDegenerate:
    """What the class says about configurations that determine nothing."""

    def test_without_perspective_residuals_fade(self) -> None:
        """Farther and farther away the wrong sets agree no more often than the noise allows, and nothing is NaN."""
        index = np.arange(4)
        edge = interpreted(Joint)
        for depth in (8.0, 80.0, 8000.0):
            for seed in range(10):
                scene = robot_scenes.zoomed(4, noise=0.1, seed=seed, depth=depth)
                pixels = scene.target[scene.truth]
                value = edge(problem_of(scene).prepare(scene.source, pixels, 0.1), Joint(), index, index)
                assert np.isfinite(value)
                assert value >= 0.0

    def test_two_points_on_a_vertical_line_seen_in_its_plane(self) -> None:
        """Their equation holds at every turn and every focal length: a large residual."""
        points = np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.5, 0.3], [-1.0, 0.2, 0.8]])
        pixels = np.array([[320.0, 100.0], [320.0, 300.0], [500.0, 260.0], [111.0, 240.0]])
        tables = UP2PF(CENTRE, (0, 1, 0), (0, 1, 0)).prepare(points, pixels, 0.5)
        index = np.arange(4)
        assert np.all(UP2PF(CENTRE, (0, 1, 0), (0, 1, 0)).coefficients(points[None, :3], pixels[None, :3]) == 0.0)
        for kind in (Normalised, Joint):
            assert interpreted(kind)(tables, kind(), index, index) >= 1e6

    def test_a_negative_focal_length_does_not_count(self) -> None:
        """A scene seen as by a camera of focal length −f: the equations hold, the residual does not."""
        large = 0
        edge = interpreted(Joint)
        for seed in range(20):
            scene = robot_scenes.zoomed(4, noise=0.0, seed=seed)
            mirrored = 2.0 * np.array(CENTRE) - scene.target[scene.truth]
            tables = problem_of(scene).prepare(scene.source, mirrored, 0.1)
            index = np.arange(4)
            large += edge(tables, Joint(), index, index) > 3.5
        assert large >= 18


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"centre": 3.0}, "centre"),
        ({"centre": (np.nan, 1.0)}, "centre"),
        ({"vertical_camera": (0.0, 0.0, 0.0)}, "vertical_camera"),
        ({"vertical_world": (0.0, 1.0)}, "vertical_world"),
        ({"vertical_world": ()}, "vertical_world: none given; up2pf needs one direction"),
    ],
)
def test_bad_options(change: dict[str, object], text: str) -> None:
    with pytest.raises(InputError, match=text):
        UP2PF(**{"centre": CENTRE, "vertical_camera": DOWN, "vertical_world": DOWN, **change})  # type: ignore[arg-type]


def test_bad_points() -> None:
    scene = robot_scenes.zoomed(5, seed=0)
    with pytest.raises(InputError, match="at least 4"):
        UP2PF(CENTRE, (0, 1, 0), (0, 1, 0)).prepare(scene.source[:3], scene.target)
    with pytest.raises(InputError, match="source"):
        UP2PF(CENTRE, (0, 1, 0), (0, 1, 0)).prepare(scene.source[:, :2], scene.target)
    with pytest.raises(InputError, match="source"):
        UP2PF(CENTRE, (0, 1, 0), (0, 1, 0)).prepare("points", scene.target)
