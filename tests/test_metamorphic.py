"""What must not matter: the unit, the origin, where the image begins, and the order of points, for every problem."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.algebra.rotation import rotation_about_y
from rootmatch.simulation import p3p_scene, three_plus_one_scene, up2p_scene

NOISE = 0.3
DerivedScene = tuple[Any, np.ndarray, np.ndarray, float, np.ndarray]
"""A problem, source, target, noise and the truth."""


def robot_scene() -> tuple[Any, np.ndarray, np.ndarray]:
    """Two images of a camera that moves in a plane."""
    rng = np.random.default_rng(5)
    camera = rm.Camera(1000.0, 1000.0, 320.0, 240.0)
    points = rng.uniform((-3.0, -2.0, 6.0), (3.0, 2.0, 12.0), (7, 3))
    moved = points @ rotation_about_y(np.cos(0.2), np.sin(0.2)).T + [0.8, 0.0, 0.4]
    images = [camera.project(seen) + rng.normal(0.0, NOISE, (7, 2)) for seen in (points, moved)]
    return rm.PlanarMotion(camera, axis=(0, 1, 0)), images[0], images[1][rng.permutation(7)]


def object_scene(name: str) -> tuple[Any, np.ndarray, np.ndarray]:
    """Points of space and their image, or another set of such points."""
    if name == "p3p":
        scene = p3p_scene(7, 2, noise=NOISE, seed=2)
    elif name == "3p1":
        scene = three_plus_one_scene(7, 1, noise=NOISE, seed=2)
    else:
        scene = up2p_scene(7, 2, noise=NOISE, seed=2)
    problem: Any = scene.problem
    if name == "up2pf":
        problem = rm.UP2PF((problem.camera.cx, problem.camera.cy), problem.vertical_camera, problem.vertical_world)
    return problem, scene.source, scene.target


def similarity_scene(name: str) -> tuple[Any, np.ndarray, np.ndarray]:
    """Two sets of points of one plane or space."""
    rng = np.random.default_rng(6)
    dimension = 2 if name == "similarity" else 3
    points = rng.uniform(0.0, 500.0, (7, dimension))
    turn = np.linalg.qr(rng.normal(size=(dimension, dimension)))[0]
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    target = points @ turn.T * (1.7 if dimension == 2 else 1.0) + 40.0 + rng.normal(0.0, NOISE, points.shape)
    problem = rm.Similarity(2) if dimension == 2 else rm.Rigid(3)
    return problem, points, np.concatenate([target, rng.uniform(0.0, 500.0, (1, dimension))])[rng.permutation(8)]


def scene_of(name: str) -> tuple[Any, np.ndarray, np.ndarray]:
    if name == "planar":
        return robot_scene()
    return similarity_scene(name) if name in ("similarity", "rigid") else object_scene(name)


NAMES = ["p3p", "up2p", "3p1", "planar", "up2pf", "similarity", "rigid"]
IN_SPACE = ["p3p", "up2p", "up2pf"]
OF_CAMERAS = ["p3p", "up2p", "3p1", "planar", "up2pf"]


def same(one: rm.Match, other: rm.Match, tolerance: float = 1e-6) -> None:
    """The same assignment and status, and the same score but for rounding."""
    assert one.assignment.tolist() == other.assignment.tolist()
    assert (one.assignment >= 0).sum() >= 5  # there is something to compare
    assert one.status is other.status
    assert other.score == pytest.approx(one.score, rel=tolerance)
    assert other.margin == pytest.approx(one.margin, abs=tolerance)
    if one.probability is not None:
        two_views = one.problem.source_dimension == 2 and one.problem.order == 4
        sampled = 1e-2 if two_views else 1e-3  # of two views it is a mean over samples
        assert other.probability == pytest.approx(one.probability, abs=sampled)


def found(problem: Any, source: np.ndarray, target: np.ndarray, noise: Any = NOISE) -> rm.Match:
    return rm.match(source, target, problem, noise=noise)


@pytest.mark.parametrize("unit", [1e3, 1e-3, 1e6, 1e-6])
@pytest.mark.parametrize("name", IN_SPACE)
def test_the_unit_of_length(name: str, unit: float) -> None:
    problem, source, target = scene_of(name)
    same(found(problem, source, target), found(problem, source * unit, target))


@pytest.mark.parametrize("unit", [1e3, 1e-3, 1e6, 1e-6])
@pytest.mark.parametrize("name", ["similarity", "rigid"])
def test_the_unit_of_both_sets(name: str, unit: float) -> None:
    problem, source, target = scene_of(name)
    same(found(problem, source, target), found(problem, source * unit, target * unit, NOISE * unit))


@pytest.mark.parametrize("name", ["similarity", "rigid"])
def test_the_unit_where_the_noise_is_estimated(name: str) -> None:
    problem, source, target = scene_of(name)
    one = found(problem, source, target, "auto")
    other = found(problem, source * 1e-6, target * 1e-6, "auto")
    same(one, other, tolerance=1e-3)
    assert other.noise == pytest.approx(1e-6 * one.noise, rel=1e-3)


@pytest.fixture(scope="module")
def derived(tmp_path_factory: pytest.TempPathFactory) -> dict[str, DerivedScene]:
    """Problems derived from equations, with a scene each: the cosine laws of P3P, and a radial camera in pixels."""
    from test_derivation import p3p_by_cosines, radial_camera, radial_scene

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROOTMATCH_CACHE_DIR", str(tmp_path_factory.mktemp("derived")))
        laws, radial = p3p_by_cosines(), radial_camera()
    scene = p3p_scene(n=8, outliers=2, noise=0.5, seed=4)
    points, pixels, noise = radial_scene()
    order = np.random.default_rng(1).permutation(8)
    return {
        "laws": (laws, scene.source, scene.target, 0.5, scene.truth),
        "radial": (radial, points, pixels[order], noise, np.argsort(order)),
    }


def test_the_units_of_a_derived_problem(derived: dict[str, DerivedScene]) -> None:
    """In every unit of the source, and of a target that is no image of a camera, the same match, and a right one."""
    units = (1e-6, 1e6)
    for name, (problem, source, target, noise, truth) in derived.items():
        one = found(problem, source, target, noise)
        assert one.assignment.tolist() == truth.tolist()
        assert one.status is rm.Status.MATCHED
        for length in units:
            for pixel in units if name == "radial" else (1.0,):
                same(one, found(problem, source * length, target * pixel, noise * pixel))


@pytest.mark.parametrize("name", [*IN_SPACE, "similarity", "rigid"])
def test_an_origin_far_away(name: str) -> None:
    """At 1e6 a coordinate is known to 1e-10: nothing that noise of a third of a pixel would see."""
    problem, source, target = scene_of(name)
    offset = np.array([1e6, -1e6, 1e6])[: source.shape[1]]
    same(found(problem, source, target), found(problem, source + offset, target), tolerance=1e-4)


@pytest.mark.parametrize("name", OF_CAMERAS)
def test_an_image_that_begins_elsewhere(name: str) -> None:
    """The principal point moves with the pixels, as where an image is cut out of a larger one."""
    problem, source, target = scene_of(name)
    shift = np.array([1000.0, -500.0])
    if name == "up2pf":
        moved = replace(problem, centre=tuple(np.array(problem.centre) + shift))
    else:
        camera = problem.camera
        second = getattr(problem, "camera2", None) or camera
        cameras = [rm.Camera(c.fx, c.fy, c.cx + shift[0], c.cy + shift[1]) for c in (camera, second)]
        views = {"camera": cameras[0]} | ({"camera2": cameras[1]} if hasattr(problem, "camera2") else {})
        moved = replace(problem, **views)
    first = source + shift if problem.source_dimension == 2 else source
    # between two views nearly equal roots are common: rounding of rays in the last digit moves them by its square root,
    # and the weights of those few hyper-edges by a thousandth (3P1: 3 of 461 by more than 1e-4)
    tolerance = 5e-3 if problem.source_dimension == 2 else 1e-6
    same(found(problem, source, target), found(moved, first, target + shift), tolerance)


@pytest.mark.parametrize("name", NAMES)
def test_the_order_of_the_points(name: str) -> None:
    problem, source, target = scene_of(name)
    rng = np.random.default_rng(9)
    rows, columns = rng.permutation(len(source)), rng.permutation(len(target))
    one, other = found(problem, source, target), found(problem, source[rows], target[columns])
    back = np.full(len(source), -1)
    matched = other.assignment >= 0
    back[rows[matched]] = columns[other.assignment[matched]]
    assert back.tolist() == one.assignment.tolist()
    assert other.status is one.status
    # which pair of minimal sets a hyper-edge compares follows from the order where points are equally far apart
    assert other.score == pytest.approx(one.score, rel=0.05)
