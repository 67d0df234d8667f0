"""What a predicted frame has compiled of its own, each against a slow computation in NumPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from rootmatch.algebra.rotation import cross_matrix
from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.rig_image import RigImage
from rootmatch.model.compiled.updates import choose_pairs, fill_explained, update_with_each
from rootmatch.model.detection_model import ISOTROPIC, DetectionModel
from rootmatch.model.proposals import Proposals, reverse_depths
from rootmatch.model.views import unproject_detections
from rootmatch.problems.pose_fit.reference_point import pose_about_point
from rootmatch.problems.pose_fit.starts import reflect_poses
from rootmatch.tracking.motion_filter import transition
from rootmatch.tracking.motion_kernels import move_ahead, take_pose
from test_compiled_model import FISHEYE, PINHOLE, SIZES, WEIGHTS, one_sided, rig, scene

Floats = NDArray[np.float64]
GATE, TRIED = 16.0, 8


def covariance_of(kind: str, rng: np.random.Generator) -> Floats:
    """Of a pose: of full rank, or of rank one and far wider than the noise."""
    rows = rng.normal(size=(6, 6)) * ([[0.05]] * 3 + [[0.02]] * 3)
    return np.asarray(rows @ rows.T if kind != "rank one" else 100.0 * np.outer(rows[:, 0], rows[:, 0]))


def deviations(model: DetectionModel, pixels: Floats, spread: Floats) -> tuple[Floats, Floats]:
    """χ² and determinant (…, n, n') of detections about predictions (…, n, 2) with covariances (…, n, 2, 2).

    All terms are nonnegative: the determinant of a spread of rank one, far wider than the noise, is pure rounding error
    of either sign.
    """
    _, sigma, blur, *_ = model.gating_image
    variance = sigma**2
    x = model.target[:, 0] - pixels[..., 0, None]
    y = model.target[:, 1] - pixels[..., 1, None]
    a, c = np.maximum(spread[..., 0, 0, None], 0.0), np.maximum(spread[..., 1, 1, None], 0.0)
    b = spread[..., 0, 1, None]
    if len(blur):
        a, b, c = a + blur[:, 0, 0], b + blur[:, 0, 1], c + blur[:, 1, 1]
    determinant = np.maximum(a * c - b * b, 0.0) + variance * (a + c + variance)
    x2, y2 = x * x, y * y
    across = np.maximum(c * x2 - 2.0 * b * (x * y) + a * y2, 0.0)
    return (across + variance * (x2 + y2)) / determinant, determinant


@pytest.mark.parametrize("kind", ["plain", "weights", "source noise", "rank one", "blurred"])
@pytest.mark.parametrize("seed", range(1020, 1024))
def test_updates_with_single_correspondences(kind: str, seed: int) -> None:
    """By Kalman's formulas with matrices, and densities of all detections."""
    more = {"log_weights": WEIGHTS, "allowed": WEIGHTS > -1.0} if kind == "weights" else {}
    model, R, position = scene(PINHOLE, seed=seed, poses=2, **more)
    rng = np.random.default_rng(seed)
    at = model.linearise_about(R[:1], position[:1])
    pixels, jacobian = at.pixels[0], at.jacobian[0]
    own = model.sigma[:, None, None] ** 2 * np.eye(2)
    if kind == "blurred":
        more = {"target_covariance": (own := own + 2.0 * one_sided(rng, 9))}
    model = DetectionModel(model.camera, model.points, model.target.copy(), model.sigma, **more)  # type: ignore[arg-type]
    of_points = np.tile(np.array([[4.0, 1.0], [1.0, 3.0]]), (6, 1, 1)) if kind == "source noise" else ISOTROPIC
    about = rng.normal(0.0, 1e-3, 6), covariance_of(kind, rng)
    model.target[:6] = pixels + jacobian @ rng.multivariate_normal(*about) + rng.normal(0.0, 0.5, (6, 2))
    chance, candidates = rng.uniform(0.1, 0.9, 6), rng.random((6, 9)) < 0.7
    if kind == "weights":
        candidates &= WEIGHTS > -1.0
    candidates[3] = False
    target, log_weights = model.target, model.weights_of_pairs
    image = *model.gating_image[:4], log_weights
    points = pixels, jacobian, of_points, chance

    moved = pixels + jacobian @ about[0]
    spread = jacobian @ about[1] @ jacobian.swapaxes(1, 2) + (of_points if len(of_points) else 0.0)
    near = candidates & (deviations(model, moved, spread)[0] <= GATE)
    vague, counts = np.trace(spread, axis1=1, axis2=2), near.sum(axis=1)
    expected: list[tuple[int, int]] = []
    for i in np.argsort(counts - vague / vague.max(), kind="stable"):
        if counts[i] and expected and len(expected) + counts[i] > TRIED:
            break
        expected += [(int(i), int(j)) for j in np.flatnonzero(near[i])]
    pairs = np.empty((9, 2), np.int64)
    count = choose_pairs(points, about, image, candidates, (GATE, TRIED), pairs)
    assert [tuple(pair) for pair in pairs[:count].tolist()] == expected
    assert count > 0

    steps, covariances, scores = np.empty((count, 6)), np.empty((count, 6, 6)), np.empty(count)
    update_with_each(points, about, image, candidates, pairs[:count], (steps, covariances, scores))
    shown = candidates.any(axis=1)
    for k, (i, j) in enumerate(expected):
        total = spread[i] + own[j]
        gain = about[1] @ jacobian[i].T @ np.linalg.inv(total)
        np.testing.assert_allclose(steps[k], about[0] + gain @ (target[j] - moved[i]), rtol=1e-6, atol=1e-9)
        covariance = about[1] - gain @ total @ gain.T
        np.testing.assert_allclose(covariances[k], covariance, atol=1e-9 * float(np.abs(about[1]).max()))
        # of the kernel's own covariance: where it is nearly singular a rounding error decides the rest
        spreads = jacobian @ covariances[k] @ jacobian.swapaxes(1, 2) + (of_points if len(of_points) else 0.0)
        squared, determinant = deviations(model, pixels + jacobian @ steps[k], spreads)
        ratio = np.exp(-0.5 * squared - model.clutter.log_density) / (2.0 * np.pi * np.sqrt(determinant))
        if kind == "weights":
            ratio[~(WEIGHTS > -1.0)] = 0.0
        score = np.log(1.0 - chance + chance * ratio.max(axis=1))[shown].sum()
        assert scores[k] == pytest.approx(score, rel=1e-9)


@pytest.mark.parametrize("source_noise", [False, True])
def test_what_poses_explain(source_noise: bool) -> None:
    """Points by their best detections or detections by their best points, whichever is less: the odds of no more."""
    model, R, position = scene(PINHOLE, seed=1024, poses=3)
    rng = np.random.default_rng(1024)
    at = model.linearise_about(R, position)
    step, covariance = rng.normal(0.0, 1e-3, (3, 6)), np.array([covariance_of("plain", rng) for _ in range(3)])
    of_points = np.tile(np.array([[4.0, 1.0], [1.0, 3.0]]), (3, 6, 1, 1)) if source_noise else ISOTROPIC[None]
    chance = rng.uniform(0.1, 0.9, (3, 6))
    at.pixels[2] = at.pixels[2, :1]  # all points have one image, as of a body far away
    model.target[:6] = at.pixels[0] + rng.normal(0.0, 3.0, (6, 2))
    model.target[6] = at.pixels[2, 0]
    image = model.gating_image
    scores = np.empty(3)
    fill_explained((at.pixels, at.jacobian, of_points, chance), (step, covariance), image, scores)
    for k in range(3):
        moved = at.pixels[k] + at.jacobian[k] @ step[k]
        spread = at.jacobian[k] @ covariance[k] @ at.jacobian[k].swapaxes(1, 2)
        squared, determinant = deviations(model, moved, spread + (of_points[k] if source_noise else 0.0))
        ratio = np.exp(-0.5 * squared - model.clutter.log_density) / (2.0 * np.pi * np.sqrt(determinant))
        of_points_alone = np.log(1.0 - chance[k] + chance[k] * ratio.max(axis=1)).sum()
        gain = np.log(np.maximum(ratio * (chance[k] / (1.0 - chance[k]))[:, None], 1.0))
        of_detections = np.log(1.0 - chance[k]).sum() + gain.max(axis=0).sum()
        assert scores[k] == pytest.approx(min(of_points_alone, of_detections), rel=1e-9)
        rows, columns = linear_sum_assignment(gain, maximize=True)
        assert scores[k] >= np.log(1.0 - chance[k]).sum() + gain[rows, columns].sum() - 1e-9


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE], ids=["pinhole", "fisheye"])
def test_rays_of_a_camera(camera: CameraModel) -> None:
    target = np.random.default_rng(1030).uniform((-300.0, -300.0), (1600.0, 1300.0), (200, 2))
    target[0] = 640.0, 480.0  # the principal point
    shown = camera.shows(target)
    rays = unproject_detections(camera, target)
    np.testing.assert_allclose(rays[shown], camera.bearings(target[shown]), atol=1e-14)
    assert np.isnan(rays[~shown]).all()
    assert shown.all() == (camera is PINHOLE)


