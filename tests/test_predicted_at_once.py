"""What a tracker does with a prediction in one compiled call, against the same step by step in NumPy."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from averaging_oracle import average_by_numpy
from rootmatch.cameras.base import CameraModel
from rootmatch.model import prediction
from rootmatch.model.compiled.averaging import project_out
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import kernel_mixture, residual_statistics, settle_likely, settle_poses, step_poses
from rootmatch.model.mode_search import find_modes
from rootmatch.model.pose_density import Broad, Doubted, Gaussian
from rootmatch.model.proposals import Proposals, join_proposals
from rootmatch.problems.pose_fit.reference_point import pose_about_point
from rootmatch.tracking.averaged_pose import average_pose
from test_compiled_model import FISHEYE, PINHOLE, SIZES, Floats, rig, scene
from test_settled import by_numpy

CAMERAS = {"normals": PINHOLE, "bare": FISHEYE, "rig": rig(SIZES)}


def predicted(name: str, seed: int, spread: float, shown: int) -> tuple[DetectionModel, Gaussian]:
    """A model whose first detections are some of the body's sightings, about a prediction that is off by its σ."""
    camera: CameraModel = CAMERAS[name]
    bare = {"normals": None, "view_cosine": None} if name == "bare" else {}
    model, R, position = scene(camera, seed=seed, poses=2, **bare)
    rng = np.random.default_rng(seed)
    deviations = spread * np.array([1.0, 1.0, 1.0, 0.3, 0.3, 0.3])
    off = deviations * rng.normal(size=6)
    truth = Rotation.from_rotvec(off[:3]).as_matrix() @ R[:1], position[:1] + off[3:]
    guess = Gaussian(R[0], position[0], np.diag(deviations**2))
    model = replace(model, prior=Doubted([guess], [np.log(0.99)], Broad(), 0.01))
    pixels, own = model.linearise_about(*truth).pixels[0], rng.permutation(model.shape[0])
    left = np.arange(model.shape[1])
    for i in own[:shown].tolist():
        image = i // 6 if name == "rig" else 0
        free = left[model.image_indices[left] == image]
        if not len(free):
            continue
        model.target[free[0]] = pixels[i] + rng.normal(0.0, model.sigma[free[0]], 2)
        left = left[left != free[0]]
    return replace(model), guess


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("spread", [0.003, 0.08])
def test_assignments_about_a_prediction(name: str, spread: float) -> None:
    made, torn = 0, 0
    for seed in range(1030, 1050):
        model, guess = predicted(name, seed, spread, shown=6)
        slow = by_numpy(model)
        assert model.scene_for_kernels is not None
        fast, oracle = prediction.propose_about(model, guess), prediction.propose_about(slow, guess)
        assert (fast is None) == (oracle is None)
        if fast is None or oracle is None:
            continue
        made += 1
        torn += len(fast.assignments) > 2
        np.testing.assert_array_equal(fast.assignments, oracle.assignments)
        np.testing.assert_allclose(fast.rotation, oracle.rotation, atol=1e-9)
        np.testing.assert_allclose(fast.position, oracle.position, atol=1e-9)
    assert made >= 12
    assert torn >= (1 if spread > 0.01 else 0)


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("size", [0.0, 0.004])
def test_poses_averaged_along_weak_directions(name: str, size: float) -> None:
    """With errors of the points, of which each match has one σ, nearly as with their covariances."""
    averaged = 0
    for seed in range(1030, 1050):
        model, guess = predicted(name, seed, 0.1, shown=3)
        start = prediction.propose_about(model, guess)
        if start is None:
            continue
        if size:
            model = replace(model, source_covariance=np.tile(size**2 * np.eye(3), (model.shape[0], 1, 1)))
        modes = find_modes(model, start.take(np.arange(1)))
        if not len(modes.log_odds):
            continue
        fast, (rotation, position, covariance) = average_pose(model, modes, 0), average_by_numpy(model, modes, 0)
        oracle = model.pose_of_origin(rotation, position, covariance)
        assert fast.covariance is not None
        assert oracle.covariance is not None
        if np.allclose(fast.R, modes.rotation[0], atol=1e-9):
            continue
        averaged += 1
        deviations = np.sqrt(np.diag(oracle.covariance))
        off = np.array([*Rotation.from_matrix(fast.R @ oracle.R.T).as_rotvec(), *(fast.t - oracle.t)])
        np.testing.assert_allclose(off / deviations, 0.0, atol=0.6 if size else 1e-6)
        unit = np.outer(deviations, deviations)
        np.testing.assert_allclose(fast.covariance / unit, oracle.covariance / unit, atol=0.3 if size else 1e-6)
    assert averaged >= 5


