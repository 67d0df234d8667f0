"""Copies of an object that nobody named: which one was asked for is told by nothing but where it was before."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain import rig_search
from rootmatch.explain.image_hypotheses import Candidate, weigh_candidates
from rootmatch.model.mode_search import grow_mode

Floats = NDArray[np.float64]
CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)
VIEW = np.radians(70.0)
ACROSS = ((-0.15, 0.02, 0.75), (0.15, -0.03, 0.7))
"""Places of two objects side by side."""


def cloud(rng: np.random.Generator, n: int) -> Floats:
    """Points of an object of 12 cm."""
    return rng.uniform(-0.06, 0.06, (n, 3))


def seen(rng: np.random.Generator, each: list[Floats], clutter: Floats, sigma: float) -> tuple[Floats, list[Any]]:
    """Noisy detections of several things in random order, and the places of those of each."""
    every = np.concatenate([*each, clutter])
    order = rng.permutation(len(every))
    place = np.argsort(order)
    ends = np.cumsum([0, *map(len, each)])
    return every[order] + rng.normal(0.0, sigma, every.shape), [place[a:b] for a, b in pairwise(ends)]


def wand() -> tuple[Floats, Floats]:
    """Twelve LEDs on a ring that faces one way, and their normals."""
    turn = np.arange(12) * np.pi / 6.0
    points = np.column_stack([0.05 * np.cos(turn), 0.05 * np.sin(turn), 0.008 * np.sin(5.0 * turn**1.3)])
    normals = np.column_stack([np.cos(turn), np.sin(turn), np.full(12, 1.5)])
    return points, normals / np.linalg.norm(normals, axis=1)[:, None]


AWAY, FACING = np.eye(3), Rotation.from_rotvec([np.pi - 0.2, 0.1, 0.0]).as_matrix()
"""Rotations of it."""


@pytest.mark.parametrize("away", [True, False])
def test_a_twin_is_not_the_body_that_is_turned_away_where_it_is_expected(away: bool) -> None:
    """If it faced the camera there, it would be seen: the prior is wrong then."""
    (points, normals), rng = wand(), np.random.default_rng(5)
    twin = CAMERA.project(points @ FACING.T + (0.3, 0.1, 1.2))
    target, (own,) = seen(rng, [twin], rng.uniform((0, 0), (1280, 960), (3, 2)), 0.25)
    expected = rm.Pose(AWAY if away else FACING, (-0.3, 0.0, 1.0), np.diag([np.radians(3.0)] * 3 + [0.03] * 3) ** 2)
    match = rm.match(points, target, rm.P3P(CAMERA), noise=0.27, normals=normals, prior=expected)
    assert np.array_equal(match.assignment, own)
    assert match.probability is not None
    assert (match.status is rm.Status.MATCHED) != away
    assert match.probability == pytest.approx(0.89 if away else 0.97, abs=0.015)


def test_a_body_that_shows_less_is_looked_for_beside_what_contradicts_its_prior() -> None:
    rng = np.random.default_rng(6)
    points, (R, twin_R) = rng.uniform(-0.06, 0.06, (12, 3)), (Rotation.random(rng=rng).as_matrix() for _ in range(2))
    own = CAMERA.project(points[:6] @ R.T + ACROSS[0])
    twin = CAMERA.project(points @ twin_R.T + ACROSS[1])
    target, (mine, _) = seen(rng, [own, twin], rng.uniform((0, 0), (1280, 960), (12, 2)), 0.3)
    known = rm.PosePrior(position=(ACROSS[0], 0.06))
    match = rm.match(points, target, rm.P3P(CAMERA), noise=0.3, prior=known)
    if match.status is rm.Status.MATCHED:
        assert np.array_equal(match.assignment[:6], mine)


def test_a_tracker_does_not_jump_to_a_twin_while_the_body_is_turned_away() -> None:
    (points, normals), rng = wand(), np.random.default_rng(8)
    tracker, found = rm.Tracker(points, rm.P3P(CAMERA), noise=0.3, normals=normals, view_angle=VIEW), []
    for k in range(40):
        turn = Rotation.from_rotvec([0.0, min(0.05 * k, 1.6), 0.0]).as_matrix()  # until it shows nothing
        shown = [(turn @ FACING, np.array([-0.3, 0.0, 1.0]))]
        if k >= 34:
            shown.append((FACING, np.array([0.3, 0.1, 1.2])))
        target = []
        for R, t in shown:
            place = points @ R.T + t
            facing = -((normals @ R.T) * place).sum(axis=1) / np.linalg.norm(place, axis=1) > np.cos(VIEW)
            target.append(CAMERA.project(place[facing]))
        every = np.concatenate([*target, rng.uniform((0, 0), (1280, 960), (2, 2))])
        found.append(tracker.update(every + rng.normal(0.0, 0.3, every.shape), time=k / 60.0))
    assert sum(map(bool, found[:20])) >= 15
    assert not any(found[34:])


@pytest.mark.parametrize(("n", "clutter"), [(6, 10), (12, 40), (40, 0)])
def test_two_copies_in_an_image_are_ambiguous_and_both_are_listed(n: int, clutter: int) -> None:
    rng = np.random.default_rng([7, n])
    points = cloud(rng, n)
    each = [CAMERA.project(points @ Rotation.random(rng=rng).as_matrix().T + t) for t in ACROSS]
    target, own = seen(rng, each, rng.uniform((0, 0), (1280, 960), (clutter, 2)), 0.3)
    match = rm.match(points, target, rm.P3P(CAMERA), noise=0.3)
    assert match.status is rm.Status.AMBIGUOUS
    assert "in several places" in match.advice
    found = [match.assignment, *(other for other, _ in match.alternatives)]
    for places in own:
        assert any(np.mean(one == places) >= 0.9 for one in found)


def test_two_copies_with_normals_are_ambiguous() -> None:
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(32, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points, each = normals * (0.08, 0.064, 0.048), []
    R = Rotation.random(rng=rng).as_matrix()
    for t in ACROSS:
        places = points @ R.T + t
        facing = -((normals @ R.T) * places).sum(axis=1) / np.linalg.norm(places, axis=1) > np.cos(VIEW)
        each.append(CAMERA.project(places[facing]))
    target, _ = seen(rng, each, rng.uniform((0, 0), (1280, 960), (5, 2)), 0.3)
    match = rm.match(points, target, rm.P3P(CAMERA), noise=0.3, normals=normals, view_angle=VIEW)
    assert match.status is rm.Status.AMBIGUOUS


def two_shells(seed: int, turns: tuple[float, float]) -> tuple[Floats, Floats, Floats, list[Any], Floats]:
    """Points and normals of a front of 20 LEDs, the image of two that are turned about the vertical by such degrees.

    Also the assignment that is right for each, and the vertical of the first in its own frame; the other leans by 10°.
    """
    rng = np.random.default_rng(seed)
    azimuth, height = rng.uniform(-1.9, 1.9, 20), rng.uniform(-0.05, 0.05, 20)
    points = np.column_stack([0.09 * np.sin(azimuth), height, -0.07 * np.cos(azimuth)])
    normals = np.column_stack([np.sin(azimuth) / 0.09, 3.0 * height, -np.cos(azimuth) / 0.07])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    each, facing, down = [], [], np.zeros(3)
    for (x, y, z), turn, lean in zip(ACROSS, turns, (2.0, 10.0), strict=True):
        R = Rotation.from_euler("xyz", (lean, turn, 0.0), degrees=True).as_matrix()
        places = points @ R.T + (4.0 * x, 4.0 * y, 2.0 * z)
        towards = -((normals @ R.T) * places).sum(axis=1) / np.linalg.norm(places, axis=1)
        facing.append(np.flatnonzero(towards > np.cos(VIEW)))
        each.append(CAMERA.project(places[facing[-1]]))
        down = down if down.any() else R[1]
    target, own = seen(rng, each, np.empty((0, 2)), 0.2)
    right = [np.full(20, -1) for _ in own]
    for assignment, shown, places in zip(right, facing, own, strict=True):
        assignment[shown] = places
    return points, normals, target, right, down


@pytest.mark.parametrize("seed", [2, 9, 17])
def test_a_copy_that_shows_far_more_is_not_told_by_that(seed: int) -> None:
    points, normals, target, right, _ = two_shells(seed, (62.0, 0.0))
    match = rm.match(points, target, rm.P3P(CAMERA), noise=0.2, normals=normals)
    assert match.status is rm.Status.AMBIGUOUS
    found = [match.assignment, *(other for other, _ in match.alternatives)]
    for one in right:
        assert any(np.mean(other[one >= 0] == one[one >= 0]) > 0.8 for other in found)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_vertical_tells_a_copy_that_leans_from_the_body(seed: int) -> None:
    points, normals, target, right, down = two_shells(seed, (40.0, 0.0))
    vertical = rm.PosePrior(vertical=(down, (0.0, 1.0, 0.0), np.radians(2.0)))
    match = rm.match(points, target, rm.P3P(CAMERA), noise=0.2, normals=normals, prior=vertical)
    assert match
    assert (match.assignment[match.assignment >= 0] == right[0][match.assignment >= 0]).all()


@pytest.mark.parametrize("seed", [0, 2, 3, 4, 5, 8, 10, 13])
def test_a_copy_that_shows_less_than_the_body_is_weighed(seed: int) -> None:
    """A search meets it with less evidence than chance may reach: the model knows whether it is an accident."""
    rng = np.random.default_rng(seed)
    points = cloud(rng, 8)
    placed = [CAMERA.project(points @ Rotation.random(rng=rng).as_matrix().T + t) for t in ACROSS]
    target, _ = seen(rng, [placed[0], placed[1][:6]], rng.uniform((0, 0), (1280, 960), (5, 2)), 0.4)
    match = rm.match(points, target, rm.P3P(CAMERA), noise=0.4)
    assert match.status is rm.Status.AMBIGUOUS
    assert "in several places" in match.advice


@pytest.mark.parametrize("problem", [rm.Rigid(), rm.Similarity()])
@pytest.mark.parametrize("n", [5, 12])
def test_two_copies_in_space_are_ambiguous(problem: rm.Problem, n: int) -> None:
    for seed in range(4):
        rng = np.random.default_rng([seed, n])
        points = cloud(rng, n)
        each = [points @ Rotation.random(rng=rng).as_matrix().T + t for t in ACROSS]
        target, _ = seen(rng, each, rng.uniform(-0.3, 0.3, (5, 3)), 3e-4)
        match = rm.match(points, target, problem, noise=3e-4)
        assert match.status is rm.Status.AMBIGUOUS
        assert "in several places" in match.advice


@pytest.mark.parametrize("space", [False, True])
def test_a_tracker_keeps_to_its_object_when_a_copy_comes_into_view(space: bool) -> None:
    rng = np.random.default_rng(5)
    points, sigma = cloud(rng, 8), 3e-4 if space else 0.3
    first, rate = [Rotation.random(rng=rng) for _ in ACROSS], rng.normal(0.0, 0.5, (2, 3))
    tracker = rm.Tracker(points, rm.Rigid() if space else rm.P3P(CAMERA), noise=sigma)
    for k in range(40):
        each = []
        for R, w, t in list(zip(first, rate, ACROSS, strict=True))[: 1 if k < 20 else 2]:
            places = points @ (Rotation.from_rotvec(w * k / 60.0) * R).as_matrix().T + t
            each.append(places if space else CAMERA.project(places))
        target, own = seen(rng, each, np.empty((0, 3 if space else 2)), sigma)
        match = tracker.update(target, time=k / 60.0)
        assert match.status is rm.Status.MATCHED
        assert set(match.assignment[match.assignment >= 0]) <= set(own[0])


def test_what_competition_makes_the_first_mode_has_the_sum_over_its_changes() -> None:
    """A body and its mirror image: each explains the other's detections so well that its own seem far behind."""
    rng = np.random.default_rng(2)
    points = cloud(rng, 24)
    points[1] = points[0] + (0.0006, 0.0, 0.0)  # half a pixel apart: either order is as good
    shapes = [points, points * (-1.0, 1.0, 1.0)]
    each = [
        CAMERA.project(one @ Rotation.random(rng=rng).as_matrix().T + t) for one, t in zip(shapes, ACROSS, strict=True)
    ]
    target, own = seen(rng, each, np.empty((0, 2)), 0.5)
    match = rm.match(
        np.concatenate(shapes), target, rm.P3P(CAMERA), noise=0.5, bodies=np.repeat([0, 1], len(points)), seed=1
    )
    assert match.bodies is not None
    for body in match.bodies.values():
        assert body.finding.posterior is not None
        assert body.finding.posterior.modes.summed[0]
        assert body.confidence[:2].max() < 0.95

    # as if the search had found another pose that was far better, but whose detections are another body's
    candidates = [Candidate.of(body.finding.task, [one]) for body, one in zip(match.bodies.values(), own, strict=True)]
    whole = candidates[0].modes
    bare = whole._replace(summed=np.zeros(len(whole.summed), np.bool_), local=np.ones(whole.local.shape))
    again = grow_mode(candidates[0].model, bare, 0)
    np.testing.assert_allclose(again.local[0], whole.local[0], atol=1e-6)
    (told, _) = weigh_candidates([Candidate(candidates[0].task, candidates[0].model, bare), candidates[1]])
    np.testing.assert_allclose(told.modes.local[0], whole.local[0], atol=1e-6)


