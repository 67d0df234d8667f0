"""Poses that modes settle at where the image hardly tells some of the pose, against SciPy's least squares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain.image_hypotheses import Candidate
from rootmatch.explain.task import MatchingTask
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import (
    FAR,
    settle_evidence,
    settle_poses,
    squared_deviations,
    weigh_assignments,
    weigh_poses,
)
from rootmatch.model.known_density import Known
from rootmatch.model.proposals import rough_fits
from test_compiled_model import CASES, PINHOLE, SIZES, assignments_of, rig, scene

CAMERA = rm.Camera(700.0, 700.0, 640.0, 400.0)
SIGMA = 0.4


def wand(seed: int, strays: int = 2) -> tuple[MatchingTask, np.ndarray]:
    """Five LEDs nearly on a line and one aside, with stray detections."""
    rng = np.random.default_rng([seed, 5])
    line = np.column_stack([rng.normal(0.0, 0.004, (5, 2)), np.sort(rng.uniform(-0.3, 0.3, 5))])
    points = np.vstack([line, [0.06, 0.0, 0.1]])
    R, t = Rotation.random(random_state=rng).as_matrix(), np.array([*rng.uniform(-0.3, 0.3, 2), rng.uniform(0.8, 2.0)])
    pixels = np.vstack([CAMERA.project(points @ R.T + t), rng.uniform((200, 100), (1000, 700), (strays, 2))])
    order = rng.permutation(len(pixels))
    target = (pixels + rng.normal(0.0, SIGMA, pixels.shape))[order]
    return MatchingTask.of(rm.P3P(CAMERA), points, target, noise=SIGMA), np.argsort(order)[:6]


def min_chi2(task: MatchingTask, truth: np.ndarray, R: np.ndarray, position: np.ndarray) -> float:
    """The least χ² of an assignment, from a pose of the points' centre."""
    places = task.points.source - task.points.source.mean(axis=0)

    def residuals(x: np.ndarray) -> np.ndarray:
        turned = places @ (Rotation.from_rotvec(x[:3]).as_matrix() @ R).T + position + x[3:]
        return ((CAMERA.project(turned) - task.points.target[truth]) / SIGMA).ravel()

    return 2.0 * float(least_squares(residuals, np.zeros(6), xtol=1e-12, ftol=1e-12).cost)


@pytest.mark.parametrize("seed", range(12))
def test_of_nearly_collinear_points(seed: int) -> None:
    task, truth = wand(seed)
    modes = Candidate.of(task, [truth]).modes
    model = Candidate.of(task, []).model
    k = int(np.flatnonzero((modes.assignments == truth).all(axis=1))[0])
    R, position = modes.rotation[k], modes.position[k]
    chi2 = squared_deviations(model, truth[None], model.linearise_about(R[None], position[None]))[0]
    assert chi2 < min_chi2(task, truth, R, position) + FAR


def test_a_hypothesis_settles_as_it_does_by_itself() -> None:
    """Whatever the others need: those near their best pose are left as they are."""
    task, truth = wand(0)
    model, rng = Candidate.of(task, []).model, np.random.default_rng(0)
    rows = np.array([truth, *(rng.permutation(8)[:6] for _ in range(10))])
    proposals = rough_fits(model, rows)
    together, at = settle_evidence(model, proposals.assignments, *weigh_poses(model, *proposals))
    for k in range(3):
        one = proposals.take(np.array([k]))
        alone, there = settle_evidence(model, one.assignments, *weigh_poses(model, *one))
        if together.log_odds[k] < together.log_odds.max() - 30.0:
            continue
        np.testing.assert_allclose(at.rotation[k], there.rotation[0], atol=1e-9)
        assert together.log_odds[k] == pytest.approx(alone.log_odds[0], abs=1e-6)
    assert together.log_odds[0] > together.log_odds[1:].max()