def test_rays_of_a_rig() -> None:
    image = rig(SIZES)
    target = (
        np.random.default_rng(1031).uniform((400.0, 300.0), (900.0, 700.0), (9, 2)) + image.offsets[image.camera_of]
    )
    for ray, pixel, camera in zip(unproject_detections(image, target), target, image.camera_of, strict=True):
        bearing = image.rig.cameras[camera].bearings(pixel - image.offsets[camera])
        np.testing.assert_allclose(ray, bearing, atol=1e-14)


@pytest.mark.parametrize("flatness", [1.0, 1e-3, 0.0])
@pytest.mark.parametrize("camera", [PINHOLE, rig()], ids=["camera", "rig"])
def test_reversed_depth(camera: CameraModel, flatness: float) -> None:
    """As in NumPy about the centre of the camera with most matches."""
    model, R, position = scene(camera, seed=1032)
    rng = np.random.default_rng(1033)
    turn = Rotation.random(random_state=1034).as_matrix()
    n, cameras = len(model.points), 2 if isinstance(camera, RigImage) else 1
    model.points[:] = np.tile(rng.uniform(-0.06, 0.06, (n // cameras, 3)) * (1.0, 1.0, flatness) @ turn, (cameras, 1))
    assignments = np.where(rng.random((len(R), n)) < 0.8, rng.integers(0, 9, (len(R), n)), -1)
    found = reverse_depths(model, Proposals(assignments, R, position))
    centre = np.zeros((len(R), 3))
    if isinstance(camera, RigImage):
        maximum = (assignments >= 0).reshape(len(R), cameras, -1).sum(axis=2).argmax(axis=1)
        centre = camera.rig.centres[maximum]
        assert len(set(maximum.tolist())) == 2
    points = np.broadcast_to(model.points - model.centre, (len(R), n, 3))
    rotation, place = reflect_poses((R, position - centre), points, (assignments >= 0).astype(float))
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-9)
    np.testing.assert_allclose(found.position, place + centre, atol=1e-9)
    np.testing.assert_array_equal(found.assignments, assignments)


def random_levels(rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Covariances (3, 18, 18), means (3, 18) about 0, and shares (3,)."""
    rows, shares = rng.normal(size=(3, 18, 18)), np.array([0.6, 0.3, 0.1])
    apart = rng.normal(size=(3, 18))
    return rows @ rows.swapaxes(1, 2), apart - shares @ apart, shares


def together(levels: tuple[Floats, Floats, Floats]) -> Floats:
    """Covariance of a mixture of normal distributions whose mean is 0."""
    each, apart, shares = levels
    return np.einsum("j,jab->ab", shares, each + apart[:, :, None] * apart[:, None])


def empty_state() -> tuple[tuple[Floats, ...], tuple[Floats, ...]]:
    """Arrays for a state and for its levels."""
    state = np.empty((3, 3)), np.empty(3), np.empty(12), np.empty((18, 18))
    return state, (np.empty((3, 18, 18)), np.empty((3, 18)), np.empty(3))


def test_a_motion_ahead() -> None:
    """By matrices, from levels of full covariance, each of which may have become any other."""
    rng = np.random.default_rng(1036)
    for angle in (1.0, 1e-9):
        levels, (F, added) = random_levels(rng), transition(0.02, 0.1)
        variances, stated, motion = np.array([0.3, 2.0, 9.0]), rng.uniform(1.0, 2.0, 6), rng.normal(size=12)
        motion[[0, 1, 2, 6, 7, 8]] *= angle
        R, t = Rotation.random(random_state=1037).as_matrix(), rng.normal(size=3)
        usual, kept, out = np.array([0.5, 0.3, 0.2]), 0.7, empty_state()
        before = R, t, motion, together(levels)
        move_ahead((F, added), before, levels, (usual, kept, variances, stated, 0.0), out)
        whole, change = np.kron(F, np.eye(6)), F[:, 1:] @ motion.reshape(2, 6)
        whole[:3, :3] = turn = Rotation.from_rotvec(change[0, :3]).as_matrix()
        expected = turn @ R, t + change[0, 3:], change[1:].ravel()
        for one, other in zip(out[0][:3], expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)
        each, apart, shares = levels
        joint = shares[:, None] * (kept * np.eye(3) + (1.0 - kept) * usual)  # from one level (rows) to another
        ahead, moved, after = out[1]
        np.testing.assert_allclose(after, joint.sum(axis=0), rtol=1e-12)
        for j in range(3):
            part = joint[:, j] / joint[:, j].sum()
            mean = part @ apart
            mixed = np.einsum("i,iab->ab", part, each + (apart - mean)[:, :, None] * (apart - mean)[:, None])
            mixed = whole @ mixed @ whole.T + variances[j] * np.kron(added, np.diag(stated))
            np.testing.assert_allclose(moved[j], whole @ mean, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(ahead[j], mixed, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(out[0][3], together((ahead, moved, after)), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("chance", [1.0, 0.6])
@pytest.mark.parametrize("freedom", [math.inf, 8.0])
def test_a_pose_taken_in(chance: float, freedom: float) -> None:
    """What a fit has beside its prediction, as a measurement of each level: filters of Kalman, weighed by Bayes."""
    rng = np.random.default_rng(1040)
    each, apart, shares = random_levels(rng)
    each, apart = 1e-7 * each, 3e-4 * apart  # of turns that go straight on
    whole = together((each, apart, shares))
    rows = rng.normal(size=(6 if math.isfinite(freedom) else 4, 6))  # of six directions
    seen = 1e6 * rows.T @ rows
    off, weight = 3e-3 * rng.normal(size=6), 1.0
    for _ in range(200):
        fitted = np.linalg.inv(seen + weight * np.linalg.inv(whole[:6, :6]))
        step = fitted @ seen @ off
        squared = step @ np.linalg.solve(whole[:6, :6], step)
        weight = min(1.0, (freedom + 6.0) / (freedom + squared)) if math.isfinite(freedom) else 1.0
    assert (weight < 1.0) == math.isfinite(freedom)
    R, t, out = Rotation.random(random_state=1041).as_matrix(), rng.normal(size=3), empty_state()
    change = np.empty((18, 6)), np.empty((18, 6))
    fit = Rotation.from_rotvec(step[:3]).as_matrix() @ R, t + step[3:], fitted, 1.0
    state = R, t, rng.normal(size=12), whole
    take_pose((state, (each, apart, shares), 1.0), fit, (chance, freedom, 0.0), (*out, *change))
    means, spreads, log = [], [], []
    H, root = np.eye(6, 18), np.linalg.cholesky(seen + 1e-9 * np.eye(6)).T
    for one, mean, share in zip(each, apart, shares, strict=True):
        total = root @ H @ one @ H.T @ root.T + np.eye(6)
        gain, residual = one @ H.T @ root.T @ np.linalg.inv(total), root @ (off - mean[:6])
        means.append(mean + gain @ residual)
        spreads.append(one - gain @ root @ H @ one)
        log.append(
            math.log(share) - 0.5 * residual @ np.linalg.solve(total, residual) - 0.5 * np.linalg.slogdet(total)[1]
        )
    part = np.exp(np.array(log) - max(log))
    part = np.concatenate([(1.0 - chance) * shares, chance * part / part.sum()])
    mean = part @ np.concatenate([apart, means])
    spread = np.concatenate([each, spreads])
    apart = np.concatenate([apart, means]) - mean
    (R_now, t_now, motion, covariance), levels = out
    np.testing.assert_allclose(Rotation.from_matrix(R_now @ R.T).as_rotvec(), mean[:3], atol=1e-5)
    np.testing.assert_allclose(t_now - t, mean[3:6], atol=1e-5)
    np.testing.assert_allclose(motion - state[2], mean[6:], atol=1e-5)
    expected = together((spread, apart, part))
    scale = np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
    np.testing.assert_allclose(covariance / scale, expected / scale, atol=2e-2)
    np.testing.assert_allclose(together(levels), covariance, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(levels[2], part[:3] + part[3:], atol=2e-3)
    assert abs(levels[2] - shares).max() > 0.05


def test_a_pose_about_another_point() -> None:
    """By a matrix; arrays may be read-only and of any layout."""
    rng = np.random.default_rng(1038)
    R, t, point = Rotation.random(random_state=1039).as_matrix().T, rng.normal(size=3), rng.normal(size=3)
    covariance = np.zeros((7, 7))[:6, :6]
    covariance[:] = (rows := rng.normal(size=(6, 6))) @ rows.T
    point.setflags(write=False)
    place, changed = pose_about_point(R, t, covariance, point)
    change = np.eye(6)
    change[3:, :3] = -cross_matrix(R @ point)
    np.testing.assert_allclose(place, R @ point + t, atol=1e-14)
    np.testing.assert_allclose(changed, change @ covariance @ change.T, atol=1e-12)
    back, unchanged = pose_about_point(R, place, changed, -point)
    np.testing.assert_allclose(back, t, atol=1e-14)
    np.testing.assert_allclose(unchanged, covariance, atol=1e-12)
