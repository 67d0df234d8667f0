"""Bodies that differ by one point, all of them given: the one in view is told from those that are not."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain.likeness import likenesses

Floats = NDArray[np.float64]
CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)
UP = np.array([0.0, 1.0, 0.0])
SEEDS = range(6)
SEQUENCES = 1005, 1011


def family(kind: str, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Two bodies of seven points: of the second one, a point is elsewhere, it has one more, or all are larger."""
    first = rng.uniform(-0.12, 0.12, (7, 3))
    if kind == "one more":
        return first, np.concatenate([first, rng.uniform(-0.12, 0.12, (1, 3))])
    if kind == "larger":
        return first, 1.1 * first
    second, way = first.copy(), rng.normal(size=3)
    second[1] += 0.05 * way / np.linalg.norm(way)
    return first, second


def trusted(problem: str, kind: str, shown: int, order: tuple[int, int], seed: int) -> tuple[bool, bool]:
    """Whether the body in view is trusted with all of its points right, and whether the other one is trusted."""
    rng = np.random.default_rng([seed, 5])
    bodies = family(kind, rng)
    R, z = Rotation.random(rng=rng).as_matrix(), rng.uniform(1.0, 2.5)
    seen = bodies[shown] @ R.T + (0.25 * z * rng.uniform(-1.0, 1.0), 0.2 * z * rng.uniform(-1.0, 1.0), z)
    source = np.concatenate([bodies[k] for k in order])
    labels = np.repeat(order, [len(bodies[k]) for k in order])
    if problem == "rigid":
        strays = seen.mean(axis=0) + rng.uniform(-0.3, 0.3, (4, 3))
        target = np.concatenate([seen, strays]) + 0.0003 * rng.normal(size=(len(seen) + 4, 3))
        match = rm.match(source, target, rm.Rigid(), noise=(0.0, 0.0003), bodies=labels)
    else:
        pixels = np.concatenate([CAMERA.project(seen), rng.uniform((0.0, 0.0), (1280.0, 960.0), (4, 2))])
        target = pixels + 0.3 * rng.normal(size=pixels.shape)
        upright = rm.UP2P(CAMERA, vertical_camera=R @ UP, vertical_world=UP)
        match = rm.match(source, target, rm.P3P(CAMERA) if problem == "p3p" else upright, noise=0.3, bodies=labels)
    assert match.bodies is not None
    own = match.bodies[shown]
    return bool(own) and (own.assignment == np.arange(len(seen))).all(), bool(match.bodies[1 - shown])


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
@pytest.mark.parametrize("shown", [0, 1])
@pytest.mark.parametrize("problem", ["p3p", "up2p", "rigid"])
def test_one_point_tells_which_of_them_is_in_view(problem: str, shown: int, order: tuple[int, int]) -> None:
    """It does so in whatever order they are given: the first one once took the detections of the other."""
    found = [trusted(problem, "one elsewhere", shown, order, seed) for seed in SEEDS]
    assert sum(right for right, _ in found) >= len(SEEDS) - 1
    assert not any(other for _, other in found)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
@pytest.mark.parametrize("problem", ["p3p", "rigid"])
def test_a_point_more_is_seen_where_it_is_there(problem: str, order: tuple[int, int]) -> None:
    """Where it is not there, the larger body may have it hidden: then nobody can be sure of either."""
    found = [trusted(problem, "one more", 1, order, seed) for seed in SEEDS]
    assert sum(right for right, _ in found) >= len(SEEDS) - 1
    assert not any(other for _, other in found)
    assert not any(trusted(problem, "one more", 0, order, seed)[1] for seed in SEEDS)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_one_camera_does_not_tell_a_larger_body_from_a_nearer_one(order: tuple[int, int]) -> None:
    for seed in SEEDS:
        assert trusted("p3p", "larger", seed % 2, order, seed) == (False, False)


def two_tools(rng: np.random.Generator, off: float = 8.0) -> Floats:
    """Two tools of five markers, mm, of which one is elsewhere; (2, 5, 3)."""
    first = rng.uniform(-60.0, 60.0, (5, 3))
    second = first.copy()
    second[3] += off * np.array([0.6, 0.6, 0.53])
    return np.stack([first, second])


@pytest.mark.parametrize("off", [8.0, 60.0])
def test_tools_that_share_all_markers_but_one_are_both_trusted(off: float) -> None:
    """All of both against four of each, and a hidden marker of each, is no tie: it was one, of two places each."""
    for seed in range(1000, 1006):
        rng = np.random.default_rng(seed)
        tools = two_tools(rng, off)
        seen = [tools[k] @ Rotation.random(rng=rng).as_matrix().T + (200.0 - 400.0 * k, 0.0, 1500.0) for k in (0, 1)]
        target = np.concatenate([*seen, rng.uniform((-300.0, -300.0, 1300.0), (300.0, 300.0, 1800.0), (2, 3))])
        target[:10] += 0.25 * rng.normal(size=(10, 3))
        match = rm.match(np.concatenate(tools), target, rm.Rigid(), noise=(0.0, 0.25), bodies=np.repeat([0, 1], 5))
        assert match, match.advice
        assert (match.assignment == np.arange(10)).all()


