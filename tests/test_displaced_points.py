"""What the advice says of a point that seems displaced."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm

CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0, size=(1280.0, 960.0))
RIG = rm.Rig([(CAMERA, np.eye(3), np.zeros(3)), (CAMERA, np.eye(3), np.array([-200.0, 0.0, 0.0]))])
TOOL = np.array([[0.0, 0, 0], [90, 0, 0], [30, 60, 5], [-20, 110, 0], [60, 130, 20]])


def rows(tool: np.ndarray, seed: int, t: tuple[float, float, float] = (60.0, -30.0, 900.0)) -> np.ndarray:
    """Detections of spheres in both cameras, and two others in each."""
    rng = np.random.default_rng(seed)
    seen = tool @ Rotation.random(random_state=seed).as_matrix().T + t
    each = [
        np.column_stack(
            [np.concatenate([pixels, rng.uniform((0, 0), (1280, 960), (2, 2))]), np.full(len(pixels) + 2, k)]
        )
        for k, pixels in enumerate(CAMERA.project(seen + shift) for _, _, shift in RIG.views)
    ]
    every = np.concatenate(each)
    every[:, :2] += rng.normal(0.0, 0.2, (len(every), 2))
    return every


@pytest.mark.parametrize("seed", [1, 2])
def test_a_bent_tool_is_matched_and_told(seed: int) -> None:
    bent = TOOL.copy()
    bent[2] += (12.0, 9.0, 9.0)
    match = rm.match(TOOL, rows(bent, seed), rm.P3P(RIG), noise=0.2)
    assert match
    assert match.assignment[2] == -1
    assert "point 2 seems displaced" in match.advice
    assert "px from where the model puts it in 2 cameras" in match.advice


@pytest.mark.parametrize("seed", [1, 2])
def test_a_hidden_sphere_is_not_elsewhere(seed: int) -> None:
    every = rows(TOOL, seed)
    hidden = np.delete(every, [2, len(every) // 2 + 2], axis=0)
    match = rm.match(TOOL, hidden, rm.P3P(RIG), noise=0.2)
    assert match
    assert "displaced" not in match.advice


@pytest.mark.parametrize("strays", [0, 40])
def test_one_camera_does_not_tell_it_from_one_of_many_stray_detections(strays: int) -> None:
    rng = np.random.default_rng(3)
    body = rng.uniform(-100, 100, (10, 3))
    bent = body.copy()
    bent[4] += (15.0, 10.0, 0.0)
    seen = CAMERA.project(bent + np.array([0, 0, 900])) + rng.normal(0, 0.2, (10, 2))
    every = np.concatenate([seen, rng.uniform((0, 0), (1280, 960), (strays, 2))])
    match = rm.match(body, every, rm.P3P(CAMERA), noise=0.2)
    assert match
    assert match.assignment[4] == -1
    assert ("point 4 seems displaced" in match.advice) == (strays == 0)


def test_the_detection_of_another_body_is_none_of_a_point() -> None:
    """The other body's sphere lies where a bent tool would have its own; the tool's is hidden."""
    bent = TOOL.copy()
    bent[2] += (12.0, 9.0, 9.0)
    turn = Rotation.random(random_state=1).as_matrix()
    other = np.random.default_rng(0).uniform(-80, 80, (6, 3))
    other[0] = bent[2]
    points = np.concatenate([TOOL, other])
    moved = np.concatenate([TOOL, other]) @ turn.T + (60.0, -30.0, 900.0)
    every = [
        np.column_stack([np.delete(CAMERA.project(moved + shift), 2, axis=0), np.full(len(moved) - 1, k)])
        for k, (_, _, shift) in enumerate(RIG.views)
    ]
    match = rm.match(points, np.concatenate(every), rm.P3P(RIG), noise=0.2, bodies=["tool"] * 5 + ["other"] * 6)
    assert match
    assert match.bodies is not None
    assert "displaced" not in match.bodies["tool"].advice


@pytest.mark.parametrize("problem", [rm.Rigid(), rm.Similarity()])
def test_another_tool_is_told_between_point_sets(problem: rm.Similarity) -> None:
    """A marker 4 mm elsewhere is not another one that is hidden beside a stray."""
    rng = np.random.default_rng(0)
    other, turn = TOOL.copy(), Rotation.random(random_state=0).as_matrix()
    other[2] += (2.0, 2.0, 2.8)
    strays = rng.uniform(-300, 300, (3, 3))
    seen = np.concatenate([other @ turn.T + rng.normal(0.0, 0.2, other.shape), strays])
    match = rm.match(TOOL, seen, problem, noise=(0.0, 0.2))
    assert match
    assert match.assignment[2] == -1
    assert "point 2 seems displaced: a detection is 2" in match.advice
    assert "σ from where the model puts it" in match.advice
    hidden = rm.match(TOOL, np.delete(seen, 2, axis=0), problem, noise=(0.0, 0.2))
    assert hidden
    assert "displaced" not in hidden.advice


def test_a_marker_of_another_tool_is_none_of_a_point_between_point_sets() -> None:
    other = np.random.default_rng(0).uniform(-80, 80, (6, 3))
    other[0] = TOOL[2] + (2.0, 2.0, 2.8)
    points = np.concatenate([TOOL, other])
    match = rm.match(points, np.delete(points, 2, axis=0) + 5.0, rm.Rigid(), noise=0.2, bodies=[0] * 5 + [1] * 6)
    assert match
    assert match.bodies is not None
    assert "displaced" not in match.bodies[0].advice
