"""What the advice says of a match is its true cause, and it asks for nothing that was given."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rig_scenes import RigScene, four_about, frame
from rootmatch.explain.decide import Facts
from rootmatch.explain.finding import Finding
from rootmatch.explain.goodness_of_fit import Misfit
from rootmatch.explain.silent_cameras import chance_of_as_few
from rootmatch.explain.status_advice import advice
from rootmatch.samplers.guided.sampler import Guided
from test_rig_triples import KNOWN, LEDS, POINTS, RIG

CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)
NOISE = 0.3
Floats = NDArray[np.float64]


def scene(seed: int, points: int, shown: int, clutter: int) -> tuple[Floats, Floats]:
    """Points of a body, and the detections of the first of them among stray ones."""
    rng = np.random.default_rng(seed)
    source = rng.uniform(-0.3, 0.3, (points, 3))
    moved = source @ Rotation.random(random_state=seed).as_matrix().T + (0.05, -0.08, 1.2)
    seen = CAMERA.project(moved)[:shown] + rng.normal(0, NOISE, (shown, 2))
    return source, np.vstack([seen, rng.uniform((300, 150), (980, 810), (clutter, 2))])


def unexcluded() -> Finding:
    """A right match whose search ended before it looked for other poses."""
    source, target = scene(0, 24, 10, 20)
    match = rm.match(source, target, rm.P3P(CAMERA), noise=NOISE, sampler=Guided(budget=300_000))
    np.testing.assert_array_equal(match.assignment[:10], np.arange(10))
    assert match.status is rm.Status.AMBIGUOUS
    assert not match.alternatives
    return match.finding


def test_a_search_that_ended_too_soon_is_named_as_the_cause() -> None:
    found = unexcluded()
    text = advice(found, found.confidence)
    assert text.startswith("ambiguous: nothing better was found, but the search ended before it could exclude")
    assert "alternatives" not in text
    assert "give normals, a vertical (`UP2P`), a `prior`" in text
    assert text.endswith("or evaluate more hyper-edges with a larger `budget` of `Guided`")
    few = replace(found, task=found.task.subset(np.arange(24), np.arange(16)))
    assert few.longer_search == 'evaluate more hyper-edges with `sampler="exhaustive"`'
    swept = replace(few, task=replace(few.task, options=replace(few.task.options, sampler="exhaustive")))
    assert swept.longer_search == "give more points or detections"
    late = advice(found, found.confidence, stopped_early=True)
    assert late.startswith("ambiguous: `max_seconds` ended the search before it could exclude")
    assert "give more time" in late
    assert late.count("max_seconds") == 1


def test_a_search_that_found_nothing_says_whether_it_tried_everything() -> None:
    found = unexcluded().with_facts(present=0.01, probability=0.01)
    assert found.status is rm.Status.UNTRUSTED
    for missed, ended in ((0.0, False), (0.5, True)):
        text = advice(found.with_facts(missed=missed))
        assert text.startswith("no trustworthy match: no pose explains more of the points than chance would")
        assert (
            text.endswith("or evaluate more hyper-edges with a larger `budget` of `Guided`: not all poses were tried")
            == ended
        )


def test_doubts_that_add_up_are_not_called_another_assignment() -> None:
    rng, axis = np.random.default_rng(1211), (0.0, 1.0, 0.0)
    points = rng.uniform((-3.0, -2.0, 6.0), (3.0, 2.0, 12.0), (20, 3))
    turn = Rotation.from_rotvec([0.0, rng.normal(0.0, 0.3), 0.0]).as_matrix()
    images = [CAMERA.project(points), CAMERA.project(points @ turn.T + (1.0, 0.1, 0.2))]
    images = [pixels + rng.normal(0.0, 0.5, pixels.shape) for pixels in images]
    images[1][:10] = rng.uniform((0.0, 0.0), (1280.0, 960.0), (10, 2))
    match = rm.match(*images, rm.ThreePlusOne(CAMERA, axis=axis, axis2=axis), noise=0.5)
    text = advice(replace(match.finding, others=[]).with_facts(probability=0.9, contested=True))
    assert text.startswith("ambiguous: no other assignment comes close, but the doubts about single matches add up")
    assert "a probability of 0.9, less than asked for (`min_probability` 0.95)" in text


def test_a_search_of_a_frame_that_was_cut_names_its_budget() -> None:
    found = unexcluded()
    cut = replace(found, task=replace(found.task, budget=found.evaluated))
    nothing = replace(cut, facts=Facts(confirmed=False, missed=1.0))
    assert advice(cut, cut.confidence).endswith("or raise `search_budget` in `TrackingOptions`")
    assert "`search_budget` ended the search of this frame before it found anything" in advice(nothing)
    for one in (cut, nothing):
        enough = replace(one, task=replace(one.task, budget=found.evaluated + 1))
        assert "search_budget" not in advice(enough, enough.confidence)


def test_what_was_given_is_not_asked_for() -> None:
    found = unexcluded()
    points = replace(found.task.points, normals=np.ones((24, 3)))
    told = replace(found, task=replace(found.task, points=points))
    assert "normals" not in advice(told, found.confidence)
    assert "vertical" in advice(told, found.confidence)
    pose = rm.Pose(np.eye(3), np.zeros(3), np.eye(6))
    told = replace(found, task=replace(found.task, prior_pose=pose))
    assert "prior" not in advice(told, found.confidence)


@pytest.mark.parametrize("normals", [False, True])
def test_a_symmetric_object_asks_for_no_normals_twice(normals: bool) -> None:
    square = np.array([[1.0, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0], [0.4, 0, 0], [-0.4, 0, 0]])
    seen = square @ np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]]).T + [0.1, 0.2, 12]
    facing = np.tile([0.0, 0.0, -1.0], (6, 1)) if normals else None
    match = rm.match(square, CAMERA.project(seen), rm.P3P(CAMERA), noise=0.5, normals=facing)
    assert match.status is rm.Status.AMBIGUOUS
    assert ("give normals" in match.advice) is not normals
    assert "a vertical (`UP2P`)" in match.advice


@pytest.mark.parametrize("seed", [0, 4, 9])
def test_a_rig_whose_cameras_show_the_same_three_points(seed: int) -> None:
    shown = frame(seed, 0, RIG, clutter=0)
    points = np.argsort(-(shown.truth >= 0).sum(axis=0)[:LEDS], kind="stable")[:3]
    rows = np.unique(shown.truth[:, points])
    match = rm.match(POINTS[:LEDS], shown.rows[rows[rows >= 0]], rm.P3P(RIG), **KNOWN)
    assert match.status is rm.Status.AMBIGUOUS
    assert "no search can try every pose that explains so few points" in match.advice
    assert "give a vertical (`UP2P`), a `prior`, or more detections" in match.advice  # normals were given


@pytest.mark.parametrize("seed", [8, 10, 22])
def test_what_could_be_chance_is_told_with_its_probability(seed: int) -> None:
    source, target = scene(seed, 5, 4, 1)
    match = rm.match(source, target, rm.P3P(CAMERA), noise=NOISE)
    assert match.status is rm.Status.UNTRUSTED
    assert f"could be chance (probability {match.probability:.3g}, `min_probability` 0.95)" in match.advice
    assert "give normals, a vertical (`UP2P`), a `prior`, or fewer stray detections" in match.advice
    assert "raise the noise" not in match.advice


@pytest.mark.parametrize("seed", [32, 38])
def test_few_points_do_not_say_that_the_noise_is_larger(seed: int) -> None:
    tool = np.array([[0.0, 0, 0], [50, 0, 0], [0, 72, 0], [0, -45, 0]])
    rng, R = np.random.default_rng(seed), Rotation.random(random_state=seed).as_matrix()
    seen = tool[[0, 2, 3]] @ R.T + rng.normal(0, 0.5, (3, 3))  # these are on a line
    match = rm.match(tool, np.vstack([seen, rng.uniform(-150, 150, (8, 3))]), rm.Rigid(), noise=(0.0, 0.5))
    assert match.status is rm.Status.UNTRUSTED
    assert "times as large" not in match.advice


def test_noise_on_each_axis_in_another_unit_than_its_points_does_not_hide_which_unit_is_wrong() -> None:
    rng = np.random.default_rng(3)
    body, sigma = rng.uniform(-100.0, 100.0, (8, 3)), np.tile([0.3, 0.3, 0.9], (8, 1))
    seen = (body + sigma * rng.normal(size=(8, 3))) @ Rotation.random(random_state=3).as_matrix().T
    match = rm.match(body, 1e-3 * seen, rm.Rigid(), noise=(sigma, sigma))
    assert match.status is rm.Status.UNTRUSTED
    assert "the sets have different units" in match.advice
    alone = rm.match(1e-3 * body, 1e-3 * seen, rm.Rigid(), noise=(sigma, sigma))
    assert alone.status is rm.Status.UNTRUSTED
    assert "the noise of the source is 0.574, more than its points lie apart; give it in their unit" in alone.advice


def test_many_points_say_so() -> None:
    rng = np.random.default_rng(1)
    body = rng.uniform(-80, 80, (8, 3))
    seen = body @ Rotation.random(random_state=1).as_matrix().T + rng.normal(0, 1.0, (8, 3))
    match = rm.match(body, seen, rm.Rigid(), noise=(0.0, 0.1))
    assert match.status is rm.Status.UNTRUSTED
    assert "the noise is 10 times as large" in match.advice
    assert "source_noise" not in match.advice, "the noise of either set is stated"


def coarse(seed: int, off: float) -> rm.Match:
    """Of twelve points whose detections are off by so many pixels more than is stated, and three others."""
    source, target = scene(seed, 12, 12, 3)
    target = target + np.random.default_rng(1).normal(0.0, off, target.shape)
    return rm.match(source, target, rm.P3P(CAMERA), noise=NOISE)


def test_points_with_detections_beside_them_may_be_off() -> None:
    """Two of the twelve had no match, and what is beside them did not count for points that are off."""
    found = coarse(1, 2.4)
    assert found.status is rm.Status.MATCHED
    assert (found.assignment == np.arange(12)).all()


def test_residuals_of_what_is_not_there_do_not_say_that_the_noise_is_larger() -> None:
    """Four degrees of freedom of five points among sixteen fit anything 2.4 times as coarsely; twelve points do not."""
    misfit = Misfit(2.4**2, 2.4, 4)
    assert misfit.rescaled_log_odds(-6.4) == pytest.approx(-2.8, abs=0.1)
    found = coarse(4, 6.0)
    assert found.status is rm.Status.UNTRUSTED
    assert "times as large as given, or the pose is wrong; give `noise=" in found.advice
    assert ", or `source_noise=` if the model is inexact, and check" in found.advice
    assert "auto" not in found.advice  # which several bodies and a tracker refuse
    assert (
        "usual causes are the lens calibration, motion during the exposure, a rolling shutter, and a bent model"
        in found.advice
    )
    chance = replace(found.finding, log_odds=-6.4, noise_factor=2.4, noise_dof=8)
    assert "even with 2.4 times the stated noise, which the residuals suggest, this could be chance" in advice(chance)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_odds_with_a_larger_noise_are_those_of_the_model(seed: int) -> None:
    """Of the same matches, if σ is stated as large."""
    source, target = scene(seed, 12, 12, 0)
    coarse = target + np.random.default_rng(seed).normal(0.0, 1.3 * NOISE, target.shape)
    given = rm.match(source, coarse, rm.P3P(CAMERA), noise=NOISE).finding
    assert given.log_odds is not None
    assert given.noise_factor is not None
    larger = rm.match(source, coarse, rm.P3P(CAMERA), noise=given.noise_factor * NOISE).finding
    np.testing.assert_array_equal(given.assignment, larger.assignment)
    misfit = Misfit(given.noise_factor**2, given.noise_factor, given.noise_dof)
    assert misfit.rescaled_log_odds(given.log_odds) == pytest.approx(larger.log_odds, abs=0.3)


@pytest.mark.parametrize("of_image", [False, True])
def test_points_on_a_line_do_not_tell_the_turn_about_it(of_image: bool) -> None:
    rng, R = np.random.default_rng(1), Rotation.random(random_state=1).as_matrix()
    line = np.zeros((6, 3))
    line[:, 0] = (-100, -53, -29, 23, 72, 100)
    line[:, 1] = [1e-3, 0, 0, -1e-3, 0, 1e-3]
    if of_image:
        source = line / 300.0
        target = CAMERA.project(source @ R.T + (0, 0, 1.2)) + rng.normal(0, 0.2, (6, 2))
        match = rm.match(source, target, rm.P3P(CAMERA), noise=0.2)
        assert match.status is rm.Status.AMBIGUOUS  # each turn is a pose of its own
        np.testing.assert_array_equal(match.assignment, np.arange(6))
        assert "the matches are certain, but several poses fit them" in match.advice
    else:
        match = rm.match(line, line @ R.T + rng.normal(0, 0.2, (6, 3)), rm.Rigid(), noise=(0.0, 0.2))
        assert match.status is rm.Status.MATCHED
        assert "do not determine the pose in every direction" in match.advice
    source, target = scene(3, 8, 8, 0)
    assert "every direction" not in rm.match(source, target, rm.P3P(CAMERA), noise=NOISE).advice


@pytest.mark.parametrize("stated", [NOISE / 1.8, NOISE])
def test_a_sequence_whose_noise_is_larger_than_stated_says_so(stated: float) -> None:
    """A similar object in place of the asked one has such residuals too."""
    rng, source = np.random.default_rng(4), np.random.default_rng(3).uniform(-0.15, 0.15, (10, 3))
    tracker, told = rm.Tracker(source, rm.P3P(CAMERA), noise=stated), []
    for k in range(40):
        R = Rotation.from_rotvec([0.3, 0.5 + 0.01 * k, 0.1]).as_matrix()
        match = tracker.update(CAMERA.project(source @ R.T + [0.02, 0.01, 0.9]) + rng.normal(0.0, NOISE, (10, 2)))
        told.append("or a similar object is followed" in match.advice)
    assert match
    assert told[-1] == (stated < NOISE)
    assert not told[0]


def test_probabilities_are_told_apart() -> None:
    found = rm.match(*scene(8, 5, 4, 1), rm.P3P(CAMERA), noise=NOISE).finding
    near = found.with_facts(present=0.94997, probability=0.94997)
    assert "(probability 0.94997, `min_probability` 0.95)" in advice(near)


def test_a_body_that_does_not_fit_is_not_called_chance() -> None:
    """It is there, with a noise that was stated too small."""
    rng = np.random.default_rng(1)
    bodies = [rng.uniform(-80, 80, (8, 3)) for _ in range(2)]
    turns = Rotation.random(2, random_state=1).as_matrix()
    seen = [
        body @ R.T + 400.0 * k + rng.normal(0, (0.1, 1.0)[k], (8, 3))
        for k, (body, R) in enumerate(zip(bodies, turns, strict=True))
    ]
    match = rm.match(np.vstack(bodies), np.vstack(seen), rm.Rigid(), noise=(0.0, 0.1), bodies=np.repeat([0, 1], 8))
    assert match.bodies[1].status is rm.Status.UNTRUSTED
    assert "body 1 does not fit, body 0 is matched" in match.advice
    assert match.bodies[1].diagnose().fits[0].remedy == "give `noise=(0, 1)`"


def test_few_points_are_not_asked_for_hyper_edges() -> None:
    rng = np.random.default_rng(3)
    match = rm.match(
        rng.uniform(-0.3, 0.3, (4, 3)), rng.uniform((0, 0), (1280, 960), (6, 2)), rm.P3P(CAMERA), noise=NOISE
    )
    assert match.status is rm.Status.UNTRUSTED
    assert "give normals, a vertical (`UP2P`), a `prior`, or" in match.advice
    assert "hyper-edges" not in match.advice


def test_an_empty_match_tells_poses_of_any_assignment() -> None:
    source, target = scene(0, 8, 8, 0)
    match = rm.Matcher(source, rm.P3P(CAMERA), noise=NOISE).match(target, max_seconds=1e-9)
    assert (match.assignment == -1).all()
    (pose,) = match.poses_of(np.arange(8))
    assert pose is not None
    assert pose.rms < 1.0


def test_normalised_coordinates_before_a_camera_in_pixels_are_named() -> None:
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (8, 3))
    image = points[:, :2] / (points[:, 2:] + 2.0)
    given = rm.match(points, image, rm.P3P(rm.Camera(800, 800, 320, 240)))
    assert not given
    assert (
        "look like normalised coordinates (x/z, y/z), but the camera is in pixels; give pixels, or `Camera(1, 1, 0, 0)`"
        in given.advice
    )
    assert rm.match(points, image, rm.P3P(rm.Camera(1, 1, 0, 0)), noise=1e-3)
    strange = np.random.default_rng(1).uniform(-1.0, 1.0, (8, 2))
    assert "normalised" not in rm.match(points, strange, rm.P3P(rm.Camera(1, 1, 0, 0)), noise=1e-3).advice
    few = rm.Matcher(points, rm.P3P(rm.Camera(800, 800, 320, 240))).match(image[:2])
    assert "at least 4 needed" in few.advice


def test_fractions_of_the_size_of_an_image_are_named() -> None:
    """Whether what fits such points is ambiguous, or nothing does; the same in pixels is found."""
    points = np.random.default_rng(1).uniform(-0.3, 0.3, (9, 3))
    image = CAMERA.project(points @ Rotation.random(random_state=3).as_matrix().T + (0.1, 0.05, 1.6))
    statuses = set()
    for noise in (0.3, 1e-4):
        given = rm.match(points, image / (1280.0, 960.0), rm.P3P(CAMERA), noise=noise)
        statuses.add(given.status)
        assert "multiply x by the width and y by the height" in given.advice
    assert rm.Status.MATCHED not in statuses
    assert rm.Status.AMBIGUOUS in statuses
    assert rm.match(points, image, rm.P3P(CAMERA), noise=0.3)


def test_a_body_whose_distance_leaves_nothing_of_a_rig_is_questioned() -> None:
    """A model in millimetres before a rig in metres that only one camera shows among clutter is trusted."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.3, 0.3, (10, 3))
    rig = rm.Rig([(CAMERA, np.eye(3), np.zeros(3)), (CAMERA, np.eye(3), np.array([-0.3, 0.0, 0.0]))])
    seen = CAMERA.project(points @ Rotation.random(random_state=0).as_matrix().T + (0.05, -0.08, 1.5))
    target = [seen + rng.normal(0, NOISE, seen.shape), rng.uniform((0, 0), (300, 300), (3, 2))]
    told = "times as far away as the cameras are apart; check that the points and the rig have the same unit"
    for unit in (1000.0, 1.0):
        match = rm.match(unit * points, target, rm.P3P(rig), noise=NOISE)
        assert match, match.advice
        assert (told in match.advice) == (unit == 1000.0)


