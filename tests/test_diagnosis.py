"""What `Match.diagnose` names where nothing fits: one mistake at a time is made, and found."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import rootmatch as rm
from rig_scenes import four_about
from rootmatch.cli import app
from rootmatch.deadline import Deadline
from rootmatch.explain import calibration_mistakes, sampling
from rootmatch.explain.mistake import scale_noise
from rootmatch.explain.usual_mistakes import usual_mistakes

CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)
BROWN = rm.Camera.from_opencv(CAMERA.matrix, [-0.3, 0.1, 0.0, 0.0])
FISHEYE = rm.Camera.from_opencv_fisheye([[330.0, 0, 640], [0, 330, 480], [0, 0, 1]], [0.08, -0.02, 0.004, -0.0008])
SECONDS = 120.0
"""For all mistakes together, on a loaded machine."""


def scene(seed: int, camera: rm.Camera = CAMERA, noise: float = 0.3, count: int = 8) -> dict[str, Any]:
    """Points of a body and two stray detections, with what `rootmatch.match` takes."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.3, 0.3, (count, 3))
    R = Rotation.random(random_state=seed).as_matrix()
    # a lens matters far from the centre
    seen = camera.project(points @ R.T + ((0.5, -0.3, 0.7) if camera is FISHEYE else (0.05, -0.08, 1.0)))
    clutter = rng.uniform(seen.min(axis=0), seen.max(axis=0), (2, 2))
    target = rng.permutation(np.vstack([seen, clutter])) + rng.normal(0, noise, (count + 2, 2))
    return {"source": points, "target": target, "problem": rm.P3P(camera), "noise": noise}


def mistaken(mistake: str, seed: int) -> dict[str, Any]:
    """A scene with one mistake."""
    given = scene(seed, BROWN if "undistorted" in mistake else CAMERA)
    if mistake.startswith("y is measured upwards"):
        given["target"] = given["target"] * (1, -1) + (0, 960)
    elif mistake.startswith("x and y"):
        given["target"] = given["target"][:, ::-1]
    elif "half the size" in mistake:
        given["problem"] = rm.P3P(rm.Camera(450, 450, 320, 240))
    elif "twice the size" in mistake:
        given["problem"] = rm.P3P(rm.Camera(1800, 1800, 1280, 960))
    elif "fisheye" in mistake:
        given = scene(seed, FISHEYE)
        given["problem"] = rm.P3P(rm.Camera.from_opencv(FISHEYE.matrix, FISHEYE.lens.values))
    elif "noise" in mistake:  # so much that points which are off do not explain it
        given = scene(seed, noise=6.0) | {"noise": 0.6}
    elif "undistorted" in mistake:
        rays = BROWN.bearings(given["target"])
        given["target"] = CAMERA.project(rays)
    return given


@pytest.mark.parametrize(
    ("mistake", "seed"),
    [
        ("y is measured upwards in the image, or the model is left-handed", 1),
        ("x and y of the image are swapped", 1),
        ("the camera was calibrated at half the size of the image", 1),
        ("the lens coefficients are those of a fisheye", 1),
        ("the detections were undistorted already", 4),  # of others, a pose and points that are off absorb most of it
        ("the noise is 10 times as large", 2),
    ],
)
def test_the_mistake_that_was_made_is_named_first(mistake: str, seed: int) -> None:
    match = rm.match(**mistaken(mistake, seed))
    assert not match
    found = match.diagnose(SECONDS)
    assert found.fits, str(found)
    first = found.fits[0]
    assert (first.mistake, first.matched) == (mistake, 8)
    assert first.probability == max(one.probability for one in found.trials)
    assert first.remedy in str(found)
    assert "as given: " in str(found)


