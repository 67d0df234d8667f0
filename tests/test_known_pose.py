"""What is known of a pose in part: what is refused, what is found, how it is weighed; bodies, rigs and trackers."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain import known_place, known_rotation

Floats = NDArray[np.float64]
CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)
SIGMA = 0.3
TURN, TILT, MOVE = np.radians(2.0), np.radians(0.5), 0.05
KINDS = ("vertical", "rotation", "position", "rotation and position")


class Scene:
    """A small body a metre away, some of its points, and clutter."""

    def __init__(self, seed: int, visible: int = 5, clutter: int = 8) -> None:
        self.rng = rng = np.random.default_rng([seed, 40])
        self.body = np.random.default_rng(4).uniform((0.02, -0.08, -0.08), (0.18, 0.08, 0.08), (9, 3))
        self.R = Rotation.random(random_state=seed).as_matrix()
        self.t = np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2), rng.uniform(0.7, 1.2)])
        shown = np.sort(rng.choice(9, visible, replace=False))
        self.truth = np.full(9, -1)
        self.truth[shown] = np.arange(visible)
        seen = CAMERA.project(self.body[shown] @ self.R.T + self.t) + rng.normal(0.0, SIGMA, (visible, 2))
        self.target = np.vstack([seen, rng.uniform((0, 0), (1280, 960), (clutter, 2))])
        self.measured = Rotation.from_rotvec(rng.normal(0.0, TURN, 3)).as_matrix() @ self.R
        self.down = Rotation.from_rotvec(rng.normal(0.0, TILT, 3)).apply(self.R[:, 1])
        self.place = self.t + rng.normal(0.0, MOVE, 3)

    def prior(self, kind: str) -> rm.PosePrior:
        given: dict[str, Any] = {}
        if kind == "vertical":
            given["vertical"] = ((0.0, 1.0, 0.0), self.down, TILT)
        if "rotation" in kind:
            given["rotation"] = (self.measured, TURN)
        if "position" in kind:
            given["position"] = (self.place, MOVE)
        return rm.PosePrior(**given)

    def match(self, prior: Any = None, **options: Any) -> rm.Match:
        return rm.match(self.body, self.target, rm.P3P(CAMERA), **{"noise": SIGMA, "prior": prior} | options)

    def is_right(self, match: rm.Match) -> bool:
        found = match.assignment
        return bool(match) and not ((found >= 0) & (found != self.truth)).any()


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({}, "nothing is known"),
        ({"rotation": np.eye(3)}, r"rotation: give \(R, σ\)"),
        ({"rotation": (np.eye(4), 0.1)}, r"R of shape \(4, 4\) given; give a rotation matrix \(3, 3\), or \(2, 2\)"),
        ({"rotation": (np.eye(2), 0.1), "position": (np.zeros(3), 0.1)}, "some of it is in a plane and some in space"),
        ({"rotation": (2.0 * np.eye(3), 0.1)}, "R is not a rotation"),
        ({"rotation": (np.eye(3), -0.1)}, "σ -0.1 given; a standard deviation is not negative"),
        ({"rotation": (np.eye(3), 10.0)}, "σ of 10 radians given, 573°; give radians up to 1, such as"),
        (
            {"rotation": (np.eye(3), 2.0)},
            r"σ of 2 radians given, 115°; give radians up to 1, such as np\.radians\(2\.0\)",
        ),
        ({"rotation": (np.eye(3), (0.1, 4.0, 0.1))}, "σ of 4 radians given, 229°"),
        ({"position": ((0.0,), 0.1)}, "position of shape"),
        ({"position": ((0.0, 0.0, np.nan), 0.1)}, "NaN or infinity"),
        ({"position": ((0.0, 0.0, 1.0), (np.inf, np.inf, 0.1))}, "nothing is known, the size of the space"),
        ({"position": ((0.0, 0.0, 1.0), -np.eye(3))}, "not symmetric, or has a negative eigenvalue"),
        ({"vertical": ((0.0, 1.0, 0.0), 0.1)}, "vertical: give"),
        ({"vertical": ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.1)}, "its length is 0"),
        ({"vertical": ((0.0, 1.0, 0.0), (0.0, 1.0, 0.0), 2.0)}, r"^prior: vertical: σ of 2 radians given, 115°"),
        ({"vertical": ((0.0, 1.0, 0.0), (0.0, 1.0, 0.0), -0.1)}, "give one number of radians, not negative"),
    ],
)
def test_what_is_no_knowledge_is_refused_once(given: dict[str, Any], text: str) -> None:
    with pytest.raises(rm.InputError, match=text) as refused:
        rm.PosePrior(**given)
    assert "\n" not in str(refused.value)


def test_what_is_shown_is_what_was_given() -> None:
    known = rm.PosePrior(rotation=(np.eye(3), 0.1), position=((1.0, 2.0, 3.0), (0.1, 0.2, 3.0)))
    shown = "PosePrior(rotation=([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], 0.1), "
    assert repr(known) == shown + "position=([1.0, 2.0, 3.0], [0.1, 0.2, 3.0]))"
    down = rm.PosePrior(vertical=((0, 0, 2), (0, 1, 0), 0.05))
    assert repr(down) == "PosePrior(vertical=([0.0, 0.0, 1.0], [0.0, 1.0, 0.0], 0.05))"
    assert repr(rm.PosePrior(rotation=(np.eye(3), (0.1, 3.0, 0.1)))).endswith("[0.1, 3.0, 0.1]))"), "no yaw"


def test_what_does_not_go_together_is_refused() -> None:
    scene = Scene(0)
    vertical = scene.prior("vertical")
    with pytest.raises(rm.InputError, match=r"^prior: 3p1 is not offered with one; .* P3P or UP2P"):
        rm.match(scene.target, scene.target, rm.ThreePlusOne(CAMERA, axis=(0, 1, 0), axis2=(0, 1, 0)), prior=vertical)
    with pytest.raises(rm.InputError, match=r"^prior: no body is labelled"):
        scene.match({"head": vertical}, bodies=["hand"] * 9)


def test_all_parts_together_are_a_pose() -> None:
    scene = Scene(0)
    known = scene.prior("rotation and position")
    assert known.pose is not None
    np.testing.assert_allclose(known.pose.R, scene.measured)
    upright = rm.PosePrior(rotation=known.rotation, vertical=((0, 1, 0), scene.R[:, 1], 1e-4))
    assert upright.turn is not None
    assert np.degrees(np.arccos(upright.turn[0][:, 1] @ scene.R[:, 1])) < 0.02
    wide = rm.Pose(scene.R, scene.t, np.diag([1.0, 1.0, 1.0, 4.0, 4.0, 4.0]))
    both = known.with_prediction(wide)
    assert both.covariance is not None
    np.testing.assert_allclose(both.t, scene.place, atol=2e-3)
    np.testing.assert_allclose(np.diag(both.covariance)[3:], MOVE**2, rtol=2e-3)
    np.testing.assert_allclose(np.diag(both.covariance)[:3], TURN**2, rtol=3e-3)


@cache
def found_blindly() -> int:
    """How many of six scenes are matched where nothing is known."""
    return sum(scene.is_right(scene.match(seed=k)) for k, scene in enumerate(map(Scene, range(6))))


@pytest.mark.parametrize("kind", KINDS)
def test_more_is_found_with_what_is_known(kind: str) -> None:
    right = wrong = 0
    for seed in range(12):
        scene = Scene(seed)
        match = scene.match(scene.prior(kind), seed=seed)
        right += scene.is_right(match)
        wrong += bool(match) and not scene.is_right(match)
        if match:
            assert match.prior_holds
    assert right >= 11
    assert wrong == 0
    assert right / 12 >= found_blindly() / 6


@pytest.mark.parametrize("kind", ["vertical", "rotation", "position"])
def test_right_knowledge_loses_nothing_however_precise_or_vague(kind: str) -> None:
    """Precise knowledge excludes the pose of few detections alone, and vague knowledge is worth nothing."""
    scenes = [Scene(seed, visible=5, clutter=4) for seed in range(6)]
    known = {"vertical": ((0.0, 1.0, 0.0),), "rotation": (), "position": ()}[kind]
    blind = sum(scene.is_right(scene.match(seed=k)) for k, scene in enumerate(scenes))
    for sigma in {"position": (0.0, 1e-3, 10.0, 1e4)}.get(kind, (0.0, 1e-3, 1.0)):
        right = 0
        for k, scene in enumerate(scenes):
            value = {"vertical": scene.R[:, 1], "rotation": scene.R, "position": scene.t}[kind]
            match = scene.match(rm.PosePrior(**{kind: (*known, value, sigma)}), seed=k)  # type: ignore[arg-type]
            right += scene.is_right(match)
            assert match.prior_holds is not False, sigma
        assert right >= blind, sigma


def test_three_points_are_enough_with_a_rotation() -> None:
    scenes = [Scene(seed, visible=3, clutter=1) for seed in range(10)]
    found = [scene.match(scene.prior("rotation and position")) for scene in scenes]
    assert sum(scene.is_right(match) for scene, match in zip(scenes, found, strict=True)) >= 6


@pytest.mark.parametrize("kind", KINDS)
def test_the_pose_is_that_of_detections_and_knowledge(kind: str) -> None:
    """Against a slow fit of both, and its covariance."""
    scene = Scene(3, visible=6, clutter=3)
    match = scene.match(scene.prior(kind))
    assert scene.is_right(match)
    pose, used = match.pose, np.flatnonzero(match.assignment >= 0)
    assert pose is not None
    assert pose.covariance is not None

    def residuals(x: Floats) -> Floats:
        R = Rotation.from_rotvec(x[:3]).as_matrix() @ pose.R
        t = pose.t + x[3:]
        parts = [((CAMERA.project(scene.body[used] @ R.T + t) - scene.target[match.assignment[used]]) / SIGMA).ravel()]
        if kind == "vertical":
            parts.append((R[:, 1] - scene.down) / TILT)
        if "rotation" in kind:
            parts.append(Rotation.from_matrix(scene.measured @ R.T).as_rotvec() / TURN)
        if "position" in kind:
            parts.append((t - scene.place) / MOVE)
        return np.concatenate(parts)

    best = least_squares(residuals, np.zeros(6), x_scale=np.r_[np.full(3, 1e-2), np.full(3, 1e-2)])
    expected = np.linalg.inv(best.jac.T @ best.jac)
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(best.x / scale, 0.0, atol=0.02)
    np.testing.assert_allclose(pose.covariance / np.outer(scale, scale), expected / np.outer(scale, scale), atol=0.03)


def test_wrong_knowledge_is_noticed() -> None:
    scene = Scene(5, visible=9, clutter=2)
    wrong = Rotation.from_euler("y", 90.0, degrees=True).as_matrix() @ scene.R
    match = scene.match(rm.PosePrior(rotation=(wrong, TURN)))
    assert scene.is_right(match)
    assert match.prior_holds is False
    assert "this pose contradicts the prior, which was ignored" in match.advice


def test_wrong_knowledge_is_noticed_before_a_telephoto_lens() -> None:
    """Ten radii from it nothing of the body would be in view, and what is would be a copy of it."""
    scene = Scene(5, visible=9, clutter=2)
    far = rm.Camera(30.0 * CAMERA.fx, 30.0 * CAMERA.fy, CAMERA.cx, CAMERA.cy, size=(1280, 960))
    away = np.array([0.0, 0.0, 30.0]) - scene.R @ scene.body.mean(axis=0)
    target = far.project(scene.body @ scene.R.T + away) + scene.rng.normal(0.0, SIGMA, (9, 2))
    wrong = Rotation.from_euler("z", 60.0, degrees=True).as_matrix() @ scene.R
    match = rm.match(scene.body, target, rm.P3P(far), noise=SIGMA, prior=rm.PosePrior(rotation=(wrong, TURN)))
    assert match.assignment.tolist() == list(range(9))
    assert match
    assert match.prior_holds is False


def test_an_upright_camera_with_a_rotation_or_a_position() -> None:
    for seed in range(6):
        scene = Scene(seed)
        problem = rm.UP2P(CAMERA, scene.down, (0.0, 1.0, 0.0), TILT)
        for kind in ("rotation", "position"):
            match = rm.match(scene.body, scene.target, problem, noise=SIGMA, prior=scene.prior(kind))
            assert scene.is_right(match)


@pytest.mark.parametrize("kind", KINDS)
def test_bodies_have_one_each(kind: str) -> None:
    for seed in range(4):
        first, second = Scene(seed, clutter=2), Scene(seed + 50, clutter=2)
        model = np.vstack([first.body, second.body * [1.0, 0.7, 1.2]])
        scaled = Scene(seed + 50, clutter=2)
        seen = np.flatnonzero(scaled.truth >= 0)
        pixels = CAMERA.project(model[9 + seen] @ scaled.R.T + scaled.t) + scaled.rng.normal(0.0, SIGMA, (len(seen), 2))
        target = np.vstack([first.target, pixels])
        truth = np.concatenate([first.truth, np.full(9, -1)])
        truth[9 + seen] = len(first.target) + np.arange(len(seen))
        prior = {"one": first.prior(kind), "two": scaled.prior(kind)}
        match = rm.match(
            model, target, rm.P3P(CAMERA), noise=SIGMA, bodies=["one"] * 9 + ["two"] * 9, prior=prior, seed=seed
        )
        assert match.bodies is not None
        assert not ((match.assignment >= 0) & (match.assignment != truth)).any()
        assert (match.assignment >= 0).sum() >= 8
        assert all(body.prior_holds for body in match.bodies.values())


@pytest.mark.parametrize("kind", KINDS)
def test_a_rig_takes_it(kind: str) -> None:
    side = Rotation.from_euler("y", 20.0, degrees=True).as_matrix()
    views = [(CAMERA, np.eye(3), np.zeros(3)), (CAMERA, side, np.array([-0.3, 0.0, 0.05]))]
    for seed in range(4):
        scene = Scene(seed)
        rows = [np.column_stack([scene.target, np.zeros(len(scene.target))])]
        shown = np.flatnonzero(scene.truth >= 0)
        placed = (scene.body[shown] @ scene.R.T + scene.t) @ side.T + views[1][2]
        other = CAMERA.project(placed) + scene.rng.normal(0.0, SIGMA, (len(shown), 2))
        rows.append(np.column_stack([other, np.ones(len(other))]))
        match = rm.match(
            scene.body, np.vstack(rows), rm.P3P(rm.Rig(views)), noise=SIGMA, prior=scene.prior(kind), seed=seed
        )
        assert match.sightings is not None
        assert match.prior_holds
        np.testing.assert_array_equal(match.sightings.assignment[0], scene.truth)
        np.testing.assert_array_equal(match.sightings.assignment[1][shown], len(scene.target) + np.arange(len(shown)))


@pytest.mark.parametrize("labelled", [False, True])
def test_a_tracker_is_told_in_every_frame(labelled: bool) -> None:
    labels = {"bodies": ["hand"] * 9} if labelled else {}
    tracker = rm.Tracker(Scene(0).body, rm.P3P(CAMERA), noise=SIGMA, **labels)  # type: ignore[arg-type]
    for k in range(5):
        scene = Scene(7)
        rng = np.random.default_rng(k)
        target = scene.target + rng.normal(0.0, 0.1, scene.target.shape)
        known = scene.prior("rotation")
        prior: Any = {"hand": known} if labelled else known
        match = tracker.update(target, prior=prior)
        assert scene.is_right(match)
    assert all(state is rm.TrackingState.TRACKING for state in tracker.states.values())
    with pytest.raises(rm.InputError, match=r"^prior"):
        tracker.update(scene.target, prior=3)  # type: ignore[arg-type]


def test_many_points_are_searched_before_their_pairs_are_tried() -> None:
    """Of 60 points and 42 detections there are three million pairs of matches, of which two are looked at."""
    rng = np.random.default_rng(0)
    source, R = rng.uniform(-0.5, 0.5, (60, 3)), Rotation.random(rng=rng).as_matrix()
    target = CAMERA.project(source[:36] @ R.T + [0.0, 0.0, 3.0]) + rng.normal(scale=0.3, size=(36, 2))
    target = np.vstack([target, rng.uniform((400, 200), (900, 700), (6, 2))])
    prior = rm.PosePrior(rotation=(R, np.radians(1.0)))
    match = rm.match(source, target, rm.P3P(CAMERA), noise=0.3, prior=prior)
    assert match
    assert match.evaluated > 0
    np.testing.assert_array_equal(match.assignment[:36], np.arange(36))


def test_what_a_short_search_may_have_missed_counts_though_the_vertical_holds() -> None:
    """A vertical predicts no pose; about a rotation every pose is proposed, and no search needs to meet it."""
    scene = Scene(0, visible=7, clutter=30)
    short, long = rm.Guided(budget=3_000), rm.Guided(budget=100_000)
    upright = scene.match(scene.prior("vertical"), sampler=short)
    assert upright.status is rm.Status.AMBIGUOUS
    assert "the search ended before it could exclude another pose" in upright.advice
    assert scene.is_right(scene.match(scene.prior("vertical"), sampler=long))
    assert scene.is_right(scene.match(scene.prior("rotation"), sampler=short))


@pytest.mark.parametrize("is_rig", [False, True])
def test_a_camera_whose_place_is_known_needs_no_search(is_rig: bool) -> None:
    """Points of a room before a camera, of which half are seen, with clutter, and its place to 5 cm."""
    side = Rotation.from_euler("y", 70.0, degrees=True).as_matrix()
    views = [(CAMERA, np.eye(3), np.zeros(3)), (CAMERA, side, np.array([0.1, 0.0, 0.05]))]
    for seed in range(3):
        rng = np.random.default_rng([seed, 42])
        room = rng.uniform((1.0, -4.0, -1.5), (5.0, 4.0, 1.5), (24, 3))
        yaw = Rotation.from_euler("z", rng.uniform(-20.0, 20.0), degrees=True).as_matrix()
        turn = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]) @ yaw
        rows = []
        for number, (_, R, t) in enumerate(views if is_rig else views[:1]):
            placed = room @ (R @ turn).T + t
            pixels = CAMERA.project(placed) + rng.normal(0.0, SIGMA, (24, 2))
            inside = (placed[:, 2] > 0.3) & ((pixels > 0.0) & (pixels < (1280.0, 960.0))).all(axis=1)
            clutter = rng.uniform((0, 0), (1280, 960), (6, 2))
            labels = np.concatenate([np.flatnonzero(inside), np.full(6, -1)])
            shown = np.vstack([pixels[inside], clutter])
            rows.append(np.column_stack([shown, np.full(len(shown), number), labels]))
        whole = np.vstack(rows)
        problem = rm.P3P(rm.Rig(views) if is_rig else CAMERA)
        prior = rm.PosePrior(position=(rng.normal(0.0, MOVE, 3), MOVE))
        match = rm.match(room, whole[:, : 3 if is_rig else 2], problem, noise=SIGMA, prior=prior, seed=seed)
        assert match
        assert match.prior_holds
        assert match.evaluated == 0  # nothing was searched
        every = match.assignment[None] if match.sightings is None else match.sightings.assignment
        _, seen = np.nonzero(every >= 0)
        assert len(seen) >= 6
        np.testing.assert_array_equal(whole[every[every >= 0], 3], seen)


def test_a_rotation_tells_which_part_of_a_flat_model_is_seen() -> None:
    """Of many points the poses that put all of them on one far detection came first, and the right one was not weighed.

    So a search had to follow, after two seconds; of few points it made no difference.
    """
    x, y = np.meshgrid(np.linspace(-50.0, 50.0, 6), np.linspace(-30.0, 30.0, 5))
    field = np.column_stack([x.ravel(), y.ravel(), np.zeros(30)])
    for seed in range(3):
        rng = np.random.default_rng([seed, 41])
        points = field + np.column_stack([rng.uniform(-4.0, 4.0, (30, 2)), np.zeros(30)])
        eye, at = np.array([rng.uniform(-5, 5), -70.0, 18.0]), np.array([rng.uniform(5, 45), rng.uniform(-10, 10), 0.0])
        ahead = (at - eye) / np.linalg.norm(at - eye)
        right = np.cross(ahead, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(ahead, [0.0, 0.0, 1.0]))
        R = np.array([right, np.cross(ahead, right), ahead])
        pixels = CAMERA.project((points - eye) @ R.T)
        shown = np.flatnonzero((np.abs(pixels - (640, 480)) < (640, 480)).all(axis=1) & (rng.random(30) < 0.8))
        target = np.vstack(
            [pixels[shown] + rng.normal(0.0, 0.7, (len(shown), 2)), rng.uniform((0, 0), (1280, 960), (3, 2))]
        )
        truth = np.full(30, -1)
        truth[shown] = np.arange(len(shown))
        measured = Rotation.from_rotvec(rng.normal(0.0, TURN, 3)).as_matrix() @ R
        match = rm.match(points, target, rm.P3P(CAMERA), noise=0.7, prior=rm.PosePrior(rotation=(measured, 1.5 * TURN)))
        assert match
        assert match.evaluated == 0  # nothing was searched
        assert (match.assignment[shown] == truth[shown]).mean() >= 0.9


def test_the_vertical_of_a_body_takes_the_place_of_that_of_its_problem() -> None:
    rng = np.random.default_rng(5)
    first, second = rng.uniform(-0.3, 0.3, (7, 3)), rng.uniform(-0.3, 0.3, (6, 3))
    rig = rm.Rig([(CAMERA, np.eye(3), np.zeros(3)), (CAMERA, np.eye(3), (0.2, 0.0, 0.0))], sizes=[(1280, 960)] * 2)
    for camera in (CAMERA, rig):
        level = rm.UP2P(camera, (0, 1, 0), (0, 1, 0), 0.01)
        known: dict[str, Any] = {"noise": SIGMA, "bodies": ["a"] * 7 + ["b"] * 6}
        tracker = rm.Tracker(np.vstack([first, second]), level, **known)
        for k in range(3):
            tilted = Rotation.from_rotvec([0.5 + 0.03 * k, 1.0, 0.1]).as_matrix()
            upright = Rotation.from_rotvec([0.0, 0.4 + 0.02 * k, 0.0]).as_matrix()
            points = np.vstack([first @ tilted.T + (-0.5, 0.1, 3.0), second @ upright.T + (0.4, 0.0, 3.0)])
            images = [CAMERA.project(points + np.array([0.2 * view, 0.0, 0.0])) for view in range(2)]
            images = [one + rng.normal(0.0, SIGMA, one.shape) for one in images]
            target = images if camera is rig else images[0]
            down = {"a": rm.PosePrior(vertical=((0.0, 1.0, 0.0), tilted[:, 1], 0.01))}
            found = tracker.update(target, time=k / 60.0, prior=down)
            assert found, (k, found.advice)
            assert found.assignment.tolist() == list(range(13))
            assert [found.prior_holds, *(one.prior_holds for one in found.bodies.values())] == [True] * 3
            match = rm.match(np.vstack([first, second]), target, level, prior=down, **known)
            assert match.assignment.tolist() == list(range(13))
        against = {"b": rm.PosePrior(vertical=((0.0, 1.0, 0.0), tilted[:, 1], 0.01))} | down
        match = rm.Matcher(np.vstack([first, second]), level, **known).match(target, prior=against)
        assert [match.prior_holds, *(one.prior_holds for one in match.bodies.values())] == [False, True, False]


@pytest.mark.parametrize("kind", ["vertical", "rotation"])
def test_the_first_frame_of_a_tracker_searches_every_body_also_if_its_pose_is_known_in_part(kind: str) -> None:
    rng = np.random.default_rng(6)
    bodies = [rng.uniform(-0.3, 0.3, (count, 3)) for count in (7, 6)]
    turns = Rotation.random(2, random_state=6).as_matrix()
    points = [one @ R.T + t for one, R, t in zip(bodies, turns, ((-0.5, 0.1, 3.0), (0.4, 0.0, 3.0)), strict=True)]
    seen = CAMERA.project(np.vstack(points)) + rng.normal(0.0, SIGMA, (13, 2))
    told = [{"vertical": ((0.0, 1.0, 0.0), R[:, 1], TILT), "rotation": (R, TURN)} for R in turns]
    prior = {k: rm.PosePrior(**{kind: one[kind]}) for k, one in enumerate(told)}  # type: ignore[arg-type]
    tracker = rm.Tracker(np.vstack(bodies), rm.P3P(CAMERA), noise=SIGMA, bodies=np.repeat([0, 1], (7, 6)))
    found = tracker.update(seen, prior=prior)
    assert found, found.advice
    assert found.assignment.tolist() == list(range(13))


@pytest.mark.parametrize("kind", ["rotation", "position"])
def test_no_more_pairs_are_tried_than_tell_that_nothing_as_good_was_missed(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Twelve points before two cameras: of the pairs of their 24 sightings a few would do."""
    rng, tried = np.random.default_rng(8), list[float]()
    source, R = rng.uniform((-0.3, -0.3, 0.7), (0.3, 0.3, 1.3), (12, 3)), Rotation.random(random_state=8).as_matrix()
    t = np.array([0.1, 0.0, 3.0]) - R @ [0.0, 0.0, 1.0]
    side = Rotation.from_euler("y", 10.0, degrees=True).as_matrix()
    views = [(CAMERA, np.eye(3), np.zeros(3)), (CAMERA, side, np.array([-0.3, 0.0, 0.02]))]
    target = [
        np.vstack([CAMERA.project((source @ R.T + t) @ turn.T + shift), rng.uniform((400, 300), (900, 700), (5, 2))])
        for _, turn, shift in views
    ]
    draw = known_rotation.draw_match_pairs

    def counted(*arguments: Any) -> Any:
        for one in draw(*arguments):
            tried.append(one[2])
            yield one

    for module in (known_rotation, known_place):
        monkeypatch.setattr(module, "draw_match_pairs", counted)
    given: dict[str, Any] = {"rotation": (R, TURN)} if kind == "rotation" else {"position": (t, 0.001)}
    problem = rm.P3P(rm.Rig(views, sizes=[(1280, 960)] * 2))
    match = rm.match(source, target, problem, noise=SIGMA, prior=rm.PosePrior(**given))
    assert match
    assert match.sightings is not None
    assert match.sightings.assignment.tolist() == [[*range(12)], [*range(17, 29)]]
    assert 0.0 < sum(tried) < 0.25
