"""The simulated scenes are those of the paper, and their truth is true."""

import numpy as np
import pytest

from rootmatch.errors import InputError
from rootmatch.simulation import p3p_scene, three_plus_one_scene, up2p_scene

SCENES = {
    "p3p": p3p_scene,
    "p3p, two motions": lambda **k: p3p_scene(motions=2, **k),
    "up2p": up2p_scene,
    "up2p, two motions": lambda **k: up2p_scene(motions=2, **k),
    "3p1, b = 1": three_plus_one_scene,
    "3p1, b = 5": lambda **k: three_plus_one_scene(baseline=5.0, **k),
}
WORLD = {name: make for name, make in SCENES.items() if not name.startswith("3p1")}


@pytest.fixture(params=SCENES, ids=str)
def make(request):
    return SCENES[request.param]


def centre(pose):
    """Camera centre in the frame of the points."""
    R, t = pose
    return -R.T @ t


def seen_in_camera(scene):
    """Camera-frame points and image points of the seen source points."""
    for i in np.flatnonzero(scene.truth >= 0):
        R, t = scene.poses[scene.motions[i]]
        yield R @ scene.points[i] + t, scene.target[scene.truth[i]]


def test_truth_reprojects_and_every_point_lies_in_front(make):
    for seed in range(20):
        scene = make(seed=seed, outliers=3, hidden=2)
        camera = scene.cameras[-1]
        for x, pixel in seen_in_camera(scene):
            assert x[2] > 1.0
            expected = camera.fx * x[0] / x[2] + camera.cx, camera.fy * x[1] / x[2] + camera.cy
            assert np.abs(np.array(expected) - pixel).max() < 1e-9
        for R, _ in scene.poses:  # rotations without a mirror
            assert np.abs(R @ R.T - np.eye(3)).max() < 1e-12
            assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-12)


def test_truth_is_one_to_one_and_says_who_is_hidden(make):
    scene = make(seed=1, n=9, outliers=4, hidden=6)
    assert scene.source.shape[0] == 15
    assert scene.target.shape == (13, 2)
    seen = scene.truth[scene.truth >= 0]
    assert len(set(seen.tolist())) == 9
    assert seen.max() < 13
    assert np.array_equal(scene.truth < 0, scene.motions < 0)


def test_same_seed_same_scene_and_another_seed_another(make):
    first, again, other = (make(seed=s, noise=0.5, outliers=5) for s in (4, 4, 5))
    for name in ("source", "target", "truth", "motions", "points"):
        assert np.array_equal(getattr(first, name), getattr(again, name))
    assert not np.array_equal(first.target, other.target)


def test_target_is_shuffled(make):
    truths = {tuple(make(seed=s).truth.tolist()) for s in range(10)}
    assert len(truths) == 10
    assert tuple(range(10)) not in truths


def test_scenes_of_one_seed_differ_only_in_what_was_asked(make):
    """Common random numbers: the noise scales, the outliers nest, the points and poses stay."""
    exact, fine, coarse = (make(seed=7, noise=s) for s in (0.0, 0.1, 1.0))
    assert np.allclose(coarse.target - exact.target, 10.0 * (fine.target - exact.target), atol=1e-9)
    five, ten = make(seed=7, outliers=5), make(seed=7, outliers=10)
    assert np.array_equal(five.points, ten.points)
    pixels = {tuple(p) for p in ten.target.tolist()}
    assert {tuple(p) for p in five.target.tolist()} < pixels


def test_noise_is_gaussian_of_the_given_sigma_in_pixels(make):
    pairs = [(make(seed=s, n=40, noise=0.5, outliers=10), make(seed=s, n=40, outliers=10)) for s in range(50)]
    error = np.concatenate([(noisy.target - exact.target).ravel() for noisy, exact in pairs]) / 0.5
    assert len(error) == 5000
    assert abs(error.mean()) < 4 / np.sqrt(5000)
    assert abs(error.std() - 1.0) < 4 / np.sqrt(10000)
    assert np.mean(np.abs(error) < 1.0) == pytest.approx(0.6827, abs=0.03)
    source = np.concatenate([(noisy.source - exact.source).ravel() for noisy, exact in pairs])
    if pairs[0][0].problem.source_dimension == 3:
        assert not source.any()  # the model is exact
    else:
        assert source.std() == pytest.approx(0.5, rel=0.06)  # both images are noisy
        assert abs(np.corrcoef(source[:1000], error[:1000])[0, 1]) < 0.13


def test_outliers_are_uniform_in_the_image():
    outliers = []
    for seed in range(40):
        scene = p3p_scene(seed=seed, outliers=25)
        outliers.append(np.delete(scene.target, scene.truth, axis=0))
    points = np.concatenate(outliers) / (640.0, 480.0)
    assert points.shape == (1000, 2)
    assert points.min() >= 0.0
    assert points.max() <= 1.0
    assert np.abs(points.mean(axis=0) - 0.5).max() < 4 / np.sqrt(12 * 1000)
    assert np.abs(points.var(axis=0) - 1 / 12).max() < 0.01