def test_a_focal_length_in_millimetres_is_named() -> None:
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (8, 3))
    image = 800.0 * points[:, :2] / (points[:, 2:] + 2.0) + (320.0, 240.0)
    given = rm.match(points, image, rm.P3P(rm.Camera(4.8, 4.8, 320, 240)))
    assert not given
    assert "give its focal length in pixels" in given.advice
    assert "focal length" not in rm.match(points, image[:, ::-1], rm.P3P(rm.Camera(800, 800, 320, 240))).advice


def test_detections_outside_of_their_image_are_named() -> None:
    """Whoever exchanges width and height has some."""
    points = np.random.default_rng(0).uniform((0.9, -0.3, 1.7), (1.5, 0.3, 2.3), (8, 3))
    pinhole = rm.Camera(800, 800, 640, 480)
    image = pinhole.project(points)
    upright = rm.Camera(800, 800, 640, 480, size=(960, 1280))
    views = [(one, np.eye(3), np.zeros(3)) for one in (pinhole, pinhole)]
    rig = rm.Rig(views, sizes=[(960, 1280)] * 2)
    told = "detections lie outside their image, the first at index"
    for problem, target in ((rm.P3P(upright), image), (rm.P3P(rig), [image, image])):
        match = rm.match(points, target, problem)
        assert not match
        assert told in match.advice
        assert "where the image has 960 by 1280 pixels; check its size, (width, height)" in match.advice
    wide = rm.Camera(800, 800, 640, 480, size=(2000, 2000))
    assert told not in rm.match(points, image[:, ::-1], rm.P3P(wide)).advice