def reported_twice(seed: int, twice: float) -> tuple[Floats, Floats, list[set[int]]]:
    """Eight fiducials, of which some are touched twice, and which targets are reports of each."""
    rng = np.random.default_rng(seed)
    fiducials = cloud(rng, 8) * 800.0
    places = fiducials @ Rotation.random(random_state=seed).as_matrix().T + (0.0, 50.0, 900.0)
    point = np.repeat(np.arange(8), 1 + (rng.random(8) < twice))
    point = point[rng.permutation(len(point))]
    return (
        fiducials,
        places[point] + rng.normal(0.0, 0.2, (len(point), 3)),
        [{*np.flatnonzero(point == k)} for k in range(8)],
    )


@pytest.mark.parametrize("several", [False, True])
def test_points_that_are_reported_twice_are_no_copy_of_the_body(several: bool) -> None:
    """Which report is a point's is in doubt, and the pose is not; beside it by more than noise stands a copy."""
    trusted = 0
    for seed in range(1000, 1010):
        fiducials, measured, of = reported_twice(seed, 0.4)
        other = cloud(np.random.default_rng(seed + 1), 5) * 800.0
        source = np.vstack([fiducials, other]) if several else fiducials
        labels = ["head"] * 8 + ["other"] * 5 if several else None
        found = rm.match(source, measured, rm.Rigid(), noise=(0.0, 0.2), bodies=labels)
        match = found if found.bodies is None else found.bodies["head"]
        assert match.status is not rm.Status.UNTRUSTED
        assert "in several places" not in match.advice
        assert all(target < 0 or target in own for target, own in zip(match.assignment[:8], of, strict=True))
        trusted += bool(match)
        beside = np.vstack([measured, measured[[min(own) for own in of]] + (0.0, 0.0, 4.0)])
        assert rm.match(fiducials, beside, rm.Rigid(), noise=(0.0, 0.2)).status is rm.Status.AMBIGUOUS
    assert trusted >= 6


