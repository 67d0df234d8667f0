"""Points that are off alike where they are near each other: something else of nearly the shape may have such errors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.arrays import Floats
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import settle_poses, weigh_poses
from rootmatch.model.mode_search import find_modes
from rootmatch.model.modes import Modes
from rootmatch.model.pose_density import Broad
from rootmatch.model.proposals import Proposals
from rootmatch.model.smooth_errors import smooth_error_log_odds
from rootmatch.problems.pose_fit.reference_point import body_radius

SIGMA = 0.2
CAMERA = rm.Camera(1200.0, 1200.0, 640.0, 480.0, size=(1280, 960))
AWAY = np.array((0.0, 0.0, 0.6))


def gear(teeth: int) -> Floats:
    """A gear of 10 cm, whose two marks tell how it is turned."""
    turn = 2.0 * np.pi * np.arange(teeth) / teeth
    ring = 0.1 * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(teeth)])
    return np.concatenate([ring, [(0.05, 0.0, 0.01), (0.0, 0.045, 0.01)]])


@pytest.mark.parametrize("seed", [1011, 1018])
def test_a_gear_is_not_one_with_another_tooth(seed: int) -> None:
    for teeth in (15, 16):
        rng = np.random.default_rng(seed)
        turn = Rotation.from_rotvec(rng.normal(0.0, math.radians(25.0), 3)) * Rotation.from_rotvec(
            (0.0, 0.0, rng.uniform(0.0, 2.0 * math.pi))
        )
        pixels = CAMERA.project(turn.apply(gear(teeth)) + AWAY)
        target = rng.permutation(pixels + rng.normal(0.0, SIGMA, pixels.shape))
        match = rm.match(gear(16), target, rm.P3P(CAMERA), noise=SIGMA)
        assert bool(match) == (teeth == 16)
        assert match or "an object of nearly the same shape" in match.advice


def bent(bend: float, matched: int) -> tuple[DetectionModel, Modes, float]:
    """A rod of twelve points of which one half is bent, the mode of the other, and its radius; ``bend``: per m."""
    rng = np.random.default_rng(2)
    body = np.column_stack([np.linspace(-0.15, 0.15, 12), rng.uniform(-0.02, 0.02, (12, 2))])
    shown = body + np.column_stack([np.zeros(12), bend * np.maximum(body[:, 0], 0.0) ** 2, np.zeros(12)])
    target = CAMERA.project(shown + AWAY) + rng.normal(0.0, SIGMA, (12, 2))
    model = DetectionModel(CAMERA, body, target, np.full(12, SIGMA), prior=Broad(), noise_freedom=1e9)
    assignment = np.where(np.arange(12) < matched, np.arange(12), -1)[None]
    _, at = settle_poses(model, assignment, np.eye(3)[None], (model.centre + AWAY)[None])
    modes = find_modes(model, Proposals(assignment, at.rotation, at.position))
    return model, modes.take(slice(1)), body_radius(body)


def test_the_evidence_is_that_of_a_gaussian_process() -> None:
    model, mode, radius = bent(0.0, 12)
    error = 0.01 * radius
    at = model.linearise_about(mode.rotation, mode.position)
    squares = ((model.points[:, None] - model.points) ** 2).sum(axis=2)
    wide = replace(model, source_covariance=np.tile(error**2 * np.eye(3), (12, 1, 1)))
    independent, _ = weigh_poses(wide, mode.assignments, mode.rotation, mode.position)
    rows, offset = at.jacobian[0].reshape(24, 6), (model.target - at.pixels[0]).ravel()
    any_pose = rows @ np.diag([0.3**2] * 6) @ rows.T
    densities = []
    for alike in (np.eye(12), np.exp(-0.5 * squares / radius**2)):
        moved = np.einsum("iac,jbc->iajb", at.by_position[0], at.by_position[0]) * alike[:, None, :, None]
        spread = error**2 * moved.reshape(24, 24) + SIGMA**2 * np.eye(24) + any_pose
        densities.append(stats.multivariate_normal(np.zeros(24), spread).logpdf(offset))
    (smooth,) = smooth_error_log_odds(model, mode, 0, np.array([error]))
    assert smooth - independent.log_odds[0] == pytest.approx(densities[1] - densities[0], abs=0.1)


def test_an_assignment_grows_along_a_bend() -> None:
    """The end of the rod is 4.5 cm off, beyond the points beside it, where independent errors would expect others."""
    model, mode, radius = bent(2.0, 6)
    assert (mode.assignments[0, 9:] < 0).all()
    few, far = smooth_error_log_odds(model, mode, 0, np.array([1e-4, 0.1]) * radius)
    assert far > few + 10.0
    none = replace(model, target=model.target + np.outer(np.arange(12) >= 6, (0.0, 300.0)))
    (left,) = smooth_error_log_odds(none, mode, 0, np.array([0.1]) * radius)
    assert far > left + 10.0