def test_inward_normals() -> None:
    given = scene(2)
    outward = given["source"] / np.linalg.norm(given["source"], axis=1, keepdims=True)
    camera, R = CAMERA, Rotation.random(random_state=2).as_matrix()
    moved = given["source"] @ R.T + (0.05, -0.08, 1.0)
    towards = -np.einsum("ij,ij->i", moved, outward @ R.T) > 0.1
    given["target"] = camera.project(moved[towards]) + np.random.default_rng(0).normal(0, 0.3, (towards.sum(), 2))
    assert rm.match(**given, normals=outward)
    found = rm.match(**given, normals=-outward).diagnose(SECONDS)
    assert "the normals point inwards" in [one.mistake for one in found.fits]


@pytest.mark.parametrize(("in_fractions", "sigma_too"), [(False, True), (True, False)])
def test_an_image_that_is_not_in_pixels(in_fractions: bool, sigma_too: bool) -> None:
    camera = replace(BROWN, size=(1280.0, 960.0))
    given = scene(3, CAMERA if not in_fractions else BROWN, count=6)
    scale, offset = ((1280.0, 960.0), (0.0, 0.0)) if in_fractions else ((900.0, 900.0), (640.0, 480.0))
    given |= {"target": (given["target"] - offset) / scale, "problem": rm.P3P(camera)}
    if sigma_too:
        given["noise"] /= math.sqrt(math.prod(scale))
    match = rm.match(**given)
    assert not match
    first = match.diagnose(SECONDS).fits[0]
    told = "the image is in fractions of its size" if in_fractions else "the image is in normalised coordinates"
    assert first.mistake.startswith(told)
    assert first.matched == 6
    assert ("give the noise in pixels too" in first.remedy) == sigma_too


def test_a_rig_whose_images_are_not_in_pixels() -> None:
    points, every, four, *_ = four_about(n=6, each=5)
    rows, rig = every[every[:, 2] < 3], rm.Rig(four.views[:3], sizes=None if four.sizes is None else four.sizes[:3])
    match = rm.match(points, rows, rm.P3P(rig), noise=0.5)
    assert match
    wrong = rows.copy()
    wrong[:, :2] = (rows[:, :2] - (640.0, 480.0)) / 800.0
    match = rm.match(points, wrong, rm.P3P(rig), noise=0.5)
    assert not match
    fits = match.diagnose(SECONDS).fits
    assert "the image is in normalised coordinates (x/z, y/z)" in [one.mistake for one in fits]


HANDED = "one of the sets is left-handed"
METRES = r"the sets have different units: the source is (1000|999\.\d) times the target \(metres and millimetres\?\)"


@pytest.mark.parametrize(
    ("change", "noise", "mistake"),
    [
        ((-1.0, 1.0, 1.0), 0.2, HANDED),
        (1e-3, (0.2, 0.0002), METRES),
        (1e-3, (0.0, 0.0002), METRES),
        (1e-3, 0.2, METRES),
        (1e-3, (0.0, 0.2), METRES),
        (1e-3, 0.0002, METRES),
        (1.0 / 25.4, (0.0, 0.2), r".*: the source is 25\.\d+ times the target \(inches and millimetres\?\)"),
        (1.02, (0.0, 0.2), r"a scale of 1\.0\d+ fits"),
        ((-1e-3, 1e-3, 1e-3), (0.0, 0.2), f"{HANDED}, and {METRES}"),
        ((-1.02, 1.02, 1.02), (0.0, 0.2), rf"{HANDED}, and a scale of 1\.0\d+ fits"),
    ],
)
def test_point_sets_that_are_mirrored_or_scaled(change: Any, noise: Any, mistake: str) -> None:
    rng = np.random.default_rng(3)
    plan = rng.uniform(-80, 80, (8, 3))
    seen = plan @ Rotation.random(random_state=3).as_matrix().T + 300.0 + rng.normal(0, 0.2, (8, 3))
    match = rm.match(plan, seen * change, rm.Rigid(), noise=noise)
    assert not match
    assert re.match(f"no trustworthy match: {mistake}; ", match.advice)
    assert ("LPS and RAS differ in two axes" in match.advice) is (HANDED in mistake)
    found = match.diagnose(SECONDS)
    assert re.fullmatch(mistake, found.fits[0].mistake), str(found)
    assert not [one for one in found.fits[1:] if not one.mistake.startswith("the noise is")], str(found)