@pytest.mark.parametrize("weak", range(1, 7))
def test_a_step_without_its_part_along_lines(weak: int) -> None:
    """It has no part along the lines, and of such steps none leads to a better pose."""
    rng = np.random.default_rng(weak)
    rows = rng.normal(size=(8, 6))
    precision: Floats = rows.T @ rows
    duals, step = rng.normal(size=(6, weak)), rng.normal(size=6)
    across = step.copy()
    work = np.empty((6, 6)), np.empty((6, 6)), np.empty(6)
    project_out.py_func(duals, np.linalg.inv(precision), across, work)  # type: ignore[attr-defined]
    np.testing.assert_allclose(duals.T @ across, 0.0, atol=1e-8)
    free = np.linalg.svd(duals.T)[2][weak:]
    np.testing.assert_allclose(free @ precision @ (step - across), 0.0, atol=1e-8)


@pytest.mark.parametrize("seed", [1031, 1036, 1040])
def test_an_average_is_over_the_changes_of_the_assignment(seed: int) -> None:
    """Each change settled by itself, without what the mode knows of it: which of two points a detection is of."""
    model, guess = predicted("bare", seed, 0.004, shown=3)
    every = model.linearise_about(guess.rotation[None], guess.position[None]).pixels[0]
    apart = np.linalg.norm(every[:, None] - every, axis=2) + 1e9 * np.eye(len(every))
    pair = np.unravel_index(apart.argmin(), apart.shape)
    extra = int(np.flatnonzero(np.linalg.norm(model.target[:, None] - every, axis=2).min(axis=1) > 30.0)[0])
    model.target[extra] = every[list(pair)].mean(axis=0)
    model = replace(model)
    start = prediction.propose_about(model, guess)
    assert start is not None
    modes = find_modes(model, start.take(np.arange(1)))
    changed = modes.near[0][0]
    rows = np.concatenate([modes.assignments[:1], changed])
    turns = np.repeat(modes.rotation[:1], len(rows), axis=0), np.repeat(modes.position[:1], len(rows), axis=0)
    settled, at = settle_poses(by_numpy(model), rows, *turns)
    rotation, position = step_poses(settled, at)
    steps = np.hstack([Rotation.from_matrix(rotation @ modes.rotation[0].T).as_rotvec(), position - modes.position[0]])
    weight = np.exp(settled.log_odds - settled.log_odds.max())
    weight /= weight.sum()
    mean = weight @ steps
    spread = (weight[:, None] * (steps - mean)).T @ (steps - mean)
    pose = average_pose(model, modes, 0)
    place = pose.R @ model.centre + pose.t
    told = np.append(Rotation.from_matrix(pose.R @ modes.rotation[0].T).as_rotvec(), place - modes.position[0])
    assert pose.covariance is not None
    _, covariance = pose_about_point(pose.R, pose.t, pose.covariance, model.centre)
    deviations = np.sqrt(np.diagonal(modes.covariance[0]))
    assert weight.max() < 0.99, "more than one assignment counts"
    np.testing.assert_allclose(told / deviations, mean / deviations, atol=1e-3)
    unit = np.outer(deviations, deviations)
    np.testing.assert_allclose((covariance - modes.covariance[0]) / unit, spread / unit, atol=1e-3)


