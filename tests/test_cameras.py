"""The camera's rays, pixels and noise, and the turn of a measured direction to y."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import instances
import oracles
from rootmatch.cameras.pinhole import Camera
from rootmatch.cameras.vertical import rotation_to_vertical
from rootmatch.errors import InputError, InputWarning, RootmatchError

INTRINSICS = (900.0, 1100.0, 310.0, 250.0)


@pytest.fixture
def pixels() -> np.ndarray:
    return np.random.default_rng(0).uniform((-800.0, -900.0), (1500.0, 1400.0), (50, 2))


def test_bearings_are_the_oracles_unit_rays(pixels: np.ndarray) -> None:
    rays = Camera(*INTRINSICS).bearings(pixels)
    assert rays.shape == (50, 3)
    np.testing.assert_allclose(rays, oracles.bearings(pixels, INTRINSICS), atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, atol=1e-15)


def test_project_undoes_bearings_at_any_depth(pixels: np.ndarray) -> None:
    camera = Camera(*INTRINSICS)
    depth = np.random.default_rng(1).uniform(0.1, 1e6, (50, 1))
    np.testing.assert_allclose(camera.project(depth * camera.bearings(pixels)), pixels, rtol=1e-13)


def test_image_axes_point_right_and_down() -> None:
    camera = Camera(*INTRINSICS)
    np.testing.assert_allclose(camera.bearings([[310.0, 250.0]]), [[0.0, 0.0, 1.0]], atol=1e-16)
    assert camera.bearings([[311.0, 250.0]])[0, 0] > 0.0
    assert camera.bearings([[310.0, 251.0]])[0, 1] > 0.0


def test_angular_noise_covers_the_solid_angle_of_the_pixel_noise(pixels: np.ndarray) -> None:
    expected = oracles.solid_angle_sigma(pixels, INTRINSICS, 0.7)
    np.testing.assert_allclose(Camera(*INTRINSICS).angular_noise(pixels, 0.7), expected, rtol=1e-6)


def test_angular_noise_takes_one_sigma_a_pixel(pixels: np.ndarray) -> None:
    camera = Camera(*INTRINSICS)
    sigma = np.linspace(0.1, 3.0, 50)
    np.testing.assert_allclose(
        camera.angular_noise(pixels, sigma), sigma * camera.angular_noise(pixels, 1.0), rtol=1e-14
    )


def test_angular_noise_is_the_spread_of_noisy_rays() -> None:
    camera = Camera(*INTRINSICS)
    rng = np.random.default_rng(2)
    for pixel in ((310.0, 250.0), (900.0, -200.0)):
        ray = camera.bearings([pixel])[0]
        spread = camera.bearings(np.array(pixel) + 0.5 * rng.normal(size=(20000, 2))) @ oracles.tangents(ray).T
        area = np.sqrt(np.linalg.det(np.cov(spread.T)))
        # 20,000 samples: the area is known to about 1 %
        assert area == pytest.approx(camera.angular_noise([pixel], 0.5)[0] ** 2, rel=0.04)


def test_from_matrix() -> None:
    matrix = [[900.0, 0.0, 310.0], [0.0, 1100.0, 250.0], [0.0, 0.0, 1.0]]
    assert Camera.from_matrix(matrix) == Camera(*INTRINSICS)
    assert Camera.from_matrix(2.0 * np.array(matrix)) == Camera(*INTRINSICS)


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(2),
        [[900.0, 5.0, 310.0], [0.0, 1100.0, 250.0], [0.0, 0.0, 1.0]],
        [[900.0, 0.0, 310.0], [0.0, 1100.0, 250.0], [0.1, 0.0, 1.0]],
        [[900.0, 0.0, 310.0], [0.0, -1100.0, 250.0], [0.0, 0.0, 1.0]],
        [[900.0, 0.0, 310.0], [0.0, 1100.0, 250.0], [0.0, 0.0, 0.0]],
        [[np.nan, 0.0, 310.0], [0.0, 1100.0, 250.0], [0.0, 0.0, 1.0]],
    ],
)
def test_from_matrix_refuses_what_is_no_calibration(matrix: object) -> None:
    with pytest.raises(InputError):
        Camera.from_matrix(matrix)


@pytest.mark.parametrize("position", range(4))
@pytest.mark.parametrize("value", [float("nan"), float("inf"), "wide", None])
def test_camera_refuses_what_is_no_number(position: int, value: object) -> None:
    numbers: list[object] = list(INTRINSICS)
    numbers[position] = value
    with pytest.raises(InputError, match=("fx", "fy", "cx", "cy")[position]):
        Camera(*numbers)  # type: ignore[arg-type]


@pytest.mark.parametrize("size", [640, "large", (640,), (640, 480, 3), (640, 0), (640, np.nan), (np.inf, 480)])
def test_camera_refuses_what_is_no_size(size: object) -> None:
    with pytest.raises(InputError, match=r"camera: size is .*width and height"):
        Camera(*INTRINSICS, size=size)  # type: ignore[arg-type]


def test_an_image_is_as_large_as_its_size_or_as_the_principal_point_says() -> None:
    target = np.array([[0.0, 0.0], [600.0, 400.0]])
    plain, sized = Camera(*INTRINSICS), Camera(*INTRINSICS, size=(700, 480))
    assert (plain.image_areas(target), sized.image_areas(target)) == (620.0 * 500.0, 700.0 * 480.0)
    assert sized.image_areas(target + 81.0) is None
    pixels = np.array([[350.0, 240.0], [0.0, 100.0], [-17.5, 100.0], [-40.0, 100.0], [690.0, 480.0]])
    np.testing.assert_allclose(sized.in_image(pixels), [1.0, 0.5, 0.25, 0.0, 0.5])
    assert plain.in_image(pixels).all()


@pytest.mark.parametrize("position", [0, 1])
@pytest.mark.parametrize("value", [0.0, -1000.0])
def test_camera_refuses_a_focal_length_that_is_not_positive(position: int, value: float) -> None:
    numbers = list(INTRINSICS)
    numbers[position] = value
    with pytest.raises(InputError, match="positive") as caught:
        Camera(*numbers)
    assert isinstance(caught.value, ValueError)
    assert isinstance(caught.value, RootmatchError)


def _directions() -> list[np.ndarray]:
    rng = np.random.default_rng(3)
    y = np.array([0.0, 1.0, 0.0])
    made = [instances.random_unit(rng) for _ in range(50)] + [
        y,
        -y,
        np.array([1.0, 0.0, 0.0]),
        np.array([0.0, 0.0, -1.0]),
    ]
    # close to y and, where the turn is ill-defined, close to -y
    for tilt in (1e-2, 1e-4, 1e-6, 1e-8, 1e-12):
        across = instances.random_unit(rng) * (1.0, 0.0, 1.0)
        made += [y + tilt * across, -y + tilt * across]
    return made


@pytest.mark.parametrize("length", [1.0, 1e-6, 3e7])
def test_turn_to_y_is_a_rotation_onto_y(length: float) -> None:
    for direction in _directions():
        turn = rotation_to_vertical(length * direction)
        np.testing.assert_allclose(turn @ (direction / np.linalg.norm(direction)), [0.0, 1.0, 0.0], atol=1e-14)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(turn) == pytest.approx(1.0, abs=1e-14)


def test_turn_to_y_is_the_smallest_turn() -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        direction = instances.random_unit(rng)
        angle = np.arccos(np.clip(direction[1], -1.0, 1.0))
        turned = np.arccos((np.trace(rotation_to_vertical(direction)) - 1.0) / 2.0)
        assert turned == pytest.approx(angle, abs=1e-7)


@pytest.mark.parametrize("direction", [(0.0, 0.0, 0.0), (0.0, 1.0), (0.0, np.nan, 1.0), (np.inf, 0.0, 0.0)])
def test_turn_to_y_refuses_what_is_no_direction(direction: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="gravity"):
        rotation_to_vertical(direction, "gravity")


def test_a_camera_that_gives_the_principal_point_first_is_asked_about() -> None:
    with pytest.warns(InputWarning, match="check the order: fx, fy, cx, cy"):
        Camera(640, 480, 700, 700)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Camera(700, 690, 640, 480)


def test_a_camera_refuses_rows_of_another_length() -> None:
    camera = Camera(800.0, 800.0, 640.0, 480.0)
    with pytest.raises(InputError, match=r"points of shape \(2,\) given; give \(…, 3\)"):
        camera.project([1.0, 2.0])
    with pytest.raises(InputError, match=r"pixels of shape \(4, 3\) given; give \(…, 2\)"):
        camera.bearings(np.zeros((4, 3)))


@pytest.mark.parametrize("given", [(np.eye(3),), (np.eye(3), [0.1, 0.0, 0.0, 0.0]), (900.0,), ()])
def test_a_matrix_is_told_where_it_goes(given: tuple[object, ...]) -> None:
    with pytest.raises(InputError, match="to Camera\\.from_matrix"):
        Camera(*given)  # type: ignore[arg-type]


def test_every_way_to_a_camera_takes_the_size_of_its_image() -> None:
    K, size = Camera(*INTRINSICS).matrix, (640.0, 480.0)
    every = [
        Camera.from_matrix(K, size=size),
        Camera.from_opencv(K, size=size),
        Camera.from_opencv(K, np.zeros(5), size=size),
        Camera.from_opencv(K, [0.1, 0.0, 0.0, 0.0], size=size),
        Camera.from_opencv_fisheye(K, [0.1, 0.0, 0.0, 0.0], size=size),
    ]
    assert all(one.size == size and one.numbers == INTRINSICS for one in every)
    with pytest.raises(InputError, match="camera: size"):
        Camera.from_matrix(K, size=(640.0, 0.0))
