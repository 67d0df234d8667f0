"""A body that shows only points on a line: both readings of it are weighed, and poses about it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain.image_hypotheses import make_detection_model
from rootmatch.explain.task import MatchingTask
from rootmatch.model.line_readings import TURNS, find_lines, propose_line_readings, turn_about_lines
from rootmatch.model.mode_search import find_modes
from rootmatch.model.proposals import Proposals

CAMERA = rm.Camera(800.0, 800.0, 320.0, 240.0)
WAND = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.12, 0.0, 0.0], [0.2, 0.0, 0.0], [0.09, 0.04, 0.02]])
NOISE = 0.2


def shown(seed: int, noise: float = NOISE, count: int = 4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The images of the first points of the wand, and its rotation and translation."""
    rng = np.random.default_rng([seed, 21])
    R, t = Rotation.random(random_state=rng).as_matrix(), np.array([0.02, 0.01, 0.8])
    return CAMERA.project(WAND[:count] @ R.T + t) + rng.normal(0.0, noise, (count, 2)), R, t


@pytest.mark.parametrize("seed", range(4))
def test_one_of_the_poses_is_the_true_one_but_for_a_turn_about_the_line(seed: int) -> None:
    target, R, t = shown(seed, noise=0.0)
    model = make_detection_model(MatchingTask.of(rm.P3P(CAMERA), WAND, target, noise=NOISE))
    row = np.array([0, 1, 2, 3, -1])
    found = propose_line_readings(model, row[None])
    assert len(found.assignments) == 2 * TURNS
    true = (found.assignments == row).all(axis=1)
    assert true.sum() == TURNS
    assert (found.assignments[~true] == [3, 2, 1, 0, -1]).all()
    places = found.position[true] - found.rotation[true] @ model.centre
    for rotation, place in zip(found.rotation[true], places, strict=True):
        np.testing.assert_allclose(WAND[:4] @ rotation.T + place, WAND[:4] @ R.T + t, atol=1e-6)
    beside = WAND[4] @ found.rotation[true].swapaxes(1, 2) + places
    assert np.ptp(beside, axis=0).max() > 0.03


def test_other_matches_of_images_on_a_line_are_read_along_it() -> None:
    """A search matched the point beside the line instead."""
    target, _, _ = shown(5, noise=0.0)
    model = make_detection_model(MatchingTask.of(rm.P3P(CAMERA), WAND, target, noise=NOISE))
    found = propose_line_readings(model, np.array([[2, -1, 0, 1, 3]]))
    assert (found.assignments == [0, 1, 2, 3, -1]).all(axis=1).any()
    assert (found.assignments == [3, 2, 1, 0, -1]).all(axis=1).any()


def test_nothing_is_read_where_no_points_are_on_a_line() -> None:
    target, _, _ = shown(6)
    bent = WAND + np.array([[0, 0, 0], [0, 0.03, 0], [0, 0, 0.03], [0, 0.02, 0], [0, 0, 0]])
    model = make_detection_model(MatchingTask.of(rm.P3P(CAMERA), bent, target, noise=NOISE))
    assert not len(propose_line_readings(model, np.array([[0, 1, 2, 3, -1]])).assignments)
    every = make_detection_model(MatchingTask.of(rm.P3P(CAMERA), WAND, shown(6, count=5)[0], noise=NOISE))
    assert not len(propose_line_readings(every, np.array([[0, 1, 2, 3, 4]])).assignments)


def test_lines_of_a_body() -> None:
    assert [line.tolist() for line in find_lines(WAND)] == [[0, 1, 2, 3]]
    rng = np.random.default_rng(0)
    assert find_lines(rng.normal(size=(100, 3))) == []


def test_no_reading_is_trusted_against_the_other() -> None:
    """Both fit, and which is right depends on the distances that are likely: of 30 images none is trusted wrongly."""
    told = []
    for seed in range(30):
        target, _, _ = shown(seed)
        match = rm.match(WAND, target, rm.P3P(CAMERA), noise=NOISE)
        if match:
            told.append(match.assignment.tolist())
        elif match.status is rm.Status.AMBIGUOUS:
            every = [match.assignment.tolist(), *(one.tolist() for one, *_ in match.alternatives)]
            assert [0, 1, 2, 3, -1] in every
    assert all(one == [0, 1, 2, 3, -1] for one in told)


@pytest.mark.parametrize("step", [0.02, 0.1, 0.3, 1.0])
def test_frames_far_apart_are_all_matched(step: float) -> None:
    """A prediction a tenth of a second ahead may miss by itself: no frame is waited for then."""
    rng, points = np.random.default_rng(1), np.random.default_rng(3).uniform(-0.15, 0.15, (8, 3))
    tracker = rm.Tracker(points, rm.P3P(CAMERA), noise=NOISE)
    for k in range(12):
        R = Rotation.from_rotvec([0.3, 0.5 + 0.02 * k, 0.1]).as_matrix()
        pixels = CAMERA.project(points @ R.T + [0.02, 0.01, 0.9]) + rng.normal(0.0, NOISE, (8, 2))
        order = rng.permutation(10)
        match = tracker.update(np.concatenate([pixels, rng.uniform(0.0, 480.0, (2, 2))])[order], time=k * step)
        assert match, k
        np.testing.assert_array_equal(order[match.assignment], np.arange(8))


@pytest.mark.parametrize("seed", range(4))
def test_what_is_beside_the_line_is_found_however_wrong_the_turn_was_predicted(seed: int) -> None:
    """By two radians: the matches on the line fit, and nothing but the point beside it tells."""
    target, R, t = shown(seed, count=5)
    axis = R @ (1.0, 0.0, 0.0)
    turned = Rotation.from_rotvec(2.0 * axis).as_matrix() @ R
    known = rm.Pose(turned, t, np.diag([0.1, 0.1, 0.1, 0.01, 0.01, 0.01]) ** 2)
    model = make_detection_model(MatchingTask.of(rm.P3P(CAMERA), WAND, target, noise=NOISE, prior=known))
    row = np.array([0, 1, 2, 3, -1])
    beside = Proposals(row[None], turned[None], (t + turned @ model.centre)[None])
    modes = find_modes(model, beside, minimum=-math.inf)
    assert (modes.assignments[0] == row).all()
    found = turn_about_lines(model, modes)
    whole = (found.assignments == np.arange(5)).all(axis=1)
    off = Rotation.from_matrix(found.rotation[whole] @ R.T).magnitude()
    assert off.min() < 0.2, "the prediction pulls"
    sure = modes._replace(covariance=1e-6 * modes.covariance)
    assert not len(turn_about_lines(model, sure).assignments)
    assert not len(turn_about_lines(model, find_modes(model, found.take(whole), minimum=-math.inf)).assignments)