def test_lps_and_ras_differ_by_a_rotation() -> None:
    plan = np.random.default_rng(3).uniform(-80, 80, (8, 3))
    assert rm.match(plan, plan * (-1, -1, 1) + 300.0, rm.Rigid(), noise=(0.0, 0.2))


def test_exchanged_cameras_of_a_rig_are_named() -> None:
    rng, turn = np.random.default_rng(2), Rotation.from_euler("y", 25.0, degrees=True).as_matrix()
    places = [(np.eye(3), np.zeros(3)), (turn, np.array([-0.3, 0.0, 0.0])), (np.eye(3), np.array([0.0, -0.3, 0.0]))]
    views = [(CAMERA, R, t) for R, t in places]
    points = rng.uniform(-0.2, 0.2, (7, 3))
    seen = points @ Rotation.random(random_state=2).as_matrix().T + (0.1, 0.0, 1.5)
    pixels = np.vstack([CAMERA.project(seen @ R.T + t) for _, R, t in views]) + rng.normal(0.0, 0.3, (21, 2))
    given = rm.Rig([views[1], views[0], views[2]])
    match = rm.match(points, (pixels, np.repeat([0, 1, 2], 7)), rm.P3P(given), noise=0.3)
    first = match.diagnose(SECONDS).fits[0]
    assert (first.mistake, first.matched) == ("cameras 0 and 1 are swapped", 7)
    assert "diagnose" in match.advice