def test_a_pose_is_certain_though_every_point_is_reported_twice() -> None:
    fiducials, measured, _ = reported_twice(1000, 1.0)
    match = rm.match(fiducials, measured, rm.Rigid(), noise=(0.0, 0.2))
    assert match.status is rm.Status.AMBIGUOUS
    assert "the pose is certain" in match.advice


@pytest.mark.parametrize("seed", [4, 9, 15])
def test_two_flanges_before_a_stereo_pair_are_ambiguous_and_both_are_listed(seed: int) -> None:
    """Each is nearly symmetric: turns of the one that fits better are more than a search keeps."""
    rng, turn = np.random.default_rng(seed), np.arange(12) * np.pi / 6.0
    points = np.column_stack([0.12 * np.cos(turn), 0.12 * np.sin(turn), np.zeros(12)])
    points = np.concatenate([points, [(0.09, 0.033, 0.0), (-0.044, 0.085, 0.0)]])
    inwards = [Rotation.from_rotvec([0.0, yaw, 0.0]).as_matrix() for yaw in (-0.12, 0.12)]
    camera = rm.Camera(2200.0, 2200.0, 1024.0, 768.0)
    views = [(R, -R @ (x, 0.0, 0.0)) for R, x in zip(inwards, (-0.15, 0.15), strict=True)]
    turns = Rotation.from_rotvec([np.pi, 0.0, 0.0]) * Rotation.from_rotvec(rng.normal(0.0, (0.25, 0.25, 3.0), (2, 3)))
    places = [points @ R.T + t for R, t in zip(turns.as_matrix(), ((-0.17, 0.0, 1.0), (0.17, 0.0, 1.0)), strict=True)]
    every, images = np.concatenate(places) + rng.normal(0.0, 1e-4, (28, 3)), []
    for R, t in views:
        image = camera.project(every @ R.T + t) + rng.normal(0.0, 0.12, (28, 2))
        images.append(np.concatenate([image, rng.uniform((400, 300), (1650, 1250), (3, 2))]))
    rig = rm.Rig([(camera, *view) for view in views])
    match = rm.match(points, images, rm.P3P(rig), noise=0.12, source_noise=1e-4)
    assert match.status is rm.Status.AMBIGUOUS
    firsts = [one[one >= 0].min() for one in (match.assignment, *(other for other, _ in match.alternatives))]
    assert {one % 31 >= 14 for one in firsts} == {False, True}