def test_points_on_a_line_are_named_between_point_sets() -> None:
    """A prior tells the turn about it, so they are not refused."""
    line = np.outer([0.0, 1.0, 2.5, 4.2], [1.0, 0.0, 0.0])
    assert "all points are collinear" in rm.match(line, line[::-1] + 1.0, rm.Rigid(), noise=0.01).advice
    near = rm.Pose(np.eye(3), np.ones(3), covariance=np.diag([0.1] * 6) ** 2)
    assert rm.match(line, line[::-1] + 1.0, rm.Rigid(), noise=0.01, prior=near)


@pytest.mark.parametrize("bodies", [False, True])
def test_cameras_that_show_nothing_of_a_body_are_named(bodies: bool) -> None:
    """Two of four are off by half a degree; by what the others detect, chance would leave it out with 1e-6 in each."""
    scene = four_before(seed=3)
    off = Rotation.from_rotvec([0.008, -0.006, 0.0]).as_matrix()
    views = [
        (one, off @ np.array(R), off @ t) if k in (1, 3) else (one, R, t)
        for k, (one, R, t) in enumerate(scene.rig.views)
    ]
    given: dict[str, Any] = {"noise": 0.3}
    given |= {"bodies": np.repeat("prop", len(scene.points))} if bodies else {}
    knocked = rm.match(scene.points, scene.rows, rm.P3P(rm.Rig(views, sizes=scene.rig.sizes)), **given)
    assert knocked
    assert "cameras 1, 3 show next to nothing where the body should be seen" in knocked.advice
    assert "nothing where" not in rm.match(scene.points, scene.rows, rm.P3P(scene.rig), **given).advice
    beside, unknown = np.where(scene.rows[:, 2:] == 1, [5000.0, 0.0, 0.0], 0.0), rm.Rig(scene.rig.views)
    assert "nothing where" not in rm.match(scene.points, scene.rows + beside, rm.P3P(unknown), **given).advice
    without = scene.rows[scene.rows[:, 2] != 1]
    assert "nothing where" not in rm.match(scene.points, without, rm.P3P(scene.rig), **given).advice, "it has no image"