def test_what_a_camera_shows_by_itself_is_searched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the cameras of a rig are, and the unit of the model, change nothing in the image of any."""
    rng, searched = np.random.default_rng(2), list[str]()
    turn = Rotation.from_euler("y", 25.0, degrees=True).as_matrix()
    views = [(CAMERA, np.eye(3), np.zeros(3)), (CAMERA, turn, np.array([-0.3, 0.0, 0.0]))]
    pixels = rng.uniform(0.0, 900.0, (24, 2)), np.repeat([0, 1], 12)
    match = rm.match(rng.uniform(-0.2, 0.2, (8, 3)), pixels, rm.P3P(rm.Rig(views)), noise=0.3)
    search = sampling.sample
    monkeypatch.setattr(sampling, "sample", lambda task: searched.append("") or search(task))
    diagnosis = match.diagnose(SECONDS)
    about_places = [one.mistake for one in diagnosis.trials if "rig" in one.mistake or "exchanged" in one.mistake]
    assert len(about_places) > 8
    # one pair of searches is for all of these
    assert len(searched) <= 2 * (len(diagnosis.trials) - len(about_places) + 2)


@pytest.mark.parametrize("knocked", [None, 0, 2])
def test_a_camera_that_was_knocked_is_named(knocked: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    rng, turn = np.random.default_rng(4), Rotation.from_euler("y", 25.0, degrees=True).as_matrix()
    places = [(np.eye(3), np.zeros(3)), (turn, np.array([-0.3, 0.0, 0.0])), (np.eye(3), np.array([0.0, -0.3, 0.0]))]
    points = rng.uniform(-0.2, 0.2, (7, 3))
    seen = points @ Rotation.random(random_state=2).as_matrix().T + (0.1, 0.0, 1.5)
    pixels = [np.vstack([CAMERA.project(seen @ R.T + t), rng.uniform(0.0, 640.0, (2, 2))]) for R, t in places]
    target = np.vstack(pixels) + rng.normal(0.0, 0.3, (27, 2)), np.repeat([0, 1, 2], 9)
    if knocked is not None:
        R, t = places[knocked]
        places[knocked] = Rotation.from_rotvec([0.03, -0.04, 0.02]).as_matrix() @ R, t + np.array([0.01, 0.0, -0.01])
    match = rm.match(
        points, target, rm.P3P(rm.Rig([(CAMERA, R, t) for R, t in places])), noise=0.3, max_seconds=SECONDS
    )
    match.task.deadline.ends = 0.0  # long ago
    bounds, explain = list[Deadline](), calibration_mistakes.explain
    monkeypatch.setattr(calibration_mistakes, "explain", lambda task: bounds.append(task.deadline) or explain(task))
    named = [one.mistake for one in match.diagnose(SECONDS).fits if one.mistake.startswith("camera ")]
    assert bounds
    assert all(bound.is_set and bound.seconds < SECONDS / 3 for bound in bounds), "no trial takes the time of others"
    assert named == ([] if knocked is None else [f"camera {knocked} is not where the rig has it"])


@pytest.mark.parametrize(
    ("change", "mistake"),
    [
        (lambda R, t: (R, -R.T @ t), "the positions C of the cameras are given as t"),
        (lambda R, t: (R.T, -R.T @ t), "the camera poses map to the rig"),
        (
            lambda R, t: (np.diag([1, -1, -1]) @ R, np.array([1, -1, -1]) * t),
            "the axes of the cameras are those of OpenGL, y up and z backwards",
        ),
        (0.3048, "the model is in feet, the rig in metres"),
        (0.0254, "the model is in inches, the rig in metres"),
        (None, None),
    ],
)
def test_poses_of_cameras_in_another_convention_and_units(change: Any, mistake: str | None) -> None:
    rng = np.random.default_rng(5)
    views, points, rows = four_about(seed=5).rig.views[:3], rng.uniform(-0.3, 0.3, (7, 3)), list[Any]()
    seen = points @ Rotation.random(random_state=5).as_matrix().T + (0.3, -0.2, 0.1)
    for k, (camera, R, t) in enumerate(views):
        pixels = camera.project(seen @ np.array(R).T + t) + rng.normal(0.0, 0.3, (7, 2))
        rows += [(*pixel, k) for pixel in [*pixels.tolist(), *rng.uniform(100.0, 900.0, (2, 2)).tolist()]]
    given = views if not callable(change) else [(camera, *change(np.array(R), np.array(t))) for camera, R, t in views]
    scale = change if isinstance(change, float) else 1.0
    match = rm.match(points / scale, np.array(rows), rm.P3P(rm.Rig(given)), noise=0.3)
    named = [one.mistake for one in match.diagnose(SECONDS).fits]
    assert named[:1] == ([] if mistake is None else [mistake])
    assert bool(match) == (mistake is None)


def test_a_model_in_millimetres_before_a_rig_in_metres() -> None:
    rng, turn = np.random.default_rng(0), Rotation.from_rotvec([0.0, 0.1, 0.0]).as_matrix()
    rig = rm.Rig([(CAMERA, np.eye(3), np.zeros(3)), (CAMERA, turn, np.array([-0.3, 0.0, 0.0]))])
    points = rng.uniform(-0.3, 0.3, (8, 3))
    seen = points @ Rotation.random(random_state=0).as_matrix().T + (0.05, -0.08, 1.0)
    pixels = np.vstack([CAMERA.project(seen @ np.transpose(R) + t) for _, R, t in rig.views]) + rng.normal(
        0, 0.3, (16, 2)
    )
    given = (pixels, np.repeat([0, 1], 8)), rm.P3P(rig)
    assert rm.match(points, *given, noise=0.3)
    match = rm.match(1000.0 * points, *given, noise=0.3)
    assert not match
    assert (
        match.status is not rm.Status.AMBIGUOUS
        or "check that the points and the rig have the same unit" in match.advice
    )
    (first,) = match.diagnose(SECONDS).fits
    assert (first.mistake, first.matched) == ("the model is in millimetres, the rig in metres", 8)


@pytest.mark.parametrize("kind", ["pose", "parts"])
def test_what_is_wrong_about_a_prior(kind: str) -> None:
    """Four points, which only what is known of their pose tells from clutter."""
    rng, R, t = np.random.default_rng(7), Rotation.random(random_state=7).as_matrix(), np.array([0.05, -0.08, 1.0])
    points = rng.uniform(-0.3, 0.3, (4, 3))
    clutter = rng.uniform((400, 250), (900, 750), (4, 2))
    target = np.vstack([CAMERA.project(points @ R.T + t), clutter]) + rng.normal(0, 0.3, (8, 2))
    right = rm.Pose(R, t, np.diag([0.02**2] * 6))
    millimetres = rm.Pose(R, 1000.0 * t, np.diag([0.02**2] * 3 + [20.0**2] * 3))
    for pose, mistake in (
        (right, None),
        (right.inverse(), "the prior is the inverse of the pose"),
        (millimetres, "the position of the prior is in millimetres, the points are in metres"),
    ):
        assert pose.covariance is not None
        own = pose.covariance[:3, :3], pose.covariance[3:, 3:]
        parts = rm.PosePrior(rotation=(pose.R, own[0]), position=(pose.t, own[1]))
        match = rm.match(points, target, rm.P3P(CAMERA), noise=0.3, prior=pose if kind == "pose" else parts)
        assert bool(match) is (mistake is None)
        assert [one.mistake for one in match.diagnose(SECONDS).fits] == ([] if mistake is None else [mistake])


def test_half_a_pixel_is_named_once_and_only_if_no_other_shift_fits_as_well() -> None:
    R, half = Rotation.random(random_state=3).as_matrix(), "the principal point is off by half a pixel"
    given = scene(3)
    seen = CAMERA.project(given["source"] @ R.T + (0.3, -0.25, 0.7))
    noise = np.random.default_rng(3).normal(0, 0.02, seen.shape)
    found = rm.match(**given | {"target": seen + 0.5 + noise, "noise": 0.02}).diagnose(SECONDS)
    assert [one.mistake for one in found.fits].count(half) == 1
    assert found.fits[0].mistake == half
    # five points and a wrong prior: without it they match, wherever the principal point is
    few = given | {"source": given["source"][:5], "target": seen[:5] + 10.0 * noise[:5]}
    match = rm.match(**few, prior=rm.PosePrior(rotation=(R.T, 0.02)))
    assert "the prior is the inverse of the pose" in [one.mistake for one in match.diagnose(SECONDS).fits]
    assert half not in [one.mistake for one in match.diagnose(SECONDS).fits]


@pytest.mark.parametrize(
    ("given", "seed", "mistake", "found"),
    [
        (rm.Camera(720.0, 720.0, 640.0, 480.0), 1, "the focal length is wrong", "fx is about 900"),
        (CAMERA, 6, "the camera's distortion was left out", "k1 about -0.3"),
    ],
)
def test_a_wrong_calibration_is_named_with_one_that_fits(given: rm.Camera, seed: int, mistake: str, found: str) -> None:
    with_lens = given is CAMERA
    made = scene(seed, rm.Camera.from_opencv(CAMERA.matrix, [-0.3, 0.0, 0.0, 0.0]) if with_lens else CAMERA, count=10)
    match = rm.match(**made | {"problem": rm.P3P(given)})
    assert not match
    first = match.diagnose(SECONDS).fits[0]
    assert first.mistake.startswith(f"{mistake}: ")
    assert found in first.mistake
    assert first.matched == 10


def test_a_focal_length_is_fitted_beside_a_model_that_is_not_exact() -> None:
    given = scene(1, count=14)
    wrong = rm.P3P(replace(CAMERA, fx=0.97 * CAMERA.fx, fy=0.97 * CAMERA.fy))
    match = rm.match(**given | {"problem": wrong, "source_noise": 1e-4})
    assert not match
    first = match.diagnose(SECONDS).fits[0].mistake
    assert first.startswith("the focal length is wrong: fx is about ")
    assert float(first.split()[8]) == pytest.approx(CAMERA.fx, rel=0.01)


def test_a_calibration_is_not_fitted_to_few_points() -> None:
    match = rm.match(**scene(2, count=6) | {"problem": rm.P3P(rm.Camera(630.0, 630.0, 640.0, 480.0))})
    assert not [one.mistake for one in match.diagnose(SECONDS).fits if "focal" in one.mistake]


@pytest.mark.parametrize(("axis", "mistake"), [(1, "the model is left-handed"), (2, "heights of the model are depths")])
@pytest.mark.parametrize("zoomed", [False, True])
def test_a_mirrored_model_before_a_rolled_camera_that_knows_the_vertical(axis: int, mistake: str, zoomed: bool) -> None:
    """A mirrored image would have another vertical than the camera tells."""
    rng = np.random.default_rng(12)
    points, up = (
        rng.uniform(-0.4, 0.4, (12, 3)),
        Rotation.from_euler("zyx", (12.0, 70.0, 95.0), degrees=True).as_matrix(),
    )
    target = CAMERA.project(points @ up.T + (0.05, -0.1, 1.6)) + rng.normal(0.0, 0.3, (12, 2))
    verticals = {"vertical_camera": tuple(up @ (0.0, 0.0, -1.0)), "vertical_world": (0.0, 0.0, -1.0)}
    problem = rm.UP2PF((CAMERA.cx, CAMERA.cy), **verticals) if zoomed else rm.UP2P(CAMERA, **verticals)
    points[:, axis] *= -1.0
    first = rm.match(points, target, problem, noise=0.3).diagnose(SECONDS).fits[0]
    assert (first.mistake, first.matched) == (mistake, 12)


def test_nothing_is_named_where_nothing_is_to_be_found() -> None:
    rng = np.random.default_rng(4)
    match = rm.match(rng.uniform(-0.3, 0.3, (8, 3)), rng.uniform(0, 900, (9, 2)), rm.P3P(CAMERA), noise=0.3)
    found = match.diagnose(SECONDS)
    assert found.fits == ()
    assert str(found).startswith(
        f"diagnosis: none of the {len(found.trials)} usual mistakes explains the points by itself"
    )
    assert found.nearest is None
    assert "nearest" not in str(found)
    assert all(one.probability is None or one.probability < 0.5 for one in found.trials)


def test_what_there_is_no_time_for_is_counted() -> None:
    found = rm.match(**mistaken("x and y", 1)).diagnose(1e-9)
    assert found.trials == ()
    assert found.left_out > 5
    assert f"no time for {found.left_out} more" in str(found)


def names(match: rm.Match) -> set[str]:
    return {mistake.name for mistake in usual_mistakes(match.task)}


def test_mistakes_are_those_that_a_problem_allows() -> None:
    """Each can be made into a task; what a problem has not is not tried."""
    given = scene(5)
    plain = rm.match(**given)
    assert names(plain) >= {"cx and cy are swapped", "the noise is 3 times as large"}
    assert not names(plain) & {"the normals point inwards", "one of the verticals is upside down"}
    upright = rm.match(**given | {"problem": rm.UP2P(CAMERA, (0, 1, 0), (0, 1, 0))})
    assert names(upright) >= {"one of the verticals is upside down", "x is mirrored, or the model is left-handed"}
    pair = rm.match(
        given["target"], given["target"] + 3.0, rm.ThreePlusOne(CAMERA, axis=(0, 1, 0), axis2=(0, 1, 0)), max_seconds=1
    )
    assert names(pair) >= {"one of the axes is reversed", "x and y of the image are swapped"}
    rays = rm.match(given["source"], CAMERA.bearings(given["target"]), rm.P3P(rm.Bearings()), noise=3e-4)
    assert "the noise is in degrees" in names(rays)
    assert "cx and cy are swapped" not in names(rays)
    turned = Rotation.from_euler("y", 30, degrees=True).as_matrix()
    rig = rm.Rig([(CAMERA, np.eye(3), np.zeros(3)), (BROWN, turned, np.array([0.1, 0, 0]))])
    both = rm.match(given["source"], (given["target"], np.zeros(10, int)), rm.P3P(rig), noise=0.3)
    assert names(both) >= {"the camera poses map to the rig", "the detections were undistorted already"}
    for match in (plain, upright, pair, rays, both):
        for mistake in usual_mistakes(match.task):
            if mistake.name.startswith("camera ") or mistake.fitted:
                continue  # one camera sees everything: nothing tells where the other one is; no other camera may fit
            changed = mistake.change(match.task)
            assert changed.shape == match.task.shape, mistake.name
            assert mistake.remedy
            same = replace(changed.points, target=match.task.points.target).source is match.task.points.source
            assert changed.problem != match.task.problem or changed.points is not match.task.points or not same


def test_axes_are_mirrored_about_the_principal_point() -> None:
    match = rm.match(**scene(5))
    change = next(one.change for one in usual_mistakes(match.task) if one.name.startswith("y is"))
    np.testing.assert_allclose(change(match.task).points.target, match.target * (1, -1) + (0, 960))
    halves = [one for one in usual_mistakes(match.task) if "half a pixel" in one.name]
    shifted = [one.change(match.task).problem.camera for one in halves]  # type: ignore[attr-defined]
    assert [camera.cx for camera in shifted] == [640.5, 639.5]
    assert math.isclose(shifted[0].fx, CAMERA.fx)
    assert [len(one.rivals) for one in halves] == [3, 3]


def test_a_larger_noise_is_that_of_all_axes_of_both_sets() -> None:
    points, axes = np.random.default_rng(1).uniform(-1.0, 1.0, (6, 3)), np.tile([1e-3, 1e-3, 4e-3], (6, 1))
    match = rm.match(points, points + 1.0, rm.Rigid(), noise=(axes, axes))
    changed = next(one.change for one in usual_mistakes(match.task) if one.name == "the noise is 10 times as large")
    before, after = match.task.points, changed(match.task).points
    for name in ("source_covariance", "target_covariance"):
        np.testing.assert_allclose(getattr(after, name), 100.0 * getattr(before, name))


def test_a_larger_noise_of_detections_is_not_that_of_the_model() -> None:
    task = rm.match(**scene(2) | {"source_noise": 1e-3}).task
    before, after = task.points, scale_noise(task.points, 1.0, 3.0)
    np.testing.assert_allclose(after.detection_noise, 3.0 * before.detection_noise)
    of_model = [one.target_noise**2 - one.detection_noise**2 for one in (before, after)]
    assert (of_model[0] > 0.0).all()
    np.testing.assert_allclose(*of_model)


def test_on_the_command_line(tmp_path: Path) -> None:
    given = mistaken("x and y", 1)
    for name, key, header in (("model", "source", "x,y,z"), ("image", "target", "x,y")):
        np.savetxt(tmp_path / f"{name}.csv", given[key], delimiter=",", header=header, comments="", fmt="%.17g")
    files = [str(tmp_path / "model.csv"), str(tmp_path / "image.csv")]
    options = ["--problem", "p3p", "--camera", "900,900,640,480", "--noise", "0.3", "--diagnose"]
    result = CliRunner().invoke(app, ["match", *files, *options, "--json"])
    assert result.exit_code == 1
    named = "diagnosis: x and y of the image are swapped: matched, 8 points"
    assert named in result.stderr
    record = json.loads(result.stdout)
    best = record["diagnosis"]["fits"][0]
    assert (best["mistake"], best["status"], best["matched"]) == ("x and y of the image are swapped", "matched", 8)
    assert record["diagnosis"]["given"]["status"] == record["status"] == "untrusted"
    frames = [[k, *point] for k in range(2) for point in given["target"][:, :: -1 if k == 0 else 1].tolist()]
    files[1] = str(tmp_path / "frames.csv")
    np.savetxt(files[1], frames, delimiter=",", header="frame,x,y", comments="", fmt=["%d", "%.17g", "%.17g"])
    many = CliRunner().invoke(app, ["match", *files, *options])
    assert f"frame 1, the first that is not matched:\n{named}" in many.stderr
    tracked = CliRunner().invoke(app, ["track", *files, *options])
    assert "rootmatch: --diagnose: `rootmatch match --diagnose` with the same files" in tracked.stderr


@pytest.mark.parametrize("absent", [0, 1])
def test_units_of_several_bodies_are_told_by_those_that_are_found(absent: int) -> None:
    rng = np.random.default_rng(5)
    bodies = [rng.uniform(-80.0, 80.0, (6, 3)) for _ in range(3)]
    poses = [(Rotation.random(random_state=k).as_matrix(), (500.0 * k, 0.0, 0.0)) for k in range(3 - absent)]
    seen = np.vstack([points @ R.T + t for points, (R, t) in zip(bodies, poses, strict=False)])
    target = rng.permutation(seen) + rng.normal(0, 0.2, seen.shape)
    labels = np.repeat(["a", "b", "c"], 6)
    match = rm.match(np.vstack(bodies) / 10.0, target, rm.Rigid(), noise=(0.0, 0.2), bodies=labels)
    assert not match
    first = match.diagnose(SECONDS).fits[0]
    assert re.search(r"the target is (9\.9|10)\S* times the source \(centimetres and millimetres\?\)", first.mistake)
    assert (first.bodies, first.matched) == ((3 - absent, 3), 6 * (3 - absent))
    assert f"{3 - absent} of 3 bodies matched" in str(first)


def part_before_a_rig(flat: bool, off: float = 0.0) -> tuple[np.ndarray, np.ndarray, rm.P3P]:
    """Points of a part as they are modelled, each off by so much, their detections, and two cameras that it faces."""
    rng, views = np.random.default_rng([1, 63]), [(CAMERA, np.eye(3), np.array([x, 0.0, 0.0])) for x in (0.4, -0.4)]
    points, rows = rng.uniform(-0.3, 0.3, (12, 3)), list[Any]()
    points[:, 2] *= not flat
    seen = points @ Rotation.from_euler("xyz", (170.0, 20.0, 40.0), degrees=True).as_matrix().T + (0.1, -0.1, 2.0)
    for k, (camera, _, t) in enumerate(views):
        pixels = camera.project(seen + t) + rng.normal(0.0, 0.3, (12, 2))
        rows += [(*pixel, k) for pixel in [*pixels.tolist(), *rng.uniform(100.0, 900.0, (2, 2)).tolist()]]
    return points + rng.normal(0.0, 1.0, points.shape) * off, np.array(rows), rm.P3P(rm.Rig(views))


def test_a_second_mistake_does_not_hide_the_first() -> None:
    """A model in another unit than its rig, and off by more than was stated: neither correction alone is trusted."""
    model, rows, problem = part_before_a_rig(flat=False, off=0.0025)
    match = rm.match(model / 1000.0, rows, problem, noise=0.3)
    assert "judging by the residuals, the noise is" in match.advice
    assert "check that the points and the rig have the same unit, or see `diagnose`" in match.advice
    found = match.diagnose(SECONDS)
    assert found.fits == ()
    assert found.nearest is not None
    assert found.nearest.mistake == "the model is in metres, the rig in millimetres"
    assert "; the nearest is the model is in metres" in str(found)


def test_of_equally_probable_mistakes_the_commonest_is_named_first() -> None:
    """A flat part with its normals inwards looks as one of the other hand, whose normals are as they should be."""
    model, rows, problem = part_before_a_rig(flat=True)
    inwards = np.tile((0.0, 0.0, -1.0), (12, 1))  # it is seen from above
    fits = rm.match(model, rows, problem, noise=0.3, normals=inwards).diagnose(SECONDS).fits
    assert [one.mistake for one in fits[:2]] == ["the normals point inwards", "the model is left-handed"]
    assert fits[0].log_odds == pytest.approx(fits[1].log_odds, abs=0.1)
