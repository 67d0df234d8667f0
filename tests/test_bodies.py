"""Several rigid bodies of known labels in one image."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain.bodies import _Body, _contest, _make_exclusive
from rootmatch.explain.body_labels import twin_points
from rootmatch.explain.decide import Facts
from rootmatch.explain.explain import explain
from rootmatch.explain.finding import Finding
from rootmatch.explain.task import MatchingTask

CAMERA = rm.Camera(800.0, 800.0, 320.0, 240.0)
MIRROR = np.array([-1.0, 1.0, 1.0])


def judged(found: Finding, status: rm.Status, probability: float | None = None) -> Finding:
    """A finding with facts from which a status follows."""
    facts = {
        rm.Status.MATCHED: Facts(sure_of_the_rest=True),
        rm.Status.AMBIGUOUS: Facts(missed=1.0),
        rm.Status.UNTRUSTED: Facts(confirmed=False),
    }[status]
    one = replace(found, facts=replace(facts, probability=probability))
    assert one.status is status
    return one


def pose(seed: int, x: float, distance: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q)), np.array([x, 0.1, distance])


def image(
    bodies: list[NDArray[np.float64]], distance: float, clutter: int, seed: int, noise: float = 0.3
) -> tuple[NDArray[np.float64], list[NDArray[np.int64]], list[tuple[Any, Any]]]:
    """Detections, where those of each body are among them, and the poses."""
    rng = np.random.default_rng(seed)
    poses = [pose(seed + k, 0.6 * k - 0.3, distance) for k in range(len(bodies))]
    pixels = [CAMERA.project(body @ R.T + t) for body, (R, t) in zip(bodies, poses, strict=True)]
    target = np.vstack([*pixels, rng.uniform((0.0, 0.0), (640.0, 480.0), (clutter, 2))])
    target += rng.normal(0.0, noise, target.shape)
    order = rng.permutation(len(target))
    where = np.argsort(order)
    ends = np.cumsum([len(body) for body in bodies])
    return target[order], [where[end - len(b) : end] for b, end in zip(bodies, ends, strict=True)], poses


def body(seed: int, points: int = 7) -> NDArray[np.float64]:
    return np.random.default_rng(seed).uniform(-0.3, 0.3, (points, 3))


def test_each_body_is_matched_by_itself_and_no_detection_is_used_twice() -> None:
    first, second = body(1), body(2)
    target, truth, poses = image([first, second], 3.0, clutter=2, seed=5)
    labels = np.array(["hmd"] * 7 + ["left"] * 7)
    order = np.random.default_rng(3).permutation(14)  # bodies need not lie one after another
    source = np.concatenate([first, second])[order]
    match = rm.match(source, target, rm.P3P(CAMERA), noise=0.3, bodies=labels[order])
    assert match.status is rm.Status.MATCHED
    assert match.bodies is not None
    assert np.array_equal(match.assignment, np.concatenate(truth)[order])
    assert list(match.bodies) == list(dict.fromkeys(labels[order].tolist()))
    for label, expected, (R, t) in zip(("hmd", "left"), truth, poses, strict=True):
        own = match.bodies[label]
        mine = labels[order] == label
        assert own.status is rm.Status.MATCHED
        assert np.array_equal(own.assignment, expected[order[mine] % 7])
        assert own.poses[0].chi2 < 40.0
        del R, t
    assert repr(match).startswith("Match(MATCHED, 14 of 14 points, probability 0.99")
    assert ", hmd: Match(MATCHED, 7 of 7 points, probability 0.99" in repr(match)
    assert match.probability == pytest.approx(np.prod([own.probability for own in match.bodies.values()]))
    assert np.array_equal(match.motion_labels, [list(match.bodies).index(label) for label in labels[order]])
    # the hyper-edges are within bodies
    i, j = np.divmod(match.tensor.indices.astype(int), len(target))
    assert (labels[order][i] == labels[order][i][:, :1]).all()
    assert j.max() < len(target)


def test_a_body_that_is_not_there_leaves_the_others_trusted() -> None:
    first, second = body(1), body(2)
    target, (expected,), _ = image([first], 3.0, clutter=4, seed=6)
    matcher = rm.Matcher(np.concatenate([first, second]), rm.P3P(CAMERA), noise=0.3, bodies=[0] * 7 + [1] * 7)
    match = matcher.match(target)
    assert match.bodies is not None
    assert match.bodies[0].status is rm.Status.MATCHED
    assert np.array_equal(match.bodies[0].assignment, expected)
    assert match.bodies[1].status is not rm.Status.MATCHED
    assert match.status is match.bodies[1].status
    used = match.assignment[match.assignment >= 0]
    assert len(set(used.tolist())) == len(used)


def test_a_mirror_image_is_ambiguous_from_far_unless_normals_tell() -> None:
    shape = body(4)
    twin = shape * MIRROR
    target, (expected,), ((R, t),) = image([shape], 30.0, clutter=0, seed=7, noise=0.1)
    source, labels = np.concatenate([shape, twin]), [0] * 7 + [1] * 7
    match = rm.match(source, target, rm.P3P(CAMERA), noise=0.1, bodies=labels)
    assert match.bodies is not None
    assert rm.Status.MATCHED not in [own.status for own in match.bodies.values()]
    towards = np.broadcast_to(-R.T @ t, shape.shape)
    normals = np.concatenate([towards, towards * MIRROR])
    match = rm.match(
        source, target, rm.P3P(CAMERA), noise=0.1, bodies=labels, normals=normals, view_angle=np.radians(70.0)
    )
    assert match.bodies is not None
    assert match.bodies[0].status is rm.Status.MATCHED
    assert np.array_equal(match.bodies[0].assignment, expected)
    assert (match.bodies[1].assignment < 0).all()
    assert match.bodies[1].status is rm.Status.UNTRUSTED


def test_twins_are_found_whatever_the_order_of_their_points() -> None:
    shape = body(4)
    order = np.random.default_rng(0).permutation(7)
    R, t = pose(1, 2.0, 3.0)
    found = twin_points(shape, ((shape * MIRROR) @ R.T + t)[order])
    assert found is not None
    assert np.array_equal(order[found], np.arange(7))
    assert twin_points(shape, body(5)) is None
    assert twin_points(shape, shape[1:]) is None


def test_a_board_is_sought_until_its_search_has_missed_nothing_even_if_another_one_fits_in_several_ways() -> None:
    """A short search for the second meets half of the points of the first, in places that explain as much."""
    rng, camera = np.random.default_rng(2), rm.Camera(1600.0, 1600.0, 720.0, 540.0)
    boards = [
        np.array([(30.0 * x, 30.0 * y, 0.0) for y in range(5) for x in range(7)]),
        np.array([(40.0 * x + 20.0 * (y % 2), 20.0 * y, 0.0) for y in range(11) for x in range(4)]),
    ]
    pixels = []
    for k, board in enumerate(boards):
        angles = [rng.uniform(-180.0, 180.0), *rng.uniform(-35.0, 35.0, 2)]
        R = Rotation.from_euler("zyx", angles, degrees=True).as_matrix() * (1.0, -1.0, -1.0)
        t = np.array([150.0 * (-1) ** k, 0.0, rng.uniform(440.0, 850.0)])
        pixels.append(camera.project((board - board.mean(axis=0)) @ R.T + t))
    pixels = [one[rng.random(len(one)) < 0.94] for one in pixels]
    target = np.concatenate([*pixels, rng.uniform((0.0, 0.0), (1440.0, 1080.0), (3, 2))])
    target += rng.normal(0.0, 0.15, target.shape)
    labels = np.repeat([0, 1], [35, 44])
    match = rm.match(np.concatenate(boards), target, rm.P3P(camera), noise=0.15, bodies=labels)
    assert match.bodies is not None
    first, second = (set(one.assignment[one.assignment >= 0].tolist()) for one in match.bodies.values())
    shown = len(pixels[0]), len(pixels[0]) + len(pixels[1])
    assert first <= set(range(shown[0]))
    assert second <= set(range(*shown))
    assert len(second) > 0.9 * len(pixels[1])
    assert all(one.status is rm.Status.AMBIGUOUS for one in match.bodies.values())  # each looks the same half a turn on


def test_what_is_searched_again() -> None:
    shape = body(1)
    target, (expected,), _ = image([shape], 3.0, clutter=4, seed=6)
    task = MatchingTask.of(rm.P3P(CAMERA), shape, target, noise=0.3, bodies=[0] * 7)
    found = replace(explain(task.each_body[0]), others=[], scores=None)
    free = np.ones(len(target), np.bool_)
    clutter, own = free.copy(), free.copy()
    clutter[np.setdiff1d(np.arange(len(target)), expected)[0]] = False  # another body has taken that detection
    own[expected[0]] = False

    def searched(status: rm.Status, cut: bool, probability: float = 1.0) -> list[bool]:
        match = judged(found, status, probability)
        one = _Body(number=0, task=match.task, found=match, budget=100, cut=cut, among=len(target))
        return [one.is_worth_searching(left, budget) for left in (free, clutter, own) for budget in (100, 300)]

    untrusted, ambiguous = rm.Status.UNTRUSTED, rm.Status.AMBIGUOUS
    # (free, clutter taken, own taken) × (same budget, larger budget)
    assert searched(untrusted, cut=False) == [False, False, True, True, True, True]
    assert searched(untrusted, cut=True) == [False, True, True, True, True, True]
    assert searched(ambiguous, cut=True, probability=0.95) == [False, True, True, True, True, True]
    assert searched(ambiguous, cut=True, probability=0.5) == [False, False, True, True, True, True]
    assert searched(ambiguous, cut=False, probability=0.5) == [False, False, False, False, True, True]
    new = _Body(number=0, task=found.task, found=found)
    assert new.is_worth_searching(free, 100)
    new.settled = True
    assert not new.is_worth_searching(own, 300)


def test_of_two_bodies_that_are_not_sure_the_likelier_keeps_the_detections() -> None:
    """The second has stolen six of the detections of the first, whose matches are ambiguous between two poses."""
    first, second = body(1), body(2)
    target, (expected, other), _ = image([first, second], 3.0, clutter=2, seed=5)
    task = MatchingTask.of(rm.P3P(CAMERA), np.concatenate([first, second]), target, noise=0.3, bodies=[0] * 7 + [1] * 7)
    right, own = (explain(task.each_body[k]) for k in range(2))
    assert np.array_equal(right.assignment, expected)
    stolen = replace(judged(own, rm.Status.MATCHED, 0.93), assignment=np.append(expected[:6], -1), log_odds=1.0)
    ambiguous = judged(right, rm.Status.AMBIGUOUS, 0.55)
    bodies = [_Body(number=k, task=one.task, found=one) for k, one in enumerate((ambiguous, stolen))]
    assert bodies[0].evidence > bodies[1].evidence
    assert _Body(number=0, task=right.task, found=replace(right, log_odds=None)).evidence == -np.inf
    _make_exclusive(task, bodies, np.ones(len(target), np.bool_), explain, 1000)
    for one, there in zip(bodies, (expected, other), strict=True):
        assert np.array_equal(one.found.assignment, there)
    _contest(alone := [_Body(number=1, task=own.task, found=judged(own, rm.Status.MATCHED))])
    assert alone[0].found.status is rm.Status.MATCHED


@pytest.mark.parametrize(
    ("labels", "text"),
    [
        ([0, 1], r"shape \(2,\) given"),
        ([0.5] * 8, "labels of type float64"),
        ([True] * 8, "labels of type bool"),
        ([None] * 8, "labels of type object"),
        (["a"] * 5 + ["b"] * 3, "body 'b' has 3 points; give it at least 4"),
    ],
)
def test_labels_that_cannot_be_used(labels: Any, text: str) -> None:
    with pytest.raises(rm.InputError, match=text):
        rm.match(body(1, 8), np.zeros((5, 2)) + np.arange(5)[:, None], rm.P3P(CAMERA), bodies=labels)


@pytest.mark.parametrize("options", [{"motions": 2}, {"noise": "auto"}])
def test_options_that_do_not_go_with_bodies(options: dict[str, Any]) -> None:
    with pytest.raises(rm.InputError, match=next(iter(options))):
        rm.match(body(1, 8), np.zeros((5, 2)) + np.arange(5)[:, None], rm.P3P(CAMERA), bodies=[0] * 8, **options)