@pytest.mark.parametrize("name", WORLD)
def test_points_are_uniform_in_the_cube_of_side_four(name):
    points = np.concatenate([WORLD[name](seed=s, n=100).source for s in range(10)])
    assert np.abs(points).max() <= 2.0
    assert np.abs(points.mean(axis=0)).max() < 4 * 2.0 / np.sqrt(3 * 1000)
    assert np.abs(points.var(axis=0) - 4 / 3).max() < 0.15


def test_p3p_camera_is_uniform_on_the_sphere_looks_at_the_origin_and_rolls():
    poses = [p3p_scene(seed=s).poses[0] for s in range(400)]
    centres = np.array([centre(p) for p in poses])
    assert np.allclose(np.linalg.norm(centres, axis=1), 12.0)
    # uniform on a sphere: each coordinate is uniform (Archimedes)
    assert np.abs(centres.mean(axis=0)).max() < 4 * 12 / np.sqrt(3 * 400)
    assert np.abs((centres**2).mean(axis=0) - 48.0).max() < 8.0
    assert all(np.allclose(R[2], -c / 12.0) for (R, _), c in zip(poses, centres, strict=True))
    tilt = np.array([np.arctan2(R[0, 1], R[1, 1]) for R, _ in poses])
    assert np.abs(np.mean(np.exp(1j * tilt))) < 4 / np.sqrt(400)


def test_up2p_camera_is_level_on_the_equator_and_looks_at_the_origin():
    poses = [up2p_scene(seed=s).poses[0] for s in range(200)]
    for R, t in poses:
        c = centre((R, t))
        assert np.linalg.norm(c) == pytest.approx(12.0)
        assert abs(c[1]) < 1e-12
        assert np.allclose(R[2], -c / 12.0)
        assert np.allclose(R @ [0, 1, 0], [0, 1, 0])
    angles = np.array([np.arctan2(centre(p)[2], centre(p)[0]) for p in poses])
    assert np.abs(np.mean(np.exp(1j * angles))) < 4 / np.sqrt(200)


@pytest.mark.parametrize("baseline", [1.0, 5.0])
def test_3p1_cameras_stand_in_the_equatorial_plane_a_baseline_apart(baseline):
    for seed in range(100):
        scene = three_plus_one_scene(seed=seed, baseline=baseline)
        (R, t), camera = scene.poses[0], scene.cameras[0]
        assert np.linalg.norm(t) == pytest.approx(baseline)
        assert abs(t[1]) < 1e-12
        assert np.allclose(R @ [0, 1, 0], [0, 1, 0])
        # the origin lies 12 ahead of the first camera and on the optical axis of the second
        assert np.allclose((R @ [0.0, 0.0, 12.0] + t)[:2], 0.0)
        assert np.allclose(camera.project(scene.points), scene.source)


def test_motions_split_the_points_in_equal_groups_and_move_all_but_the_first():
    for make, vertical in ((p3p_scene, False), (up2p_scene, True)):
        still, moved = make(seed=2), make(seed=2, motions=2)
        assert np.bincount(moved.motions).tolist() == [5, 5]
        assert np.allclose(still.poses[0][0], moved.poses[0][0])
        (R0, t0), (R1, t1) = moved.poses
        turn, shift = R0.T @ R1, R0.T @ (t1 - t0)
        assert np.linalg.norm(shift) == pytest.approx(1.0)
        assert np.allclose(turn @ [0, 1, 0], [0, 1, 0]) == vertical
        assert not np.allclose(turn, np.eye(3))


def test_accuracy_counts_right_matches_among_the_points_that_have_an_image():
    scene = p3p_scene(n=4, hidden=2, seed=0)
    assert scene.accuracy(scene.truth) == 1.0
    wrong = scene.truth.copy()
    wrong[np.flatnonzero(wrong >= 0)[0]] = -1
    assert scene.accuracy(wrong) == 0.75
    assert scene.accuracy(np.full(6, -1)) == 0.0


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"n": 0}, "n is"),
        ({"outliers": -1}, "outliers"),
        ({"noise": -0.1}, "noise"),
        ({"noise": np.nan}, "noise"),
        ({"seed": -1}, "seed"),
        ({"n": 3, "motions": 4}, "motions"),
        ({"hidden": 1.5}, "hidden"),
    ],
)
def test_numbers_out_of_range_are_named(arguments, word):
    with pytest.raises(InputError, match=word):
        up2p_scene(**arguments)


@pytest.mark.parametrize("baseline", [0.0, 9.5, np.nan])
def test_baseline_must_leave_the_points_in_front(baseline):
    with pytest.raises(InputError, match="baseline"):
        three_plus_one_scene(baseline=baseline)
