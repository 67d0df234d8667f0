"""Evidence with partial knowledge of a pose, from exact to vague, against integrals over poses that are drawn."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp
from scipy.stats import multivariate_t

import rootmatch as rm
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import settle_poses, step_poses
from rootmatch.model.known_density import Known
from rootmatch.model.pose_density import Broad, Doubted, Gaussian

Floats = NDArray[np.float64]
CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)
NOISE, DOUBT, FIELD, DEPTHS = 0.3, 0.01, 2.0, 100.0
BODY = np.random.default_rng(4).uniform(-0.08, 0.08, (4, 3))
CENTRE = BODY.mean(axis=0)
RADIUS = math.sqrt(((BODY - CENTRE) ** 2).sum(axis=1).mean())
SIGMAS = {
    "vertical": (0.0, 1e-3, 0.01, 0.1, 1.0),
    "rotation": (0.0, 1e-4, 1e-2, 0.1, 0.3),
    "position": (0.0, 1e-4, 1e-3, 0.01, 0.1, 0.3),
}
MINIMUM = {"vertical": 1e-4, "rotation": 1e-6, "position": 1e-6}


class Scene:
    """Four points a metre away: their image alone tells a pose to a few degrees and centimetres."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([seed, 91])
        self.R, self.t = Rotation.random(rng=rng).as_matrix(), np.array([0.1, -0.1, 1.0])
        self.target = CAMERA.project(BODY @ self.R.T + self.t) + rng.normal(0.0, NOISE, (4, 2))
        self.errors = rng.normal(size=3)

    def prior(self, kind: str, sigma: float) -> rm.PosePrior:
        """What is known, as wrong as it says; vague knowledge no more than by a tenth of what it is about."""
        off = min(sigma, 0.1) * self.errors
        turned = Rotation.from_rotvec(off).as_matrix() @ self.R
        if kind == "vertical":
            return rm.PosePrior(vertical=((0.0, 1.0, 0.0), turned[:, 1], sigma))
        return rm.PosePrior(**{kind: (turned if kind == "rotation" else self.t + off, sigma)})  # type: ignore[arg-type]

    def deviations(self, R: Floats, t: Floats) -> Floats:
        """Of the detections (…, 8), in units of the noise."""
        seen = BODY @ R.swapaxes(-1, -2) + t[..., None, :]
        pixels = 900.0 * seen[..., :2] / seen[..., 2:] + (640.0, 480.0)
        return ((pixels - self.target) / NOISE).reshape(*seen.shape[:-2], 8)


def broad(R: Floats, t: Floats) -> Floats:
    """Log density of any pose: its definition in docs/model.md."""
    reach2 = ((t + R @ CENTRE) ** 2).sum(axis=-1) + RADIUS**2
    return -math.log(8.0 * math.pi**2 * FIELD * math.log(DEPTHS)) - 1.5 * np.log(reach2)


def off_known(prior: rm.PosePrior, sigma: float, R: Floats, t: Floats) -> Floats:
    """How far poses are from what is known (…, 3), in standard deviations."""
    if prior.vertical is not None:
        return np.asarray((R[..., :, 1] - prior.vertical[1]) / sigma)
    if prior.rotation is not None:
        every = Rotation.from_matrix((prior.rotation[0] @ R.swapaxes(-1, -2)).reshape(-1, 3, 3)).as_rotvec()
        return np.asarray(every.reshape(*R.shape[:-2], 3) / sigma)
    assert prior.position is not None
    return np.asarray((t - prior.position[0]) / sigma)


def log_known(prior: rm.PosePrior, sigma: float, R: Floats, t: Floats) -> Floats:
    """Log density of poses by what is known and `broad`: their product over its integral, which is drawn."""
    value = broad(R, t) - 0.5 * (off_known(prior, sigma, R, t) ** 2).sum(axis=-1)
    if prior.vertical is not None:
        return np.asarray(value - math.log(-0.5 * sigma**2 * math.expm1(-2.0 / sigma**2)))
    if prior.rotation is not None:  # so precise that it is normal
        return np.asarray(value + math.log(8.0 * math.pi**2) - 1.5 * math.log(2.0 * math.pi * sigma**2))
    rng, place = np.random.default_rng(5), np.asarray(prior.position[0])  # type: ignore[index]
    turns, places = Rotation.random(100_000, rng=rng).as_matrix(), place + sigma * rng.normal(size=(100_000, 3))
    mean = logsumexp(broad(turns, places)) - math.log(100_000) + math.log(8.0 * math.pi**2)
    return np.asarray(value - mean - 1.5 * math.log(2.0 * math.pi * sigma**2))