def test_a_pose_far_from_the_best_one_is_not_weighed_for_another() -> None:
    """Five LEDs of a controller whose position is known: after eight steps a pose was 12° off, and counted as one."""
    points = np.array([[50.87, 3.8, 1.82], [25.92, -45.59, -0.58], [35.4, -28.65, 2.0], [16.08, -60.0, -28.26],
                       [10.15, -80.0, -30.11]]) * 1e-3  # fmt: skip
    target = np.array([[349.15, 765.47], [294.74, 719.21], [315.34, 734.0], [252.61, 727.04], [229.53, 711.64]])
    centre = points.mean(axis=0)
    prior = Known(rm.PosePrior(position=((-0.28, 0.244, 0.637), 0.05)), centre, 0.05)
    model = DetectionModel(rm.Camera(900.0, 900.0, 640.0, 480.0), points, target, np.full(5, 0.3), prior=prior)
    turns = Rotation.from_rotvec([[0.521, 0.617, -0.251], [0.994, 1.219, -0.1]]).as_matrix()
    places = np.array([[-0.272, 0.226, 0.733], [-0.25, 0.199, 0.738]]) + turns @ centre
    found, at = settle_poses(model, np.arange(5)[None].repeat(2, axis=0), turns, places)
    assert (found.decrement < FAR).all()
    assert found.log_odds[0] == pytest.approx(found.log_odds[1], abs=1e-2)
    np.testing.assert_allclose(at.rotation[0], at.rotation[1], atol=1e-3)


SHARED = {
    "rig, source noise": (rig(SIZES), {"source_covariance": np.tile(np.diag([1e-6, 2e-6, 4e-6]), (6, 1, 1))}),
    "blurred": (PINHOLE, {"target_covariance": np.tile([[0.9, 0.3], [0.3, 0.5]], (9, 1, 1))}),
}
"""Noise that axes or sightings of a point share."""


def by_numpy(model: DetectionModel) -> DetectionModel:
    """The same model, whose hypotheses are weighed and stepped one call after another."""
    slow = replace(model)
    vars(slow)["scene_for_kernels"] = None
    return slow


@pytest.mark.parametrize(
    "name", ["normals", "bare", "weights", "rig", "predicted", "source noise", "rig, source noise", "blurred"]
)
@pytest.mark.parametrize("count", [1, 5, 30])
def test_at_once_is_step_by_step(name: str, count: int) -> None:
    camera, more = (CASES | SHARED)[name]
    exact = 1e-3 if name == "blurred" else 1e-6  # of squared deviations of 10⁷, which cancel
    model, rotation, position = scene(camera, seed=1020, poses=count, **more)
    rows = assignments_of(model, count, 1021)
    rng = np.random.default_rng(1022)
    at = model.linearise_about(rotation, position)
    # half of them fit their detections, and are some steps away from their best poses
    for k in range(0, count, 2):
        used = rows[k] >= 0
        model.target[rows[k, used]] = at.pixels[k, used] + rng.normal(0.0, 0.5, (int(used.sum()), 2))
    rotation = Rotation.from_rotvec(rng.normal(0.0, 0.05, (count, 3))).as_matrix() @ rotation
    model, slow = replace(model), by_numpy(model)
    assert model.scene_for_kernels is not None
    for fast, oracle in zip(
        (weigh_poses(model, rows, rotation, position), settle_poses(model, rows, rotation, position)),
        (weigh_poses(slow, rows, rotation, position), settle_poses(slow, rows, rotation, position)),
        strict=True,
    ):
        for one, other in zip((*fast[0], *fast[1]), (*oracle[0], *oracle[1]), strict=True):
            if one is not None and other is not None:
                np.testing.assert_allclose(one, other, rtol=1e-6, atol=exact)
    found, there = settle_evidence(model, rows, *weigh_poses(model, rows, rotation, position))
    np.testing.assert_array_equal(found.log_odds, fast[0].log_odds)
    np.testing.assert_array_equal(there.rotation, fast[1].rotation)
    one_pose = model.linearise_about(rotation[:1], position[:1])
    for one, other in zip(
        weigh_assignments(model, rows, one_pose), weigh_assignments(slow, rows, one_pose), strict=True
    ):
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-9)