def test_a_tracker_names_a_camera_that_shows_nothing_of_a_body() -> None:
    scene = four_before(seed=4)
    off = Rotation.from_rotvec([0.008, -0.006, 0.0]).as_matrix()
    views = [
        (one, off @ np.array(R), off @ t) if k == 2 else (one, R, t) for k, (one, R, t) in enumerate(scene.rig.views)
    ]
    tracker = rm.Tracker(scene.points, rm.P3P(rm.Rig(views, sizes=scene.rig.sizes)), noise=0.3)
    told = [tracker.update(scene.rows, time=k / 60.0).advice for k in range(3)]
    assert all("camera 2 shows next to nothing where the body should be seen" in one for one in told)


def test_how_probable_it_is_that_a_camera_detects_as_few() -> None:
    """By a sum over all that it may detect, at the rate of the cameras that show more than clutter does."""
    visible = np.ones((4, 5)) * (1.0, 1.0, 0.7, 0.2, 0.0)
    seen = np.zeros((4, 5), bool)
    seen[0, :4] = seen[1, :1] = seen[2, :2] = True
    rates = np.array([0.3, 0.9])
    told = chance_of_as_few(visible, seen, rates, np.log([0.5, 0.5]))
    expected, weights = np.ones(4), [np.where(seen[0], r * visible[0], 1.0 - r * visible[0]).prod() for r in rates]
    for camera, maximum in ((1, 1), (2, 2), (3, 0)):
        every = [np.array(one) for one in itertools.product([True, False], repeat=5) if sum(one) <= maximum]
        few = [
            sum(np.where(one, r * visible[camera], 1.0 - r * visible[camera]).prod() for one in every) for r in rates
        ]
        expected[camera] = np.dot(weights, few) / sum(weights)
    np.testing.assert_allclose(told, expected, rtol=1e-12)


def four_before(seed: int) -> RigScene:
    """Nine points, each detected with 0.95, and three stray detections before each of four cameras around them."""
    rng = np.random.default_rng(seed)
    rig, points = four_about(seed=seed).rig, rng.uniform(-0.2, 0.2, (9, 3))
    R, t, rows = Rotation.random(random_state=seed).as_matrix(), rng.uniform(-0.3, 0.3, 3), list[NDArray[np.float64]]()
    for k, (camera, turn, shift) in enumerate(rig.views):
        seen = camera.project((points @ R.T + t) @ np.array(turn).T + shift)[rng.random(9) < 0.95]
        seen = np.vstack([seen + rng.normal(0.0, 0.3, seen.shape), rng.uniform(100.0, 1000.0, (3, 2))])
        rows.append(np.column_stack([seen, np.full(len(seen), k)]))
    sized = rm.Rig(rig.views, sizes=[(1280, 1024)] * 4)
    return RigScene(points, np.vstack(rows), sized, np.empty((4, 9), np.int64), [(R, t)])
