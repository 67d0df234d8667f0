"""Cameras with lenses and unit rays: against OpenCV and COLMAP, and against derivatives by differences."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

import instances
import rootmatch as rm
from rootmatch.cameras.brown import Brown
from rootmatch.cameras.stereographic import Stereographic
from rootmatch.cameras.unit_rays import UnitRays
from rootmatch.errors import InputError

cv2 = pytest.importorskip("cv2")

K = np.array([[1000.0, 0.0, 640.0], [0.0, 1010.0, 480.0], [0.0, 0.0, 1.0]])
DISTORTIONS = {
    4: [-0.28, 0.07, 1e-3, -2e-3],
    5: [0.11, -0.25, -1e-3, 5e-4, 0.12],
    8: [-0.28, 0.07, 1e-3, -2e-3, 0.01, 0.1, 0.02, 0.003],
    12: [0.3, 0.07, 1e-3, -2e-3, 0.01, 0.1, 0.02, 0.003, 1e-3, 2e-3, -1e-3, 5e-4],
    14: [-0.28, 0.07, 1e-3, -2e-3, 0.01, 0.1, 0.02, 0.003, 1e-3, 2e-3, -1e-3, 5e-4, 0.05, -0.03],
}
FISHEYE = [0.05, -0.02, 0.003, -0.0005]


def whole_image() -> np.ndarray:
    """Pixels (m, 2) of all of an image of 1280 × 960, its rim included."""
    return np.stack(np.meshgrid(np.linspace(0.0, 1279.0, 41), np.linspace(0.0, 959.0, 31)), axis=-1).reshape(-1, 2)


def by_differences(camera: rm.Camera | Stereographic, points: np.ndarray, step: float = 1e-6) -> np.ndarray:
    moved = [(camera.project(points + e) - camera.project(points - e)) / (2.0 * step) for e in step * np.eye(3)]
    return np.stack(moved, axis=-1)


@pytest.mark.parametrize("count", DISTORTIONS)
def test_opencv_sees_the_same_image(count: int) -> None:
    camera, dist, pixels = rm.Camera.from_opencv(K, DISTORTIONS[count]), np.array(DISTORTIONS[count]), whole_image()
    rays = camera.bearings(pixels)
    points = rays * np.random.default_rng(0).uniform(0.5, 9.0, (len(rays), 1))
    projected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, dist)[0][:, 0]
    assert np.abs(projected - pixels).max() < 1e-9
    assert np.abs(camera.project(points) - projected).max() < 1e-9
    tight = (cv2.TERM_CRITERIA_MAX_ITER + cv2.TERM_CRITERIA_EPS, 500, 1e-16)
    iterated = getattr(cv2, "undistortPointsIter", None)
    if iterated is None:  # OpenCV 5 has one function for both
        undistorted = cv2.undistortPoints(pixels[:, None], K, dist, criteria=tight)
    else:
        undistorted = iterated(pixels[:, None], K, dist, None, None, tight)
    assert 1000.0 * np.abs(rays[:, :2] / rays[:, 2:] - undistorted[:, 0]).max() < 1e-9
    assert camera.sees(points).all()


def test_opencv_sees_the_same_fisheye_image() -> None:
    camera, pixels = rm.Camera.from_opencv_fisheye(K, FISHEYE), whole_image()
    rays = camera.bearings(pixels)
    points = rays * np.random.default_rng(0).uniform(0.5, 9.0, (len(rays), 1))
    coefficients = np.array(FISHEYE)
    projected = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), K, coefficients)[0][:, 0]
    assert np.abs(projected - pixels).max() < 1e-9
    assert np.abs(camera.project(points) - projected).max() < 1e-9


@pytest.mark.parametrize(
    ("model", "parameters"),
    [
        ("OPENCV", [1000.0, 1010.0, 640.0, 480.0, -0.28, 0.07, 1e-3, -2e-3]),
        ("FULL_OPENCV", [1000.0, 1010.0, 640.0, 480.0, *DISTORTIONS[8]]),
        ("OPENCV_FISHEYE", [1000.0, 1010.0, 640.0, 480.0, *FISHEYE]),
    ],
)
def test_colmap_sees_the_same_image(model: str, parameters: list[float]) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    other = pycolmap.Camera(model=model, width=1280, height=960, params=parameters)
    make = rm.Camera.from_opencv_fisheye if "FISHEYE" in model else rm.Camera.from_opencv
    rays = make(K, parameters[4:]).bearings(whole_image())
    assert np.abs(np.asarray(other.img_from_cam(rays)) - whole_image()).max() < 1e-9


def test_a_fisheye_sees_beside_and_behind_itself() -> None:
    camera = rm.Camera.from_opencv_fisheye(K, FISHEYE)
    rays = np.array([instances.random_unit(np.random.default_rng(k)) for k in range(400)])
    seen = camera.sees(rays)
    assert camera.sees([[1.0, 0.0, -0.2]]).all()
    assert not camera.sees([[0.01, 0.0, -1.0]]).any()
    for (x, y, z), (u, v) in zip(rays[seen].tolist(), camera.project(rays[seen]).tolist(), strict=True):
        angle = math.acos(max(-1.0, min(1.0, z)))
        distance = angle + sum(k * angle ** (3 + 2 * power) for power, k in enumerate(FISHEYE))
        around = math.atan2(y, x)
        assert u == pytest.approx(640.0 + 1000.0 * distance * math.cos(around), abs=1e-9)
        assert v == pytest.approx(480.0 + 1010.0 * distance * math.sin(around), abs=1e-9)
    assert rays[seen][:, 2].min() < -0.4
    np.testing.assert_allclose(camera.bearings(camera.project(rays[seen])), rays[seen], atol=1e-13)


@pytest.mark.parametrize(
    "camera",
    [
        rm.Camera(1000.0, 1010.0, 640.0, 480.0),
        *(rm.Camera.from_opencv(K, dist) for dist in DISTORTIONS.values()),
        rm.Camera.from_opencv_fisheye(K, FISHEYE),
    ],
    ids=["pinhole", *map(str, DISTORTIONS), "fisheye"],
)
def test_derivatives_and_noise_are_those_of_differences(camera: rm.Camera) -> None:
    pixels = whole_image()[::7]
    rays = camera.bearings(pixels)
    points = rays * np.random.default_rng(0).uniform(0.5, 9.0, (len(rays), 1))
    np.testing.assert_allclose(camera.jacobian(points), by_differences(camera, points), atol=1e-5, rtol=1e-6)
    step = 1e-3
    moved = [(camera.bearings(pixels + e) - camera.bearings(pixels - e)) / (2.0 * step) for e in step * np.eye(2)]
    numeric = np.stack(moved, axis=-1)
    length, axes = camera.axes(pixels)
    size = np.linalg.norm(length, axis=-1)[:, None, None]
    across = axes / size - rays[:, :, None] * np.einsum("nc,ncd->nd", rays, axes / size)[:, None]
    np.testing.assert_allclose(across, numeric, atol=1e-9)
    area = np.linalg.norm(np.cross(numeric[..., 0], numeric[..., 1]), axis=-1)
    np.testing.assert_allclose(camera.angular_noise(pixels, 0.7), 0.7 * np.sqrt(area), rtol=1e-6)
    np.testing.assert_allclose(camera.steradians(points), area, rtol=1e-6)


def test_beyond_the_fold_nothing_is_seen() -> None:
    # r − 0.6 r³ + 0.07 r⁵ turns round at r = 0.796, where it is 0.516
    camera = rm.Camera.from_opencv(K, [-0.6, 0.07, 0.0, 0.0])
    assert camera.bearings([[640.0 + 515.0, 480.0]])[0, 0] > 0.6
    with pytest.raises(InputError, match=r"1 of 2 pixels, at index 1, \(1160, 480\), lies outside .*radius 518 px"):
        camera.bearings([[640.0, 480.0], [1160.0, 480.0]])
    assert camera.sees([[0.78, 0.0, 1.0]]).all()
    assert not camera.sees([[0.81, 0.0, 1.0], [0.1, 0.0, -1.0]]).any()
    with pytest.raises(InputError, match="image circle"):
        rm.Camera.from_opencv_fisheye(K, FISHEYE).bearings([[9000.0, 0.0]])


@pytest.mark.parametrize(
    "dist",
    [
        [0.0] * 5,
        [1e-3] * 14,
        [-0.4, 0.3, 0.01, -0.01, -0.1],
        [2.0, -1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 9.0, 0.0, 0.0],
    ],
)
def test_every_lens_is_inverted_up_to_its_fold(dist: list[float]) -> None:
    camera = rm.Camera(1000.0, 1000.0, 0.0, 0.0, Brown(tuple(dist)))
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    radii = np.linspace(0.0, 0.98 * min(camera.lens.fold, 3.0), 30)
    plane = (radii[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)).reshape(-1, 2)
    points = np.column_stack([plane, np.ones(len(plane))])
    back = camera.bearings(camera.project(points))
    np.testing.assert_allclose(camera.project(back), camera.project(points), atol=1e-9)
    # where tangential terms fold the image a little before its radial part does, another point has the same pixel
    slope = np.linalg.det(camera.lens.project_plane(plane)[1])
    tame = slope > 0.02 * slope[0]
    assert tame.mean() > 0.9
    np.testing.assert_allclose((back[:, :2] / back[:, 2:])[tame], plane[tame], atol=1e-9)


def test_no_coefficients_are_a_pinhole() -> None:
    pinhole = rm.Camera.from_matrix(K)
    assert rm.Camera.from_opencv(K) == rm.Camera.from_opencv(K, np.zeros((1, 5))) == pinhole
    camera = rm.Camera.from_opencv(K, DISTORTIONS[5])
    assert camera == rm.Camera.from_opencv(K, np.array(DISTORTIONS[5])[:, None]) != pinhole
    assert len({camera, rm.Camera.from_opencv(K, DISTORTIONS[5])}) == 1
    assert pickle.loads(pickle.dumps(camera)) == camera


@pytest.mark.parametrize(
    ("dist", "message"),
    [
        ([1.0, 2.0, 3.0], "4, 5, 8, 12 or 14"),
        ([[0.0, 0.0], [0.0, 0.0]], "4, 5, 8, 12 or 14"),
        ([[0, 0], [0]], "not a list of numbers"),
        ([0.0, 0.0, np.nan, 0.0], "NaN"),
        ([10**400, 0, 0, 0], "numbers"),
        ([1e300, 0, 0, 0], "no lens"),
        ("wide", "numbers"),
    ],
)
def test_coefficients_that_are_none_are_refused(dist: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        rm.Camera.from_opencv(K, dist)  # type: ignore[arg-type]
    with pytest.raises(InputError):
        rm.Camera.from_opencv_fisheye(K, dist)  # type: ignore[arg-type]


@pytest.mark.parametrize("focal", [1e-300, 1e-7, 10**400, 1e300])
def test_absurd_focal_lengths_are_refused(focal: float) -> None:
    with pytest.raises(InputError, match="fx"):
        rm.Camera(focal, 1000.0, 0.0, 0.0)
    with pytest.raises(InputError, match="lens"):
        rm.Camera(1000.0, 1000.0, 0.0, 0.0, "fisheye")  # type: ignore[arg-type]


def test_the_stereographic_chart_is_conformal_and_holds_all_around() -> None:
    rays = np.array([instances.random_unit(np.random.default_rng(k)) for k in range(300)])
    camera, plane, sigma = UnitRays().chart(rays, np.full(300, 1e-3))
    assert isinstance(camera, Stereographic)
    np.testing.assert_allclose(camera.bearings(plane), rays, atol=1e-13)
    numeric = by_differences(camera, rays)
    np.testing.assert_allclose(camera.jacobian(rays), numeric, rtol=1e-4, atol=1e-6)
    gram = numeric @ numeric.swapaxes(-1, -2)
    np.testing.assert_allclose(gram, (sigma / 1e-3)[:, None, None] ** 2 * np.eye(2), rtol=1e-4, atol=1e-4)


def test_bearings_are_a_measurement_and_a_camera() -> None:
    rays = rm.Bearings()
    problem = rm.P3P(rays)
    assert (problem.source_dimension, problem.target_dimension) == (3, 3)
    assert rm.ThreePlusOne(rays, rm.Camera.from_matrix(K), axis=(0, 1, 0), axis2=(0, 1, 0)).source_dimension == 3
    assert rm.ThreePlusOne(rays, rm.Camera.from_matrix(K), axis=(0, 1, 0), axis2=(0, 1, 0)).target_dimension == 2
    assert rm.Bearings(rm.Camera.from_matrix(K)).dimension == 2
    with pytest.raises(InputError, match="give the camera itself"):
        rm.P3P(rm.Bearings(rm.Camera.from_matrix(K)))
    with pytest.raises(InputError, match="radians"):
        problem.validated(np.eye(4)[:, :3], np.eye(4)[:, :3] + 0.1, noise=1.0)
    with pytest.raises(InputError, match="length 0"):
        rm.Bearings().bearings([[0.0, 0.0, 0.0]])
