"""From a task and its assignments to a status by the model of the image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from posteriors import told_of
from rootmatch.explain.finding import make_empty_finding
from rootmatch.explain.image_decision import image_finding, is_modelled
from rootmatch.explain.image_hypotheses import Candidate, make_detection_model
from rootmatch.explain.task import MatchingTask
from rootmatch.model.pose_density import Broad, Doubted, Gaussian
from rootmatch.model.posterior import Posterior

CAMERA = rm.Camera(800.0, 800.0, 640.0, 480.0)
Floats = NDArray[np.float64]


def believed(task: MatchingTask, told: Posterior) -> tuple[rm.Status, NDArray[np.int64]]:
    """Status and assignment that a posterior leads to."""
    found = image_finding(make_empty_finding(task, ""), told, Candidate.of(task, []))
    return found.status, found.assignment


def scene(seed: int, clutter: int = 6) -> tuple[Floats, Floats, NDArray[np.int64], Floats, Floats]:
    """Points of a body of 12 cm, detections, the true assignment, rotation and translation."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.06, 0.06, (8, 3))
    R, t = Rotation.random(random_state=rng).as_matrix(), np.array([0.05, -0.02, 0.7])
    places = points @ R.T + t
    pixels = places[:, :2] / places[:, 2:] * 800.0 + (640.0, 480.0)
    target = np.concatenate([pixels, rng.uniform((0, 0), (1280, 960), (clutter, 2))])
    return points, target + rng.normal(0.0, 0.4, target.shape), np.arange(8), R, t


@pytest.mark.parametrize("kind", ["p3p", "up2p", "rig"])
def test_a_body_in_view_is_believed(kind: str) -> None:
    points, target, truth, R, t = scene(1000)
    problem = rm.P3P(CAMERA)
    if kind == "up2p":
        problem = rm.UP2P(CAMERA, (0.0, 1.0, 0.0), R.T @ [0.0, 1.0, 0.0], vertical_noise=0.01)
    if kind == "rig":
        away = np.array([-0.1, 0.0, 0.0])
        problem = rm.P3P(rm.Rig([(CAMERA, np.eye(3), np.zeros(3)), (CAMERA, np.eye(3), away)]))
        places = points @ R.T + t + away
        pixels = places[:5, :2] / places[:5, 2:] * 800.0 + (640.0, 480.0)
        target = np.column_stack([np.concatenate([target, pixels]), np.repeat([0, 1], [len(target), 5])])
        truth = np.concatenate([truth, [14, 15, 16, 17, 18, -1, -1, -1]])
    task = MatchingTask.of(problem, points, target, noise=0.4)
    assert is_modelled(task)
    part = truth.copy()
    part[2] = -1
    (told,) = told_of((task, [part]))
    status, assignment = believed(task, told)
    assert status is rm.Status.MATCHED
    np.testing.assert_array_equal(assignment, truth)
    assert told.clutter < 1e-3


def test_the_pose_is_that_of_the_points_as_given() -> None:
    points, target, truth, R, t = scene(1001)
    points = points + np.array([3.0, -1.0, 2.0])
    t = t - R @ (3.0, -1.0, 2.0)
    task = MatchingTask.of(rm.P3P(CAMERA), points, target, noise=0.4)
    (told,) = told_of((task, [truth]))
    rotation, position = make_detection_model(task).centred(R, t)
    off = np.concatenate(
        [Rotation.from_matrix(told.modes.rotation[0] @ rotation.T).as_rotvec(), told.modes.position[0] - position]
    )
    assert off @ np.linalg.solve(told.modes.covariance[0], off) < 22.5  # of six degrees of freedom, one in a thousand


def test_unrelated_points_are_untrusted() -> None:
    for seed in range(1000, 1004):
        points, _, truth, _, _ = scene(seed)
        target = np.random.default_rng(seed).uniform((0, 0), (1280, 960), (14, 2))
        task = MatchingTask.of(rm.P3P(CAMERA), points, target, noise=0.4)
        some = np.where(truth < 4, truth, -1)
        (told,) = told_of((task, [truth, some, np.roll(some, 2)]))
        assert believed(task, told)[0] is rm.Status.UNTRUSTED


def test_of_a_body_and_its_mirror_image_one_is_believed() -> None:
    points, target, truth, _, _ = scene(1002)
    here = MatchingTask.of(rm.P3P(CAMERA), points, target, noise=0.4)
    there = MatchingTask.of(rm.P3P(CAMERA), points * (-1.0, 1.0, 1.0), target, noise=0.4)
    # the wrong one was found alone: the right one is proposed as its look-alike
    told = told_of((here, []), (there, [truth]))
    assert believed(here, told[0])[0] is rm.Status.MATCHED
    assert believed(there, told[1])[0] is rm.Status.UNTRUSTED


def test_nothing_proposed_is_nothing_believed() -> None:
    points, target, _, _, _ = scene(1000)
    task = MatchingTask.of(rm.P3P(CAMERA), points, target, noise=0.4)
    (told,) = told_of((task, [np.full(8, -1)]))
    status, assignment = believed(task, told)
    assert status is rm.Status.UNTRUSTED
    assert (assignment == -1).all()
    assert not len(told.probabilities)


def test_weights_of_candidates_count() -> None:
    points, target, truth, _, _ = scene(1003)
    target = np.vstack([target, target[3] + 0.05])
    weights = np.ones((8, len(target)))
    weights[3, 3] = 1e-3
    task = MatchingTask.of(rm.P3P(CAMERA), points, target, noise=0.4, candidates=weights)
    (told,) = told_of((task, [truth]))
    assert told.modes.assignments[0][3] == len(target) - 1
    assert told.confidence[3] > 0.9