def integral(scene: Scene, prior: rm.PosePrior | None = None, sigma: float = 1.0) -> tuple[float, Floats, Floats]:
    """Logarithm of the integral of likelihood and prior over poses near the true one, and the best pose of both."""

    def poses(steps: Floats) -> tuple[Floats, Floats]:
        turns = Rotation.from_rotvec(steps[..., :3].reshape(-1, 3)).as_matrix().reshape(*steps.shape[:-1], 3, 3)
        return turns @ scene.R, scene.t + steps[..., 3:]

    def residuals(step: Floats) -> Floats:
        off = scene.deviations(*poses(step))
        return off if prior is None else np.concatenate([off, off_known(prior, sigma, *poses(step))])

    best = least_squares(residuals, np.zeros(6), x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    scale = np.linalg.norm(best.jac, axis=0)
    spread = np.linalg.inv(best.jac.T @ best.jac / np.outer(scale, scale)) / np.outer(scale, scale)
    root, rng = np.linalg.cholesky(spread / np.outer(1 / scale, 1 / scale)) / scale[:, None], np.random.default_rng(6)
    drawn = multivariate_t(np.zeros(6), np.eye(6), df=5.0)
    unit = drawn.rvs(100_000, random_state=rng)
    steps = best.x + unit @ root.T
    R, t = poses(steps)
    value = -0.5 * (scene.deviations(R, t) ** 2).sum(axis=1)
    value += broad(R, t) if prior is None else log_known(prior, sigma, R, t)
    angle = np.maximum(np.linalg.norm(steps[:, :3], axis=1), 1e-12)
    value += 2.0 * np.log(np.sin(0.5 * angle) / (0.5 * angle))  # the volume of rotations by rotation vectors
    value -= drawn.logpdf(unit) - np.log(np.diag(root)).sum()
    return float(logsumexp(value) - math.log(len(value))), *poses(best.x)


def model_of(scene: Scene, prior: rm.PosePrior | None) -> DetectionModel:
    """The image's model, of a noise that is exact."""
    density = Broad(RADIUS)
    known = density if prior is None else Doubted([Known(prior, CENTRE, RADIUS)], [math.log1p(-DOUBT)], density, DOUBT)
    return DetectionModel(CAMERA, BODY, scene.target, np.full(4, NOISE), prior=known, noise_freedom=1e9)


def fitted(scene: Scene, prior: rm.PosePrior | None, start: tuple[Floats, Floats]) -> tuple[float, Floats, Floats]:
    """Log-odds of the true assignment from a pose of the points, and its pose after the steps."""
    model = model_of(scene, prior)
    R, t = start
    found, at = settle_poses(model, np.arange(4)[None], R[None], (t + R @ CENTRE)[None])
    turns, places = step_poses(found, at)
    assert model.prior.prediction_indices(turns, places)[0] == 0 if prior is not None else True  # type: ignore[attr-defined]
    return float(found.log_odds[0]), turns[0], places[0] - turns[0] @ CENTRE


@pytest.mark.parametrize("kind", SIGMAS)
@pytest.mark.parametrize("seed", [2])
def test_the_evidence_is_the_integral_with_what_is_known(kind: str, seed: int) -> None:
    """From the pose of the detections alone, which precise knowledge excludes."""
    scene = Scene(seed)
    nothing, *alone = integral(scene)
    before, *_ = fitted(scene, None, (alone[0], alone[1]))
    for sigma in SIGMAS[kind]:
        prior, width = scene.prior(kind, sigma), max(sigma, MINIMUM[kind])
        expected, R, t = integral(scene, prior, width)
        found, turned, moved = fitted(scene, prior, (alone[0], alone[1]))
        close = 0.8 if kind == "position" and sigma > 0.1 else 0.3  # where `broad` changes within σ
        assert found - before - math.log1p(-DOUBT) == pytest.approx(expected - nothing, abs=close), sigma
        assert np.linalg.norm(Rotation.from_matrix(turned @ R.T).as_rotvec()) < 2e-3, sigma
        np.testing.assert_allclose(moved, t, atol=2e-3)


@pytest.mark.parametrize("kind", ["rotation", "position"])
def test_the_vaguer_the_knowledge_the_nearer_to_none(kind: str) -> None:
    scene = Scene(3)
    _, *alone = integral(scene)
    before, R, t = fitted(scene, None, (alone[0], alone[1]))
    worth = []
    for sigma in (0.1, 0.3, 1.0, *((3.0, 10.0, 100.0, 1e4) if kind == "position" else ())):
        found, turned, moved = fitted(scene, scene.prior(kind, sigma), (alone[0], alone[1]))
        worth.append(found - before - math.log1p(-DOUBT))
    assert np.all(np.diff(worth) < 0.01)
    assert -0.01 <= worth[-1] < (0.5 if kind == "position" else 2.1)  # 1 rad, the most, is a seventh of all turns
    np.testing.assert_allclose(turned, R, atol=1e-3)
    np.testing.assert_allclose(moved, t, atol=1e-3)


def test_a_vague_prediction_is_no_less_than_nothing_known() -> None:
    """After a second of which nothing is known a body may have turned several times, and is somewhere in the image."""
    R, place, nothing = np.eye(3), np.array([0.1, -0.1, 1.0]), Broad(RADIUS)
    at = R[None], place[None]
    for width in (1e-4, 1e-2, 1.0, 10.0, 100.0):
        known = Gaussian(R, place, np.diag([width**2] * 6))
        told = Doubted([known], [math.log1p(-DOUBT)], nothing, DOUBT).terms(*at).log_density[0] - math.log1p(-DOUBT)
        peak = max(-3.0 * math.log(2.0 * math.pi * width**2), float(nothing.terms(*at).log_density[0]))
        assert peak - 1e-3 < told < peak + 1.6, width
        assert Doubted([known], [math.log1p(-DOUBT)], nothing, DOUBT).prediction_indices(*at)[0] == 0
