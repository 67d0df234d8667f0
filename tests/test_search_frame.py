"""A frame in which a body is searched for beside those that are followed: what it does not do twice, or for chance."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rig_scenes import NOISE, VIEW, controllers, frame, headset
from rootmatch.explain import image_hypotheses, rig_search
from rootmatch.frozen import copy_with
from rootmatch.model.modes import empty_modes
from rootmatch.model.proposals import empty_proposals

CAMERA = rm.Camera(500.0, 500.0, 640.0, 480.0)


def shown(points: np.ndarray, k: int, x: float, rng: np.random.Generator) -> np.ndarray:
    """Detections of a body that turns slowly."""
    R = Rotation.from_rotvec([0.1, 0.01 * k, 0.2]).as_matrix()
    return np.asarray(CAMERA.project(points @ R.T + [x, 0.0, 1.5])) + rng.normal(0.0, 0.3, (len(points), 2))


def test_chance_has_no_twins(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, twins = np.random.default_rng(5), list[Any]()
    points = rng.uniform(-0.2, 0.2, (2, 8, 3))
    tracker = rm.Tracker(points.reshape(-1, 3), rm.P3P(CAMERA), noise=0.3, bodies=np.repeat([0, 1], 8))
    work = image_hypotheses.Candidate.twins

    def counted(self: Any, modes: Any) -> Any:
        twins.append(modes)
        return work(self, modes)

    for k in range(60):
        strays = rng.uniform(100.0, 800.0, (7, 2)) if k > 5 else shown(points[1], k, 0.7, rng)
        if k == 6:  # from here on the second body is not in view
            monkeypatch.setattr(image_hypotheses.Candidate, "twins", counted)
        match = tracker.update(np.vstack([shown(points[0], k, 0.0, rng), strays]), time=k / 60.0)
        assert match.bodies is not None
        assert match.bodies[0].status is rm.Status.MATCHED
    assert all(one.log_mass[0] > 0.0 for one in twins)


def test_a_trackers_search_of_one_camera_does_not_narrow_poses(monkeypatch: pytest.MonkeyPatch) -> None:
    points, normals, _ = controllers()
    leds, rig, looked, camera = len(points) // 2, headset(), list[int | None](), list[int | None]([None])
    scene, searched, narrowed = frame(1, 0, rig, clutter=20), rig_search._search_cameras, rig_search._narrow

    def looking(*given: Any) -> Any:
        looked.append(camera[0])
        return narrowed(*given)

    def of_camera(task: Any, model: Any, limits: Any) -> Any:
        return searched(copy_with(task, search_camera=camera[0]), model, limits)

    monkeypatch.setattr(rig_search, "_narrow", looking)
    monkeypatch.setattr(rig_search, "_search_cameras", of_camera)
    known: dict[str, Any] = {"noise": NOISE, "normals": normals[:leds], "view_angle": np.radians(VIEW)}
    for camera[0] in (None, *range(len(rig.views))):
        rm.match(points[:leds], scene.rows, rm.P3P(rig), **known)
    assert looked
    assert set(looked) == {None}


def test_what_another_body_explains_has_no_twins(monkeypatch: pytest.MonkeyPatch) -> None:
    """A body that shares half its points with one of which not most is seen, and so is searched for among all."""
    rng, twins, named = np.random.default_rng(5), list[float](), list[float]()
    points = rng.uniform(-0.2, 0.2, (10, 3))
    other = np.where(np.arange(10)[:, None] < 5, points, rng.uniform(-0.2, 0.2, (10, 3)))
    tracker = rm.Tracker(np.concatenate([points, other]), rm.P3P(CAMERA), noise=0.3, bodies=np.repeat([0, 1], 10))
    work, also = image_hypotheses.Candidate.twins, image_hypotheses.Candidate.add_assignments

    def counted(self: Any, modes: Any) -> Any:
        twins.append(float(modes.log_mass[0]))
        return work(self, modes)

    def naming(self: Any, assignments: Any) -> Any:
        found = also(self, assignments)
        named.extend(found.modes.log_mass[:1].tolist())
        return found

    for k in range(20):
        if k == 6:
            monkeypatch.setattr(image_hypotheses.Candidate, "twins", counted)
            monkeypatch.setattr(image_hypotheses.Candidate, "add_assignments", naming)
        seen = shown(points, k, 0.0, rng)[: 10 if k < 6 else 7]
        match = tracker.update(np.vstack([seen, rng.uniform(100.0, 800.0, (4, 2))]), time=k / 60.0)
        assert match.bodies is not None
        assert match.bodies[0].status is rm.Status.MATCHED
    assert max(named) > 0.0
    assert not twins


def test_twins_are_proposed_of_the_best_pose_that_a_search_found(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, candidate = list[Any](), image_hypotheses.Candidate
    empty = empty_modes(4)
    modes = type(empty)._make([np.zeros((3, *field.shape[1:]), field.dtype) for field in empty])
    mass = np.array([50.0, 49.0, 20.0])
    modes = modes._replace(log_odds=mass, log_mass=mass, rotation=Rotation.random(3, random_state=1).as_matrix())

    def twins(_: Any, of: Any) -> Any:
        asked.append(of.log_mass)
        return empty_proposals(4)

    monkeypatch.setattr(candidate, "twins", twins)
    candidate(None, SimpleNamespace(shape=(4, 4)), modes).add_twins()  # type: ignore[arg-type]
    np.testing.assert_array_equal(asked, [mass[:1]])