def test_min_probability_is_the_threshold() -> None:
    """Of two detections of one point neither is sure: with a low threshold one of them is told, else none."""
    points, target, truth, _, _ = scene(1004, clutter=0)
    target = np.vstack([target, target[3] + (0.7, 0.0)])
    told = [rm.match(points, target, rm.P3P(CAMERA), noise=0.4, min_probability=minimum) for minimum in (0.3, None)]
    assert [match.status is rm.Status.MATCHED for match in told] == [True, True]
    assert [match.assignment[3] >= 0 for match in told] == [True, False]
    np.testing.assert_array_equal(np.delete(told[1].assignment, 3), np.delete(truth, 3))
    points, target, _, _, _ = scene(1004, clutter=6)
    given = points[:5], target, rm.P3P(CAMERA)
    few = rm.match(*given, noise=0.4, min_probability=0.3)
    present = few.finding.facts.present
    assert present is not None
    assert 0.3 < present < 0.999
    above = rm.match(*given, noise=0.4, min_probability=0.5 * (present + 0.999))
    assert few.status is not rm.Status.UNTRUSTED
    assert above.status is rm.Status.UNTRUSTED


def test_a_wrong_prediction_is_judged_by_what_is_known_without_it() -> None:
    spread = np.diag([0.01] * 3 + [0.02] * 3) ** 2
    prediction = Gaussian(np.eye(3), np.array([0.0, 0.0, 1.0]), spread)
    mixture = Doubted([prediction], [np.log(0.99)], Broad(), 0.01)
    rotation = Rotation.from_rotvec([[0.0, 0.0, 0.01], [0.0, 0.0, 1.0]]).as_matrix()
    position = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    found, broad = mixture.terms(rotation, position), Broad().terms(rotation, position)
    np.testing.assert_array_equal(mixture.prediction_indices(rotation, position), [0, -1])
    assert found.log_density[1] == pytest.approx(broad.log_density[1] + np.log(0.01))
    share = np.log(0.99) + prediction.log_gain(Broad().radius)
    assert found.log_density[0] == pytest.approx(prediction.terms(rotation, position).log_density[0] + share)
    np.testing.assert_array_equal(found.precision[1], broad.precision[1])


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_mirror_image_takes_nothing_before_the_body_was_searched_for(order: tuple[int, int]) -> None:
    """Whichever is searched for first, the one in view is found, and the other one has none of its detections."""
    points, target, truth, _, _ = scene(1005, clutter=4)
    both = [points, points * (-1.0, 1.0, 1.0)]
    source = np.concatenate([both[k] for k in order])
    match = rm.match(source, target, rm.P3P(CAMERA), noise=0.4, bodies=np.repeat(order, 8))
    assert match.bodies is not None
    assert match.bodies[0].status is rm.Status.MATCHED
    np.testing.assert_array_equal(match.bodies[0].assignment, truth)
    assert match.bodies[1].status is rm.Status.UNTRUSTED
    assert not np.isin(match.bodies[1].assignment, truth[truth >= 0]).any()
    assert match.bodies[1].probability < 0.05


@pytest.mark.parametrize("kind", ["few", "large"])
def test_what_is_trusted_has_the_probability_that_is_told(kind: str) -> None:
    """Of matches that are doubtful one by one, and of so many that they are hardly right together."""
    trusted = 0
    for seed in (1107, 1113) if kind == "few" else (1001,):
        rng = np.random.default_rng(seed)
        n, clutter = (8, 12) if kind == "few" else (150, 150)
        points, t = rng.uniform(-0.4, 0.4, (n, 3)), np.array([0.0, 0.0, 1.6])
        pixels = CAMERA.project(points + t)[rng.random(n) < 0.85]
        pixels = pixels + rng.normal(0.0, 1.0, pixels.shape)
        low, high = pixels.min(axis=0) - 60.0, pixels.max(axis=0) + 60.0
        target = np.concatenate([pixels, rng.uniform(low, high, (clutter, 2))])
        prior = rm.Pose(np.eye(3), t, np.diag([0.02] * 3 + [0.03] * 3) ** 2)
        found = rm.match(points, target, rm.P3P(CAMERA), noise=1.0, prior=prior)
        if found:
            trusted += 1
            assert found.probability is not None
            assert found.probability >= 0.95
            assert found.confidence[found.assignment >= 0].min() >= 0.95
    assert trusted > 0


@pytest.mark.parametrize("seed", [1003, 1004])
def test_points_outside_of_an_image_of_known_size_are_not_missing(seed: int) -> None:
    """Five of twelve points are in view, among six of clutter: too few if the others should have been seen."""
    rng, R = np.random.default_rng(seed), Rotation.random(random_state=seed).as_matrix()
    points, size = rng.uniform(-0.3, 0.3, (12, 3)), (1280.0, 960.0)
    camera = rm.Camera(900.0, 900.0, 640.0, 480.0)
    pixels = camera.project(points @ R.T + (rng.choice([-1, 1]) * 0.72, rng.uniform(-0.2, 0.2), 1.0))
    seen = np.flatnonzero(((pixels > 0.0) & (pixels < size)).all(axis=1) & (rng.random(12) < 0.95))
    noisy = pixels[seen] + rng.normal(0.0, 0.4, (len(seen), 2))
    target = np.concatenate([noisy, rng.uniform((0.0, 0.0), size, (6, 2))])
    truth = np.full(12, -1)
    truth[seen] = np.arange(5)
    assert not rm.match(points, target, rm.P3P(camera), noise=0.4)
    match = rm.match(points, target, rm.P3P(replace(camera, size=size)), noise=0.4)
    assert match
    np.testing.assert_array_equal(match.assignment, truth)
