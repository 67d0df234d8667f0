"""A similarity that a tracker follows: its scale is found, kept and covered by its covariance, from frame to frame."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp
from scipy.stats import chi2

import rootmatch as rm
from rootmatch.model.motion_prior import MotionPrior, add_source_errors, fuse_with_known, motion_covariances
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.problems.points import PointClouds
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.reference_point import pose_about_point
from rootmatch.problems.pose_fit.shared_errors import SharedPose, with_whole_covariance
from rootmatch.tracking.motion_filter import MotionFilter, MotionOptions
from test_cli_frames import run, write

BODY = np.array([[110.0, -5, 20], [28, 0, 25], [35, -55, 20], [118, -50, 35], [70, -25, 60]])
SIGMA = 0.2
INTERVAL = 0.01
GONE = range(60, 130)
Frame = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def flight(seed: int, unit: float, count: int) -> list[Frame]:
    """Frames (targets, true labels, R, t) in a unit that nobody knows: markers hide, all of them in `GONE`."""
    rng = np.random.default_rng([seed, 17])
    start, place = Rotation.random(rng=rng), rng.uniform(-250.0, 250.0, 3)
    frequency, phase = rng.uniform(2.0, 7.0, 6), rng.uniform(0.0, 6.0, 6)
    size = np.array([0.4, 0.3, 0.5, 60.0, 40.0, 70.0])
    frames = []
    for k in range(count):
        swing = size * np.sin(frequency * INTERVAL * k + phase)
        R, t = (Rotation.from_rotvec(swing[:3]) * start).as_matrix(), place + swing[3:]
        shown = np.flatnonzero(rng.random(len(BODY)) > (1.0 if k in GONE else 0.05))
        seen = BODY[shown] @ R.T + t + SIGMA * rng.normal(size=(len(shown), 3))
        order = rng.permutation(len(shown) + 5)
        truth = np.full(len(BODY), -1)
        truth[shown] = np.argsort(order)[: len(shown)]
        frames.append((unit * np.vstack([seen, rng.uniform(-300, 300, (5, 3))])[order], truth, R, unit * t))
    return frames


def squared_error(pose: rm.Pose, R: np.ndarray, t: np.ndarray, unit: float) -> float:
    """Normalised squared error of a pose with its scale."""
    assert pose.covariance is not None
    off = np.array([*Rotation.from_matrix(R @ pose.R.T).as_rotvec(), *(t - pose.t), unit - pose.scale])
    size = np.sqrt(np.diag(pose.covariance))
    return float(off / size @ np.linalg.solve(pose.covariance / np.outer(size, size), off / size))


def test_a_flight_in_an_unknown_unit() -> None:
    errors, held, right, last = [], 0, 0, 0.0
    for seed, unit in ((1, 0.3), (2, 4.0)):
        options = rm.TrackingOptions(interval=INTERVAL)
        tracker = rm.Tracker(BODY, rm.Similarity(), noise=(0.0, unit * SIGMA), tracking=options)
        for k, (target, truth, R, t) in enumerate(flight(seed, unit, 160)):
            match = tracker.update(target)
            if k in GONE:
                assert not match
                continue
            right += bool(match) and np.array_equal(match.assignment, truth)
            held += bool(match.prior_holds)
            if match:
                assert not ((match.assignment >= 0) & (match.assignment != truth)).any()
                assert match.pose is not None
                assert match.pose.covariance is not None
                errors.append(squared_error(match.pose, R, t, unit))
                last = abs(match.pose.scale / unit - 1.0), match.pose.covariance[6, 6] ** 0.5 / unit
        assert tracker.state is rm.TrackingState.TRACKING
        assert last[0] < 3.0 * last[1] < 3e-3  # a single frame tells it to 2e-3
    assert right >= 170  # of 180
    assert held >= 170
    assert 0.9 < np.mean(np.array(errors) < chi2.ppf(0.95, 7)) <= 1.0


def test_a_scale_that_many_frames_tell_is_not_biased() -> None:
    """Errors of second order in each frame add up: uncorrected, of so much noise, to .7 σ in 50 frames."""
    errors, sigma, problem = [], 10.0, rm.Similarity().for_points(BODY)
    for seed in range(16):
        rng = np.random.default_rng([seed, 19])
        known = rm.Pose(np.eye(3), np.zeros(3), np.diag([1.0] * 3 + [1e4] * 3 + [1.0]), scale=1.0)
        for _ in range(50):
            points = problem.validated(BODY, BODY + sigma * rng.normal(size=BODY.shape), (0.0, sigma))
            (fit,) = problem.poses(points, np.arange(5)[None])
            assert fit is not None
            known = fuse_with_known(fit, known)
        assert known.covariance is not None
        errors.append((known.scale - 1.0) / known.covariance[6, 6] ** 0.5)
    assert abs(np.mean(errors)) < 0.5  # with a standard deviation of .3
    assert np.mean(np.square(errors)) < 3.0


def test_an_absent_body_is_not_trusted() -> None:
    """Once followed, then other points only, in any number: at an unknown scale triangles alike are common."""
    rng = np.random.default_rng(5)
    tracker = rm.Tracker(BODY, rm.Similarity(), noise=(0.0, SIGMA))
    assert tracker.update(BODY)
    for k in range(60):
        assert not tracker.update(rng.uniform(-100.0, 100.0, (4 + k % 8, 3)))
    assert tracker.state is rm.TrackingState.LOST


def test_errors_of_the_model_stay_however_many_frames_are_seen() -> None:
    """They are those of every frame, so no number of frames tells the scale better than the model does."""
    rng, sigma = np.random.default_rng(6), 0.3
    errors = []
    for _ in range(8):
        tracker = rm.Tracker(BODY + sigma * rng.normal(size=BODY.shape), rm.Similarity(), noise=(sigma, 2.0 * SIGMA))
        for _ in range(30):
            match = tracker.update(2.0 * BODY + 2.0 * SIGMA * rng.normal(size=BODY.shape))
        assert match.pose is not None
        errors.append(squared_error(match.pose, np.eye(3), np.zeros(3), 2.0))
    assert np.mean(errors) < 12.0  # 7 are expected; 24 with frames that count as independent


def predicted(scale: float) -> rm.Pose:
    deviation = np.array([0.02] * 3 + [2.0] * 3 + [0.02 * scale])
    return rm.Pose(np.eye(3), (5.0, 0.0, 0.0), np.diag(deviation**2), scale=scale)


def test_a_predicted_scale_is_part_of_the_prior() -> None:
    rng = np.random.default_rng(3)
    target = 2.0 * BODY + (5.0, 0.0, 0.0) + SIGMA * rng.normal(size=BODY.shape)
    match = rm.match(BODY, target, rm.Similarity(), noise=(0.0, SIGMA), prior=predicted(2.0))
    assert match.prior_holds
    assert match.fused_pose is not None
    assert match.fused_pose.covariance is not None
    assert match.fused_pose.scale == pytest.approx(2.0, abs=5.0 * match.fused_pose.covariance[6, 6] ** 0.5)
    alone = rm.match(BODY, target, rm.Similarity(), noise=(0.0, SIGMA)).pose
    assert alone is not None
    assert alone.covariance is not None
    assert (np.linalg.eigvalsh(alone.covariance - match.fused_pose.covariance) > 0.0).all()
    wrong = rm.match(BODY, target, rm.Similarity(), noise=(0.0, SIGMA), prior=predicted(2.5))
    assert wrong
    assert wrong.prior_holds is False


def test_the_factor_is_the_integral_over_the_prior() -> None:
    """By sampling from the prior, the scale too; the noise is so large that its peak is met often."""
    rng, sigma, prior = np.random.default_rng(4), 3.0, predicted(2.0)
    target = 2.02 * BODY + (5.0, 0.0, 0.0) + sigma * rng.normal(size=BODY.shape)
    clouds = PointClouds(BODY, target, np.zeros(5), np.full(5, sigma**2), scaled=True, mirror=False)
    model = PointSetModel(clouds)
    fit = model.fit(np.arange(5)[None])
    assert prior.covariance is not None
    drawn = rng.normal(size=(400_000, 7)) * np.sqrt(np.diag(prior.covariance))
    turned = BODY @ Rotation.from_rotvec(drawn[:, :3]).as_matrix().swapaxes(1, 2)
    there = (2.0 + drawn[:, 6])[:, None, None] * turned + (prior.t + drawn[:, 3:6])[:, None]
    each = -0.5 * ((there - target) ** 2).sum(axis=(1, 2)) / sigma**2 - 7.5 * np.log(2.0 * np.pi * sigma**2)
    factor = MotionPrior(((prior, 1.0),), 1e-12).log_factors(fit, model.box)[0, 0]
    expected = logsumexp(each) - np.log(len(each))
    assert factor + fit.evidence[0] - model.log_volume == pytest.approx(expected, abs=0.1)


def test_the_scale_of_a_prior_tells_what_the_points_cannot() -> None:
    """Two copies, the second one twice as large: the scale says which."""
    both = np.vstack([BODY, 2.0 * BODY + (600.0, 0.0, 0.0)])
    vague = np.diag([0.5**2] * 3 + [400.0**2] * 3 + [0.05**2])
    assert rm.match(BODY, both, rm.Similarity(), noise=(0.0, SIGMA)).status is rm.Status.AMBIGUOUS
    for scale in (1.0, 2.0):
        prior = rm.Pose(np.eye(3), (300.0, 0.0, 0.0), vague, scale=scale)
        match = rm.match(BODY, both, rm.Similarity(), noise=(0.0, SIGMA), prior=prior)
        assert match
        np.testing.assert_array_equal(match.assignment, np.arange(5) + 5 * (scale == 2.0))


def test_what_a_prior_of_the_scale_predicts() -> None:
    variance = np.full(5, SIGMA**2)
    clouds = PointClouds(BODY, 2.0 * BODY[::-1] + (5.0, 0.0, 0.0), variance, variance, scaled=True, mirror=False)
    (assignment,) = MotionPrior(((predicted(2.0), 1.0),), 0.1).labellings(clouds)
    np.testing.assert_array_equal(assignment, [4, 3, 2, 1, 0])
    known = rm.Pose(np.eye(3), (5.0, 0.0, 0.0), np.eye(6))
    assert MotionPrior(((known, 1.0),), 0.1).labellings(clouds) == []  # at any scale


def test_fits_with_errors_in_common_keep_them() -> None:
    """Of targets with as much noise as the source, half of the variance is left after many frames."""
    variance = np.full(5, SIGMA**2)
    clouds = PointClouds(BODY, 2.0 * BODY, variance, 4.0 * variance, scaled=True, mirror=False)
    model = PointSetModel(clouds)
    covariance = motion_covariances(model.fit(np.arange(5)[None]))[0]
    pose = Pose.unchecked(np.eye(3), np.zeros(3), covariance, 2.0)
    one = add_source_errors(clouds, np.arange(5), pose)
    assert isinstance(one, SharedPose)
    np.testing.assert_allclose(one.shared.counted, 0.5 * covariance, rtol=1e-4, atol=1e-6)
    filter_ = MotionFilter(BODY, one, 0.0)
    for k in range(1, 21):
        both = fuse_with_known(one, filter_.predicted(1e-9 * k))
        filter_.update(both, 1e-9 * k)
    expected = (0.5 + 0.5 / 21.0) * covariance
    np.testing.assert_allclose(
        with_whole_covariance(filter_.predicted(2e-8)).covariance, expected, rtol=1e-3, atol=1e-5
    )
    exact = clouds._replace(source_variance=0.0 * variance)
    assert not isinstance(add_source_errors(exact, np.arange(5), pose), SharedPose)


def test_a_filter_of_a_scale() -> None:
    rng = np.random.default_rng(8)
    root = rng.normal(size=(7, 7)) * np.array([0.01] * 3 + [1.0] * 3 + [0.01])[:, None]
    R, t, covariance = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3), root @ root.T
    centre = BODY.mean(axis=0)
    moved, about = pose_about_point(R, t, covariance, centre, 3.0)
    np.testing.assert_allclose(moved, 3.0 * R @ centre + t)
    shift = 1e-6 * rng.normal(size=7)  # numerically: the same error about the other point
    other = 3.0 + shift[6]
    place = other * Rotation.from_rotvec(shift[:3]).as_matrix() @ R @ centre + t + shift[3:6]
    changed = np.array([*shift[:3], *(place - moved), shift[6]])
    precise = np.linalg.inv(covariance), np.linalg.inv(about)
    assert changed @ precise[1] @ changed == pytest.approx(shift @ precise[0] @ shift, rel=1e-4)

    pose = rm.Pose(R, t, covariance, scale=3.0)
    one = MotionFilter(BODY, pose, 0.0, MotionOptions(scale_drift=0.01))
    now, later = one.predicted(0.0), one.predicted(4.0)
    np.testing.assert_allclose(now.covariance, covariance, rtol=1e-6, atol=1e-12)
    assert later.scale == now.scale == 3.0
    assert later.covariance is not None
    assert later.covariance[6, 6] == pytest.approx(covariance[6, 6] + 4.0 * 0.03**2)
    np.testing.assert_allclose(later.transform(centre), now.transform(centre), atol=1e-9)
    assert one.is_near(rm.Pose(R, t, scale=3.0), 0.0)
    assert not one.is_near(rm.Pose(R, t, scale=1.0), 0.0)  # its centre is elsewhere


def test_what_does_not_go_together_is_refused() -> None:
    with pytest.raises(rm.InputError, match=r"^prior: .* a covariance \(6, 6\) is needed"):
        rm.match(BODY, BODY, rm.Rigid(), prior=predicted(1.0))
    with pytest.raises(rm.InputError, match=r"^prior: a scale of 2 given, but rigid has none"):
        rm.match(BODY, BODY, rm.Rigid(), prior=rm.Pose(np.eye(3), np.zeros(3), np.eye(6), scale=2.0))
    plane = rm.Pose(np.eye(2), np.zeros(2), np.eye(3))
    with pytest.raises(rm.InputError, match=r"^prior: .* a covariance \(6, 6\) or \(7, 7\) is needed"):
        rm.match(BODY, BODY, rm.Similarity(), prior=plane)
    for scale in (0.0, -1.0, float("nan"), "2"):
        with pytest.raises(rm.InputError, match=r"^pose: scale .* given; give a positive number"):
            rm.Pose(np.eye(3), np.zeros(3), scale=scale)  # type: ignore[arg-type]
    with pytest.raises(rm.InputError, match=r"scale_drift is -1"):
        MotionOptions(scale_drift=-1.0)


def test_the_command_tracks_it(tmp_path: Path) -> None:
    frames = [[k, *point] for k in range(3) for point in (3.0 * BODY + (k, 0.0, 900.0)).tolist()]
    model, seen = write(tmp_path / "m.csv", "x,y,z", BODY.tolist()), write(tmp_path / "s.csv", "frame,x,y,z", frames)
    options = ["--problem", "similarity", "--noise", "0,0.2"]
    printed = run("track", model, seen, *options)
    assert printed.exit_code == 0, printed.output
    header, *rows = (line.split(",") for line in printed.stdout.splitlines())
    table = [dict(zip(header, row, strict=True)) for row in rows]
    assert [float(row["scale"]) for row in table] == pytest.approx([3.0] * 3, abs=1e-4)
    assert float(table[-1]["cov_scale_scale"]) < float(table[0]["cov_scale_scale"])
    records = [json.loads(line) for line in run("track", model, seen, *options, "--json").stdout.splitlines()]
    assert records[-1]["pose"]["parameters"][-1] == "scale"
    prior = tmp_path / "prior.json"
    prior.write_text(json.dumps(records[-1]["pose"]))
    one = write(tmp_path / "one.csv", "x,y,z", (3.0 * BODY + (2.0, 0.0, 900.0)).tolist())
    told = [json.loads(run("match", model, one, *options, *more, "--json").stdout) for more in ((), ("--prior", prior))]
    alone, both = (one["poses"][0]["covariance"][6][6] for one in told)
    assert both < 0.8 * alone
