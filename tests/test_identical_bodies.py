"""Bodies that no image tells apart: all of them are found, ambiguous by name, and keep their names from then on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain.body_labels import check_bodies
from rootmatch.tracking.identical_bodies import find_identical_bodies

Floats = NDArray[np.float64]
CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)
LEDS = 9


def flight(seed: int, bodies: int, frames: int) -> Iterator[tuple[Floats, NDArray[np.int64]]]:
    """Detections of some bodies that turn and drift side by side, and the owner of each; −1 for clutter."""
    rng = np.random.default_rng(seed)
    shape = rng.uniform(-0.06, 0.06, (LEDS, 3))
    first, rate = rng.uniform(0.0, 6.0, (bodies, 3)), rng.uniform(-0.5, 0.5, (bodies, 3))
    place = np.stack([np.linspace(-0.3, 0.3, bodies), np.zeros(bodies), np.full(bodies, 0.9)], axis=1)
    yield shape, np.arange(LEDS)
    for k in range(frames):
        pixels, owner = [rng.uniform((0, 0), (1280, 960), (4, 2))], [np.full(4, -1)]
        for body in range(bodies):
            R = Rotation.from_rotvec(first[body] + rate[body] * k / 60.0).as_matrix()
            seen = np.flatnonzero(rng.random(LEDS) < 0.95)
            image = CAMERA.project(shape[seen] @ R.T + place[body] + (0.0, 0.001 * k, 0.0))
            pixels.append(image + rng.normal(0.0, 0.3, image.shape))
            owner.append(np.full(len(seen), body))
        order = rng.permutation(sum(map(len, owner)))
        yield np.concatenate(pixels)[order], np.concatenate(owner)[order]


def owners(match: rm.Match, owner: NDArray[np.int64]) -> list[set[int]]:
    """For each body that was given, which bodies its detections are of."""
    assert match.bodies is not None
    return [set(owner[body.assignment[body.assignment >= 0]].tolist()) for body in match.bodies.values()]


@pytest.mark.parametrize("shown", [6, 5])
def test_what_one_of_many_copies_may_be_each_may_be(shown: int) -> None:
    """Also if one of them is out of view: nobody can say which."""
    rng = np.random.default_rng(1010)
    shape = rng.uniform(-0.06, 0.06, (7, 3))
    image = [rng.uniform((0, 0), (1280, 960), (4, 2))]
    for body in range(shown):
        seen = shape[rng.permutation(7)[: 7 - body // 2]]  # the last ones show less
        R, place = Rotation.random(rng=rng).as_matrix(), (0.2 * (body % 3 - 1), 0.2 * (body // 3) - 0.1, 0.9)
        image.append(CAMERA.project(seen @ R.T + place) + rng.normal(0.0, 0.3, (len(seen), 2)))
    labels = np.repeat(np.arange(6), 7)
    match = rm.match(np.tile(shape, (6, 1)), np.concatenate(image), rm.P3P(CAMERA), noise=0.3, bodies=labels)
    assert match.bodies is not None
    for body in match.bodies.values():
        assert body.status is rm.Status.AMBIGUOUS
        assert "6 bodies are identical, and no image tells which is where" in body.advice
    found = [body.probability for body in match.bodies.values() if (body.assignment >= 0).any()]
    assert found == pytest.approx(shown * [1.0 / 6.0], abs=0.02)


@pytest.mark.parametrize("bodies", [2, 3])
def test_an_image_shows_all_of_them_and_cannot_tell_which_is_which(bodies: int) -> None:
    frames = flight(1, bodies, 1)
    shape, _ = next(frames)
    target, owner = next(frames)
    labels = np.repeat(np.arange(bodies), LEDS)
    match = rm.match(np.tile(shape, (bodies, 1)), target, rm.P3P(CAMERA), noise=0.3, bodies=labels)
    assert match.bodies is not None
    for body in match.bodies.values():
        assert body.status is rm.Status.AMBIGUOUS
        assert body.probability == pytest.approx(1.0 / bodies, abs=0.05)
        assert len(body.alternatives) >= bodies - 1
    assert sorted(owners(match, owner), key=min) == [{k} for k in range(bodies)]


@pytest.mark.parametrize("bodies", [2, 3])
def test_a_tracker_keeps_the_names_that_it_gave_them(bodies: int) -> None:
    frames = flight(2, bodies, 12)
    shape, _ = next(frames)
    labels = np.repeat(np.arange(bodies), LEDS)
    tracker = rm.Tracker(np.tile(shape, (bodies, 1)), rm.P3P(CAMERA), noise=0.3, bodies=labels)
    names = []
    for k, (target, owner) in enumerate(frames):
        match = tracker.update(target, time=k / 60.0)
        names.append(owners(match, owner))
        if k > 1:
            assert all(match.bodies.values()), k
    assert sorted(names[0], key=min) == [{k} for k in range(bodies)]
    assert all(one == names[0] for one in names)


def test_of_more_bodies_than_are_in_view_some_are_named() -> None:
    frames = flight(4, 2, 12)
    shape, _ = next(frames)
    tracker = rm.Tracker(np.tile(shape, (4, 1)), rm.P3P(CAMERA), noise=0.3, bodies=np.repeat(np.arange(4), LEDS))
    for k, (target, owner) in enumerate(frames):
        match = tracker.update(target, time=k / 60.0)
        assert match.bodies is not None
        named = [label for label, body in match.bodies.items() if body]
        assert len(named) == (2 if k > 1 else len(named))
        assert sorted(one for one in owners(match, owner) if one) in ([{0}, {1}], [{1}, {0}]) or k < 2


@pytest.mark.parametrize("given", [2, 3])
def test_tools_in_space(given: int) -> None:
    """Two tools of five markers among strays; of three given ones two are named."""
    rng = np.random.default_rng(5)
    shape = rng.uniform(-0.05, 0.05, (5, 3))
    labels = np.repeat(np.arange(given), 5)
    tracker = rm.Tracker(np.tile(shape, (given, 1)), rm.Rigid(3), noise=0.0003, bodies=labels)
    for k in range(8):
        turn = Rotation.from_rotvec([0.1 * k, 0.05 * k, 0.3]).as_matrix()
        target = np.concatenate(
            [shape @ turn.T + (-0.2, 0.002 * k, 1.0), shape @ turn + (0.2, 0.0, 1.1), rng.uniform(-0.5, 1.5, (3, 3))]
        )
        target[:10] += rng.normal(0.0, 0.0003, (10, 3))
        match = tracker.update(target, time=k / 60.0)
        assert match.bodies is not None
        matched = [body for body in match.bodies.values() if body]
        if k > 1:
            assert len(matched) == 2
            assert sorted(body.assignment.min() // 5 for body in matched) == [0, 1]
            assert all((body.assignment >= 0).all() for body in matched)


def test_what_is_identical() -> None:
    rng = np.random.default_rng(3)
    one, normals = rng.uniform(-1.0, 1.0, (6, 3)), rng.normal(size=(6, 3))
    order = rng.permutation(6)
    turned = Rotation.from_rotvec([0.3, 0.0, 0.0]).as_matrix()
    points = np.concatenate([one, one[order], one * (-1.0, 1.0, 1.0), one @ turned.T])
    labels = check_bodies(np.repeat(["a", "b", "mirror", "turned"], 6), points, 4)
    assert find_identical_bodies(labels, points, None) == [["a", "b"]]
    facing = np.concatenate([normals, normals[order], normals, normals])
    assert find_identical_bodies(labels, points, facing) == [["a", "b"]]
    facing[6] *= -1.0
    assert find_identical_bodies(labels, points, facing) == []


@pytest.mark.parametrize("height", [0.0, 25.0])
@pytest.mark.parametrize("stray", [0, 2])
def test_one_of_two_identical_tools_in_space_may_be_either(height: float, stray: int) -> None:
    """Neither could be chance, and nothing is left-handed."""
    tool = np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [0.0, 90.0, 0.0], [60.0, 130.0, height]])
    rng = np.random.default_rng(stray)
    seen = tool @ Rotation.from_rotvec([0.3, 0.2, 1.0]).as_matrix().T + (10.0, 20.0, 1200.0)
    seen = np.vstack([seen, rng.uniform((-200.0, -200.0, 1000.0), (200.0, 200.0, 1400.0), (stray, 3))])
    both = np.vstack([tool, tool])
    labels = ["a"] * 4 + ["b"] * 4
    match = rm.match(both, seen + rng.normal(0.0, 0.2, seen.shape), rm.Rigid(), noise=(0.0, 0.2), bodies=labels)
    assert match.bodies is not None
    assert {one.status for one in match.bodies.values()} == {rm.Status.AMBIGUOUS}
    for one in match.bodies.values():
        assert "2 bodies are identical, and no measurement tells which is where" in one.advice
        places = [one.assignment, *(other for other, _ in one.alternatives)]
        assert any(np.array_equal(place, np.arange(4)) for place in places)


@pytest.mark.parametrize("height", [0.0, 25.0])
def test_a_tool_that_left_is_not_told_to_be_left_handed_for_its_twin(height: float) -> None:
    tool = np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [0.0, 90.0, 0.0], [60.0, 130.0, height]])
    told = rm.TrackingOptions(interval=0.01)
    tracker = rm.Tracker(
        np.vstack([tool] * 2), rm.Rigid(), noise=(0.0, 0.2), bodies=["a"] * 4 + ["b"] * 4, tracking=told
    )
    for frame in range(100):
        rng, turn = np.random.default_rng(frame), 0.01 * frame
        seen = [tool @ Rotation.from_rotvec([0.3, 0.2, 1.0 + turn]).as_matrix().T + (150.0, 20.0, 1200.0)]
        if frame < 50:
            seen.append(tool @ Rotation.from_rotvec([0.1, 0.5, turn - 1.0]).as_matrix().T + (-150.0, 20.0, 1300.0))
        elif frame % 3 == 0:
            seen.append(rng.uniform((-200.0, -200.0, 1000.0), (200.0, 200.0, 1400.0), (1, 3)))
        measured = np.vstack(seen)
        match = tracker.update(measured + rng.normal(0.0, 0.2, measured.shape), time=frame / 100.0)
        assert match.bodies is not None
        assert not any("left-handed" in one.advice for one in match.bodies.values())
