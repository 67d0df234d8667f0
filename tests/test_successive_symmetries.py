"""Near symmetries one after another, and the poses of a lattice that they lead to."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.arrays import Floats, Integers
from rootmatch.explain.image_hypotheses import Candidate, make_detection_model
from rootmatch.explain.task import MatchingTask
from rootmatch.model.near_symmetries import LAW, same_point_tolerance
from rootmatch.model.pose_density import Doubted
from rootmatch.model.proposals import Proposals
from rootmatch.model.successive_symmetries import (
    MAX_MOTIONS,
    compose_symmetries,
    displacements_within,
    propose_moved,
)
from rootmatch.problems.pose_fit.reference_point import pose_about_point

CAMERA = rm.Camera(250.0, 250.0, 640.0, 480.0)
ROWS, COLUMNS, SPACING = 9, 12, (1.2, 1.8)


def lamps(seed: int) -> Floats:
    """Lamps of a ceiling, a fifth of its places being empty."""
    rng = np.random.default_rng(seed)
    places = np.array(list(itertools.product(range(COLUMNS), range(ROWS))))
    return np.column_stack([places * SPACING, np.zeros(len(places))])[rng.random(len(places)) < 0.8]


def lamp_at(points: Floats, places: Floats) -> Integers:
    """The lamp (m,) at each of some places (m, 3), −1 for none."""
    off = np.linalg.norm(places[:, None] - points, axis=2)
    return np.where(off.min(axis=1) < 0.01, off.argmin(axis=1), -1)


def shown_with_another(points: Floats, across: float) -> tuple[Integers, Integers, Floats]:
    """A dozen lamps, others that lie to each other as these do, six steps away or more, and where the camera is."""
    for place in itertools.product(np.arange(1.5, COLUMNS - 2), np.arange(1.5, ROWS - 2)):
        middle = np.array([*place, 0.0]) * (*SPACING, 0.0)
        own = np.flatnonzero((np.abs(points - middle)[:, :2] < across * np.array(SPACING)).all(axis=1))
        for step in itertools.product(range(-COLUMNS, COLUMNS), range(-ROWS, ROWS)):
            other = lamp_at(points, points[own] + np.array([*step, 0.0]) * (*SPACING, 0.0))
            if np.abs(step).sum() >= 6 and (other >= 0).all():
                return own, other, middle
    raise AssertionError


def test_all_shifts_of_a_lattice_are_among_them() -> None:
    points = lamps(0)
    motions = compose_symmetries(points, None)
    straight = np.einsum("mii->m", motions.rotation) > 2.99
    images = {one.tobytes() for one in motions.image[straight]}
    assert len(motions.image) == len({one.tobytes() for one in motions.image}) < 2 * MAX_MOTIONS
    for step in itertools.product(range(-6, 7), range(-4, 5)):
        image = lamp_at(points, points + np.array([*step, 0.0]) * (*SPACING, 0.0))
        if max(map(abs, step)) > 3 and (image >= 0).sum() >= LAW:
            assert image.tobytes() in images
    moved = points @ motions.rotation.swapaxes(1, 2) + motions.shift[:, None]
    which, own = np.nonzero(motions.image >= 0)
    assert len(which) >= LAW * len(motions.image)
    assert np.linalg.norm(moved[which, own] - points[motions.image[which, own]], axis=1).max() < same_point_tolerance(
        points
    )


def test_a_body_with_one_half_turn_has_no_others() -> None:
    half = np.random.default_rng(3).uniform(-1.0, 1.0, (6, 3))
    assert not len(compose_symmetries(np.concatenate([half, half * (-1.0, -1.0, 1.0)]), None).image)
    assert not len(compose_symmetries(half, None).image)


def test_moved_poses_have_the_same_image() -> None:
    points = lamps(1)
    own, other, middle = shown_with_another(points, 1.6)
    centre = points.mean(axis=0)
    rotation = np.diag([1.0, -1.0, -1.0])
    camera = middle + np.array([0.3, 0.2, 1.6])
    assignment = np.full((1, len(points)), -1)
    assignment[0, own] = np.arange(len(own))
    found = Proposals(assignment, rotation[None], (rotation @ (centre - camera))[None])
    motions = compose_symmetries(points, None)
    moved = propose_moved(found, motions, motions.image, centre)
    image = CAMERA.project((points[own] - centre) @ rotation.T + found.position[0])
    for row, turned, place in zip(*moved, strict=True):
        (at,) = np.nonzero(row >= 0)
        assert 2 * len(at) > len(own)
        assert CAMERA.project((points[at] - centre) @ turned.T + place) == pytest.approx(image[row[at]], abs=1e-6)
    assert any((row[other] == np.arange(len(own))).all() for row in moved.assignments)


@pytest.mark.parametrize("seed", [1, 4])
def test_the_true_pose_of_a_ceiling_is_proposed_from_one_far_along_it(seed: int) -> None:
    """The lamps in view lie to each other as others do, with other gaps beside them."""
    points = lamps(seed)
    own, other, middle = shown_with_another(points, 1.6)
    rotation = np.diag([1.0, -1.0, -1.0])
    target = CAMERA.project((points[own] - middle - (0.3, 0.2, 1.6)) @ rotation.T)
    target = target + np.random.default_rng(seed).normal(0.0, 0.3, target.shape)
    task = MatchingTask.of(rm.P3P(CAMERA), points, target, noise=0.3)
    right, wrong = np.full((2, len(points)), -1)
    right[own] = wrong[other] = np.arange(len(own))
    modes = Candidate.of(task, [wrong]).modes
    assert (modes.assignments == right).all(axis=1).any()


BOARD = np.array([[30.0 * x, 30.0 * y, 0.0] for y in range(5) for x in range(7)])


def expected(spread: float, turned: float = 0.01) -> rm.Pose:
    """A pose that is known up to a distance and an angle."""
    covariance = np.diag([turned**2] * 3 + [spread**2] * 3)
    return rm.Pose(np.diag([1.0, -1.0, -1.0]), np.array([-90.0, 60.0, 600.0]), covariance)


@pytest.mark.parametrize(("spread", "turned", "steps"), [(1.0, 0.01, []), (4.0, 0.01, [1]), (8.0, 0.01, [1, 2, 3])])
def test_a_prediction_allows_what_lies_within_its_width(spread: float, turned: float, steps: list[int]) -> None:
    task = MatchingTask.of(rm.P3P(CAMERA), BOARD, BOARD[:9, :2], noise=0.3, prior=expected(spread, turned))
    prior = make_detection_model(task).prior
    assert isinstance(prior, Doubted)
    motions = displacements_within(prior, task.points)
    along = [] if motions is None else np.round(motions.shift[np.abs(motions.shift[:, 1]) < 1.0, 0] / 30.0, 6).tolist()
    assert sorted(along) == sorted(sign * step for step in steps for sign in (-1, 1))


def test_nothing_is_displaced_of_an_irregular_body() -> None:
    points = np.random.default_rng(2).uniform(-90.0, 90.0, (20, 3))
    task = MatchingTask.of(rm.P3P(CAMERA), points, BOARD[:9, :2], noise=0.3, prior=expected(50.0, 1.0))
    prior = make_detection_model(task).prior
    assert isinstance(prior, Doubted)
    assert displacements_within(prior, task.points) is None


def test_a_prior_as_wide_as_the_pitch_leaves_every_labelling_of_a_hidden_board() -> None:
    """A third is hidden by an edge, so that a column can be counted from elsewhere at the cost of few points."""
    camera, trusted, told = rm.Camera(1600.0, 1600.0, 720.0, 540.0), 0, 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        turn = Rotation.from_euler("zyx", rng.uniform((-180, -35, -35), (180, 35, 35)), degrees=True).as_matrix()
        R, centre = turn @ np.diag([1.0, -1.0, -1.0]), BOARD.mean(axis=0)
        middle = np.array([*rng.uniform(-30.0, 30.0, 2), rng.uniform(400.0, 800.0)])
        pixels = camera.project((BOARD - centre) @ R.T + middle)
        beyond = pixels @ [np.cos(across := rng.uniform(0.0, 2.0 * np.pi)), np.sin(across)]
        (own,) = np.nonzero(beyond > np.quantile(beyond, 0.35))
        target = np.concatenate([pixels[own], rng.uniform(0.0, (1440.0, 1080.0), (3, 2))])
        target += rng.normal(0.0, 0.15, target.shape)
        off = Rotation.from_rotvec(rng.normal(0.0, 0.05, 3)).as_matrix() @ R
        about = pose_about_point(np.eye(3), np.zeros(3), np.diag([0.05**2] * 3 + [15.0**2] * 3), -(off @ centre))
        prior = rm.Pose(off, middle + rng.normal(0.0, 15.0, 3) - off @ centre, about[1])
        match = rm.match(BOARD, target, rm.P3P(camera), noise=0.15, prior=prior)
        truth = np.full(len(BOARD), -1)
        truth[own] = np.arange(len(own))
        told += any((one == truth).mean() > 0.9 for one in (match.assignment, *(a for a, _ in match.alternatives)))
        if match:
            trusted += 1
            assert (match.assignment == truth).mean() > 0.9
    assert trusted >= 20
    assert told >= 38