def before_three_cameras(seed: int, copies: int, clutter: int) -> tuple[Floats, list[Floats], rm.Rig]:
    """A body of five markers or two of it, of which every fifth sighting is missed, as three cameras around see it."""
    rng, camera = np.random.default_rng(seed), rm.Camera(900.0, 900.0, 640.0, 480.0, size=(1280, 960))
    points, views, images = cloud(rng, 5), [], []
    placed = [points @ Rotation.random(rng=rng).as_matrix().T + t for t in ACROSS[:copies]]
    for angle in (-0.35, 0.0, 0.35):
        R = Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix()
        views.append((camera, R, np.array([0.0, 0.0, 0.75]) - R @ (0.0, 0.0, 0.75)))
        every = camera.project(np.concatenate(placed) @ R.T + views[-1][2])
        own = every[rng.random(len(every)) < 0.8]
        strays = rng.uniform((0, 0), (1280, 960), (clutter, 2))
        images.append(np.concatenate([own, strays]) + rng.normal(0.0, 0.3, (len(own) + clutter, 2)))
    return points, images, rm.Rig(views)


@pytest.mark.parametrize(("seed", "clutter"), [(0, 0), (13, 0), (18, 0), (6, 4)])
def test_a_copy_of_few_markers_is_met_though_the_first_camera_tells_a_pose(seed: int, clutter: int) -> None:
    """The search ended there, as no other pose explains more, and the copy shows three or four in each."""
    points, images, rig = before_three_cameras(seed, 2, clutter)
    match = rm.match(points, images, rm.P3P(rig), noise=0.3)
    assert match.status is rm.Status.AMBIGUOUS
    assert "in several places" in match.advice


def test_nothing_is_searched_for_a_copy_where_hardly_anything_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    searched, asked = rig_search.camera_task, set[int]()

    def noted(task: Any, *given: Any) -> Any:
        asked.add(task.shape[1])
        return searched(task, *given)

    monkeypatch.setattr(rig_search, "camera_task", noted)
    for seed in range(5):
        points, images, rig = before_three_cameras(seed, 1, 2)
        assert rm.match(points, images, rm.P3P(rig), noise=0.3).status is rm.Status.MATCHED
        assert asked == {sum(map(len, images))}
        asked.clear()