def test_a_hidden_tool_does_not_take_the_markers_of_its_like_in_a_sequence() -> None:
    """Its prediction grows wide until the other one is within it, of which it explains four of five markers.

    It took them, the other one got nothing, and afterwards both followed each other's place, trusted, in 90 of 160.
    """
    labels, trusted = np.repeat([0, 1], 5), 0
    for seed in SEQUENCES:
        rng = np.random.default_rng(seed)
        tools, turned = two_tools(rng), Rotation.random(2, rng=rng)
        axis, phase = rng.normal(size=(2, 3)), rng.uniform(0.0, 6.0, 4)
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        tracker = rm.Tracker(
            np.concatenate(tools), rm.Rigid(), noise=(0.0, 0.25), bodies=labels,
            tracking=rm.TrackingOptions(interval=0.01),
        )  # fmt: skip
        for k in range(80):
            t = 0.01 * (k + 95)  # they pass each other at 1.3 s
            truth, seen = np.full(10, -1), np.empty((0, 3))
            for body in (0, 1) if not 12 <= k < 40 else (1,):
                turn = Rotation.from_rotvec(2.0 * np.sin(1.5 * t + phase[body]) * axis[body]) * turned[body]
                x = (200.0 - 400.0 * body) * np.cos(1.2 * t)
                place = (x, 80.0 * np.sin(2.0 * t + phase[2 + body]), 1500.0 + 100.0 * body)
                lit = np.flatnonzero(rng.random(5) > 0.03)
                truth[5 * body + lit] = len(seen) + np.arange(len(lit))
                seen = np.concatenate([seen, tools[body][lit] @ turn.as_matrix().T + place])
            match = tracker.update(seen + 0.25 * rng.normal(size=seen.shape))
            assert match.bodies is not None
            for body, own in match.bodies.items():
                if own:
                    trusted += 1
                    matched = own.assignment >= 0
                    assert (own.assignment[matched] == truth[labels == body][matched]).all()
    assert trusted >= 0.95 * len(SEQUENCES) * (80 + 52)


@pytest.mark.parametrize("space", [True, False])
def test_a_sequence_that_began_the_wrong_way_round_is_put_right(space: bool) -> None:
    """The first frame hides the markers that differ, and a prediction has the tools exchanged.

    From then on each was found where it was expected, with five of six markers, for ever.
    """
    for seed in range(1000, 1003):
        rng = np.random.default_rng(seed)
        first = rng.uniform(-0.06, 0.06, (6, 3))
        tools = np.stack([first, first])
        tools[1, 3] += (0.012, 0.01, 0.008)
        turned, axis = Rotation.random(2, rng=rng), rng.normal(size=(2, 3))
        tracker = rm.Tracker(
            np.concatenate(tools), rm.Rigid() if space else rm.P3P(CAMERA), noise=(0.0, 0.0003) if space else 0.3,
            bodies=np.repeat([0, 1], 6), tracking=rm.TrackingOptions(interval=0.02),
        )  # fmt: skip
        for k in range(16):
            t, poses, seen = 0.02 * k, [], []
            for body in (0, 1):
                R = (Rotation.from_rotvec(0.5 * t * axis[body]) * turned[body]).as_matrix()
                place = np.array([(0.2 - 0.4 * body) * np.cos(t), 0.05 * t, 1.0 + 0.1 * body])
                poses.append(rm.Pose(R, place, np.diag([1e-4] * 3 + [1e-6] * 3)))
                shown = np.delete(tools[body], 3, axis=0) if k == 0 else tools[body]
                seen.append(shown @ R.T + place)
            target = np.concatenate(seen)
            target = target if space else CAMERA.project(target)
            target = target + (0.0003 if space else 0.3) * rng.normal(size=target.shape)
            match = tracker.update(target, time=t, prior={0: poses[1], 1: poses[0]} if k == 0 else None)
            if not space and k >= 5:  # the prior has the place of the other one: it is not followed
                assert all(len(body.belief.poses) == 1 for body in tracker._bodies.values())
        assert match, match.advice
        assert (match.assignment == np.arange(12)).all()


def test_likenesses_are_found_in_any_frame_and_order() -> None:
    rng = np.random.default_rng(1)
    first, order = rng.uniform(-0.1, 0.1, (7, 3)), rng.permutation(7)
    second = first[order] @ Rotation.random(rng=rng).as_matrix().T + (1.0, 2.0, 3.0)
    place = int(np.flatnonzero(order == 4)[0])
    second[place] += 0.05
    expected = np.argsort(order)
    expected[4] = -1
    (found,) = likenesses(first, second)
    np.testing.assert_array_equal(found, expected)
    assert likenesses(first, rng.uniform(-0.1, 0.1, (7, 3))) == ()
