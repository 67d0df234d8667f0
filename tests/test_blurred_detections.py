"""Detections with covariances: blobs that motion blurs along a direction, which is not one σ of both axes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, multivariate_normal
from typer.testing import CliRunner

import instances
import rig_scenes
import rootmatch as rm
from rootmatch.algebra.rotation import rotation_vector
from rootmatch.cli import app
from rootmatch.io.point_files import PointSet, read_points, write_points
from rootmatch.model.compiled.gating import gate
from rootmatch.model.detection_model import ISOTROPIC, DetectionModel
from rootmatch.model.evidence import squared_deviations, weigh_poses

Floats = NDArray[np.float64]
FOCAL, CENTRE = 900.0, np.array([640.0, 480.0])
CAMERA = rm.Camera(FOCAL, FOCAL, *CENTRE)
ALONG, ACROSS = 2.0, 0.3


class Blurred(NamedTuple):
    """Points, their pose, detections with covariances, and the detection of each point."""

    points: Floats
    R: Floats
    t: Floats
    target: Floats
    noise: Floats
    truth: NDArray[np.int64]


def blurs(rng: np.random.Generator, count: int) -> tuple[Floats, Floats]:
    """Covariances (count, 2, 2) of blobs that are blurred each along a direction, and errors of them."""
    angle = rng.uniform(0.0, np.pi, count)
    axes = np.stack([np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)], axis=1).reshape(-1, 2, 2)
    root = axes.swapaxes(1, 2) * (ALONG, ACROSS)
    return root @ root.swapaxes(1, 2), (root @ rng.normal(size=(count, 2, 1)))[..., 0]


def scene(seed: int, clutter: int = 4) -> Blurred:
    rng = np.random.default_rng(seed)
    points, R = 0.12 * rng.normal(size=(8, 3)), instances.random_rotation(rng)
    t = np.array([*rng.uniform(-0.25, 0.25, 2), rng.uniform(1.0, 2.0)])
    pixels = np.concatenate([CAMERA.project(points @ R.T + t), rng.uniform((0, 0), (1280, 960), (clutter, 2))])
    noise, off = blurs(rng, len(pixels))
    order = rng.permutation(len(pixels))
    return Blurred(points, R, t, (pixels + off)[order], noise[order], np.argsort(order)[:8])


def deviation2(pose: rm.Pose, R: Floats, t: Floats) -> float:
    """Squared deviation of a pose from the true one, in its covariance."""
    assert pose.covariance is not None
    off = np.concatenate([rotation_vector((R @ pose.R.T)[None])[0], t - pose.t])
    return float(off @ np.linalg.solve(pose.covariance, off))


@pytest.mark.parametrize("known", ["alone", "prior", "resolution", "source_noise"])
def test_poses_cover_the_truth(known: str) -> None:
    d2 = []
    for seed in range(1000, 1040):
        one = scene(seed)
        prior = rm.Pose(one.R, one.t, np.diag([0.05] * 3 + [0.1] * 3) ** 2)
        options = {"alone": {}, "prior": {"prior": prior}, "resolution": {"resolution": 6.0}}
        found = rm.match(
            one.points, one.target, rm.P3P(CAMERA), noise=one.noise,
            **options.get(known, {"source_noise": 1e-4}),  # type: ignore[arg-type]
        )  # fmt: skip
        assert not found or not ((found.assignment >= 0) & (found.assignment != one.truth)).any()
        if found:
            assert found.pose is not None
            d2.append(deviation2(found.pose, one.R, one.t))
    assert len(d2) >= 38
    assert np.mean(np.array(d2) <= chi2.ppf(0.95, 6)) >= 0.85
    assert 4.5 < np.mean(d2) < 8.0


def test_covariances_of_one_sigma_are_that_sigma() -> None:
    one = scene(1000)
    sigma = np.linspace(0.8, 1.4, len(one.target))
    by_sigma, by_matrix = (
        rm.match(one.points, one.target, rm.P3P(CAMERA), noise=noise)
        for noise in (sigma, sigma[:, None, None] ** 2 * np.eye(2))
    )
    assert by_sigma.pose is not None
    assert by_matrix.pose is not None
    np.testing.assert_array_equal(by_sigma.assignment, by_matrix.assignment)
    np.testing.assert_allclose(by_sigma.log_odds, by_matrix.log_odds, atol=1e-6)
    np.testing.assert_allclose(np.array(by_sigma.pose.covariance), by_matrix.pose.covariance, rtol=1e-4)


def test_pixels_that_are_not_square() -> None:
    """Twice the focal length along x, and twice the noise there: the same rays, so the same pose."""
    one, stretch = scene(1001, clutter=0), np.array([2.0, 1.0])
    wide = rm.Camera(2.0 * FOCAL, FOCAL, *(CENTRE * stretch))
    square = rm.match(one.points, one.target, rm.P3P(CAMERA), noise=one.noise)
    flat = rm.match(
        one.points, one.target * stretch, rm.P3P(wide), noise=one.noise * stretch[:, None] * stretch, max_seconds=20.0
    )
    assert square.pose is not None
    assert flat.pose is not None
    np.testing.assert_allclose(flat.pose.matrix, square.pose.matrix, atol=1e-6)
    np.testing.assert_allclose(np.array(flat.pose.covariance), square.pose.covariance, rtol=1e-3, atol=1e-12)


def test_deviations_are_those_of_a_normal_distribution() -> None:
    one = scene(1002)
    model = DetectionModel(CAMERA, one.points, one.target, np.full(12, 1.0), target_covariance=one.noise)
    found, at = weigh_poses(model, one.truth[None], *model.centred(one.R[None], one.t[None]))
    off = one.target[one.truth] - at.pixels[0]
    expected = sum(float(d @ np.linalg.solve(S, d)) for d, S in zip(off, one.noise[one.truth], strict=True))
    np.testing.assert_allclose(squared_deviations(model, one.truth[None], at), expected)
    np.testing.assert_allclose(found.squared + found.decrement, expected)


def test_gates_have_the_density_of_a_normal_distribution() -> None:
    one = scene(1003)
    model = DetectionModel(CAMERA, one.points, one.target, np.full(12, 1.0), target_covariance=one.noise)
    at = model.linearise_about(*model.centred(one.R[None], one.t[None]))
    spread = np.diag([1e-3] * 3 + [2e-3] * 3) ** 2
    out = np.empty((8, 12), np.bool_), np.empty((8, 12)), np.empty(8, np.int64)
    image = *model.gating_image[:3], np.zeros(12), np.empty((0, 0))
    gate((at.pixels[0], at.jacobian[0], ISOTROPIC, np.ones(8)), spread, image, (16.0, 0.5, 0.1), out)
    jacobian = at.jacobian[0]
    for i in range(8):
        for j in range(12):
            covariance = jacobian[i] @ spread @ jacobian[i].T + one.noise[j]
            log_density = multivariate_normal(at.pixels[0, i], covariance).logpdf(one.target[j])
            assert out[1][i, j] == pytest.approx(log_density, rel=1e-9)


def test_rigs() -> None:
    d2 = []
    for seed in range(1000, 1004):
        given = rig_scenes.four_about(seed=seed, sigma=0.0)
        noise, off = blurs(np.random.default_rng(seed), len(given.rows))
        rows = given.rows + np.column_stack([off, np.zeros(len(off))])
        found = rm.match(given.points, rows, rm.P3P(given.rig), noise=noise)
        if found:
            assert found.pose is not None
            d2.append(deviation2(found.pose, *given.poses[0]))
    assert len(d2) >= 3
    assert np.mean(d2) < 10.0


def test_trackers() -> None:
    first = scene(1004)
    tracker, rng, d2 = rm.Tracker(first.points, rm.P3P(CAMERA)), np.random.default_rng(1), []
    for frame in range(20):
        t = first.t + np.array([0.002, 0.001, 0.003]) * frame
        noise, off = blurs(rng, 8)
        target = CAMERA.project(first.points @ first.R.T + t) + off
        found = tracker.update(target, time=frame / 60.0, noise=noise)
        np.testing.assert_array_equal(found.assignment, np.arange(8))
        assert found.pose is not None
        d2.append(deviation2(found.pose, first.R, t))
    assert np.mean(d2) < 12.0
    assert tracker.noise_factor < 1.2


def test_diagonal_covariances_of_points_in_space() -> None:
    points = scene(1005).points
    noise = np.tile(np.diag([1e-6, 1e-6, 9e-6]), (8, 1, 1))
    assert rm.match(points, points[::-1] + 0.5, rm.Rigid(), noise=noise)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda S: S[:5], "noise: shape (5, 2, 2) given; give σ as one number, (12,) or (12, 2), or covariances"),
        (lambda S: S * [[1.0, 2.0], [1.0, 1.0]], "noise: a covariance is not symmetric"),
        (lambda S: S * [[1.0, 9.0], [9.0, 1.0]], "noise: a covariance has a negative eigenvalue"),
        (
            lambda S: S * [[1.0, 0.0], [0.0, 0.0]],
            "noise: a covariance has the eigenvalue 0 px², so a detection is",
        ),
        (lambda S: S * np.nan, "noise: it holds NaN or infinity"),
        (lambda S: S * 1e9, "px given, wider than an image"),
    ],
)
def test_bad_covariances_have_one_error(change, message: str) -> None:  # type: ignore[no-untyped-def]
    one = scene(1006)
    with pytest.raises(rm.InputError, match=r".") as caught:
        rm.match(one.points, one.target, rm.P3P(CAMERA), noise=change(one.noise))
    assert message in str(caught.value)


def test_columns_of_covariances(tmp_path) -> None:  # type: ignore[no-untyped-def]
    one = scene(1007)
    model, image = tmp_path / "model.csv", tmp_path / "image.csv"
    write_points(model, PointSet(one.points))
    write_points(image, PointSet(one.target, sigma=one.noise))
    read = read_points(image, 2, of_image=True)
    np.testing.assert_array_equal(read.sigma, one.noise)
    frames = tmp_path / "frames.csv"
    header, *rows = image.read_text().splitlines()
    frames.write_text("\n".join([f"frame,{header}", *(f"{k},{row}" for k in (0, 1) for row in rows)]))
    for command, file in (("match", image), ("track", frames)):
        poses = tmp_path / f"{command}.csv"
        options = ["--problem", "p3p", "--camera", "900,900,640,480", "--poses", str(poses)]
        ended = CliRunner().invoke(app, [command, str(model), str(file), *options])
        assert ended.exit_code == 0, ended.output
    partly = tmp_path / "partly.csv"
    partly.write_text("x,y,sxx,syy\n1,2,3,4\n")
    with pytest.raises(rm.InputError, match="the column sxy is missing although sxx is given"):
        read_points(partly, 2, of_image=True)


def test_problems_without_such_a_model_say_so() -> None:
    one = scene(1008)
    rays = np.column_stack([(one.target - CENTRE) / FOCAL, np.ones(12)])
    with pytest.raises(rm.InputError, match="give one number or one for each"):
        rm.match(one.points, rays, rm.P3P(rm.Bearings()), noise=one.noise)


def test_a_body_of_several_keeps_its_covariances() -> None:
    one, other = scene(1009, clutter=0), scene(1010, clutter=0)
    labels = np.repeat([0, 1], 8)
    noise = np.concatenate([one.noise, other.noise])
    found = rm.match(
        np.concatenate([one.points, other.points + 1.0]), np.concatenate([one.target, other.target]), rm.P3P(CAMERA),
        noise=noise, bodies=labels,
    )  # fmt: skip
    truth = np.concatenate([one.truth, 8 + other.truth])
    assert found.bodies is not None
    assert not ((found.assignment >= 0) & (found.assignment != truth)).any()