def test_what_is_all_matched_is_not_narrowed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three detections, one in the gate of each of three points, which fit: no other assignment is near."""
    narrowed, work = list[int](), prediction._narrow_by_pairs

    def counted(model: DetectionModel, looked: Any, covariance: Floats) -> Any:
        narrowed.append(np.count_nonzero(looked.candidates))
        return work(model, looked, covariance)

    monkeypatch.setattr(prediction, "_narrow_by_pairs", counted)
    matched = list[int]()
    for seed in range(1030, 1050):
        model, guess = predicted("bare", seed, 0.003, shown=3)
        found = prediction.propose_about(replace(model, target=model.target[:3], sigma=model.sigma[:3]), guess)
        matched += [] if found is None else [int((found.assignments[0] >= 0).sum())]
    assert matched.count(3) >= 5
    assert 3 not in narrowed


@pytest.mark.parametrize("name", CAMERAS)
def test_modes_to_which_proposals_add_nothing_are_handed_back(name: str) -> None:
    model, guess = predicted(name, 1031, 0.02, shown=6)
    start = prediction.propose_about(model, guess)
    assert start is not None
    modes = find_modes(model, start)
    assert find_modes(model, start.take(np.arange(1)), modes) is modes


def test_a_prediction_with_nothing_near(monkeypatch: pytest.MonkeyPatch) -> None:
    model, guess = predicted("normals", 1031, 0.003, shown=0)
    far = replace(model, target=model.target + 5000.0)
    for one in (far, by_numpy(far)):
        assert prediction.propose_about(one, guess) is None
    monkeypatch.setattr(prediction, "MAX_PAIRS", 1)
    for one in (model, by_numpy(model)):
        assert prediction.propose_about(one, guess) is None


def test_a_pose_with_nothing_possible_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fit of matches behind the camera has no average: it is handed on as it is."""
    model, guess = predicted("normals", 1033, 0.1, shown=3)
    start = prediction.propose_about(model, guess)
    assert start is not None
    modes = find_modes(model, start.take(np.arange(1)))
    unseen = modes._replace(position=modes.position * (1.0, 1.0, -1.0))
    for one in (model, by_numpy(model)):
        pose = average_pose(one, unseen, 0)
        assert np.isfinite(pose.R).all()


def test_proposals_are_of_their_own() -> None:
    """Two looks about one prediction share no memory."""
    model, guess = predicted("normals", 1035, 0.003, shown=6)
    first = prediction.propose_about(model, guess)
    assert isinstance(first, Proposals)
    before = first.assignments.copy()
    prediction.propose_about(model, guess)
    np.testing.assert_array_equal(first.assignments, before)


@pytest.mark.parametrize("name", CAMERAS)
def test_modes_of_proposals_that_repeat_others(name: str) -> None:
    """What ends in the minimum of another one is no mode, as in NumPy, where each is looked at."""
    repeated = 0
    for seed in range(1030, 1040):
        model, guess = predicted(name, seed, 0.02, shown=6)
        start = prediction.propose_about(model, guess)
        if start is None:
            continue
        turned = Rotation.from_rotvec([1e-3, 0.0, 0.0]).as_matrix() @ start.rotation
        proposals = join_proposals([start, Proposals(start.assignments, turned, start.position)])
        fast, oracle = find_modes(model, proposals), find_modes(by_numpy(model), proposals)
        repeated += len(fast.log_odds) < len(proposals.assignments)
        np.testing.assert_array_equal(fast.assignments, oracle.assignments)
        for one, other in zip(fast[1:-1], oracle[1:-1], strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4)
    assert repeated >= 5


@pytest.mark.parametrize("name", CAMERAS)
def test_what_is_hopeless_or_repeated_is_not_settled(name: str) -> None:
    model, guess = predicted(name, 1031, 0.02, shown=6)
    start = prediction.propose_about(model, guess)
    assert start is not None
    rows, rotation, position = start.take(np.zeros(3, np.int64))
    rotation[2] = Rotation.from_rotvec([0.4, 0.0, 0.3]).as_matrix() @ rotation[2]  # hopeless to first order
    prior, expected = kernel_mixture(model), settle_poses(by_numpy(model), rows[:1], rotation[:1], position[:1])
    assert prior is not None
    found, at, after = settle_likely(model, rows, (rotation, position), prior, (3.0, -np.inf, np.inf))
    assert np.isfinite(found.log_odds).tolist() == [True, False, False]
    assert found.log_odds[0] == pytest.approx(expected[0].log_odds[0], rel=1e-9)
    np.testing.assert_allclose(at.rotation[0], expected[1].rotation[0], atol=1e-9)
    for one, other in zip(after, step_poses(*expected), strict=True):
        np.testing.assert_allclose(one[0], other[0], atol=1e-9)
    every, _, _ = settle_likely(model, rows, (rotation, position), prior, (3.0, -np.inf, -np.inf))
    assert every.decrement[2] < 1.0 < found.decrement[2], "what is better than enough is fitted, however far behind"


@pytest.mark.parametrize("name", CAMERAS)
def test_residuals_about_a_pose(name: str) -> None:
    model, guess = predicted(name, 1032, 0.003, shown=6)
    start = prediction.propose_about(model, guess)
    assert start is not None
    of = start.assignments[0], start.rotation[0], start.position[0]
    np.testing.assert_allclose(residual_statistics(model, *of), residual_statistics(by_numpy(model), *of), rtol=1e-9)
