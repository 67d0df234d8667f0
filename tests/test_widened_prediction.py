"""By how much a frame widens its prediction: a body that accelerates far more than was stated."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import rootmatch as rm
from rootmatch.model.widened_prediction import FREEDOM, find_widening

CLUB = np.array([[0.0, 0.0, 0.0], [60.0, 0.0, 0.0], [140.0, 12.0, 0.0], [60.0, 35.0, 20.0], [0.0, -25.0, 15.0]])
AXIS = np.array([0.2, 0.95, 0.2]) / np.linalg.norm([0.2, 0.95, 0.2])


def swing(time: float, rate: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A golf club .65 m from what it turns about, with ``rate`` rad/s at most, half a second after the beginning."""
    R = Rotation.from_rotvec(AXIS * rate * 0.07 * math.tanh((time - 0.5) / 0.07)).as_matrix()
    return R, np.array([0.0, -300.0, 2200.0]) + R @ [0.0, 650.0, 0.0]


def follow(rate: float, seed: int) -> tuple[list[float], list[str]]:
    """Squared deviations of the poses of a swing at 240 Hz, NaN where it is not trusted, and the advice."""
    rng, squared, told = np.random.default_rng(seed), list[float](), list[str]()
    tracker = rm.Tracker(CLUB, rm.Rigid(), noise=(0.0, 0.3), tracking=rm.TrackingOptions(interval=1.0 / 240.0))
    for k in range(150):
        R, t = swing(k / 240.0, rate)
        match = tracker.update(rng.permutation(CLUB @ R.T + t + rng.normal(0.0, 0.3, CLUB.shape)))
        told.append(match.advice)
        squared.append(math.nan)
        if not match or match.pose is None:  # five points that fit badly by chance
            continue
        off = np.array([*Rotation.from_matrix(R @ match.pose.R.T).as_rotvec(), *(t - match.pose.t)])
        squared[-1] = float(off @ np.linalg.solve(np.asarray(match.pose.covariance), off))
    return squared, told


def test_a_pose_is_as_certain_as_it_says_however_a_body_is_swung() -> None:
    slow, fast, told = list[float](), list[float](), list[str]()
    for seed in range(5):
        squared, advice = follow(30.0, seed)
        slow, fast, told = slow + squared[:60], fast + squared[100:140], told + advice[100:140]
        assert not any("MotionOptions" in one for one in advice[:60])
    for some in (slow, fast):
        known = np.isfinite(some)
        assert known.mean() > 0.95
        assert 0.9 < np.mean(np.array(some)[known] < chi2.ppf(0.95, 6)) < 0.99
    assert sum("times as much as `MotionOptions` say" in one for one in told) > len(told) // 4


def test_a_slow_swing_is_as_the_options_say() -> None:
    _, told = follow(0.3, 1)
    assert not any("MotionOptions" in one for one in told)


def test_a_widening_is_the_most_probable_one_with_the_pose_integrated_out() -> None:
    rng = np.random.default_rng(4)
    for size in (3, 6, 7):
        for _ in range(20):
            roots = rng.normal(0.0, 1.0, (2, size, size))
            predicted, observed = roots @ roots.swapaxes(1, 2) + 0.1 * np.eye(size)
            off = np.linalg.cholesky(predicted + observed) @ rng.normal(0.0, 4.0, size)

            def value(log_factor: float, off: NDArray[np.float64] = off, both: object = (predicted, observed)) -> float:
                factor, (first, second) = math.exp(log_factor), both  # type: ignore[misc]
                total = factor * first + second
                prior = FREEDOM * (log_factor + 1.0 / factor)
                return float(off @ np.linalg.solve(total, off) + np.linalg.slogdet(total)[1] + prior)

            found = find_widening(off, predicted, observed, FREEDOM)
            best = math.exp(minimize_scalar(value, bounds=(0.0, 9.0), method="bounded").x)
            assert found == pytest.approx(best, rel=0.01, abs=0.01)


def test_what_fits_widens_nothing() -> None:
    known = np.diag([1e-6, 1e-6, 1e-6, 1.0, 1.0, 1.0])
    assert find_widening(np.zeros(6), known, known, FREEDOM) == 1.0
    assert find_widening(np.full(6, 9.0), known, known, math.inf) == 1.0


def test_what_is_exact_stays_exact() -> None:
    exact, open_ = np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]), np.eye(6)
    off = np.array([0.0, 0.0, 0.0, 9.0, 0.0, 0.0])
    assert 1.0 < find_widening(off, exact, open_, FREEDOM) < 9.0**2


def follow_in_image(seed: int) -> list[tuple[float, bool]]:
    """Squared deviations of the poses that one camera trusts at 500 Hz, with and without a vibration, and which."""
    rng, out = np.random.default_rng(seed), list[tuple[float, bool]]()
    camera, points = rm.Camera(700.0, 700.0, 640.0, 400.0), rng.uniform(-0.1, 0.1, (8, 3))
    frequency, phase = rng.uniform(18.0, 26.0, 6), rng.uniform(0.0, 6.0, 6)
    amplitude = np.repeat([250.0, 25.0], 3) / (2.0 * np.pi * frequency) ** 2
    tracker = rm.Tracker(points, rm.P3P(camera), noise=1.0, tracking=rm.TrackingOptions(interval=0.002))
    for k in range(160):
        step = (k >= 60) * amplitude * np.sin(2.0 * np.pi * frequency * k * 0.002 + phase)
        R, t = Rotation.from_rotvec(step[:3] + 0.4).as_matrix(), step[3:] + np.array([0.0, 0.0, 1.1])
        pixels = camera.project(points @ R.T + t) + rng.normal(0.0, 1.0, (8, 2))
        match = tracker.update(rng.permutation(pixels))
        if match and match.pose is not None:
            off = np.array([*Rotation.from_matrix(R @ match.pose.R.T).as_rotvec(), *(t - match.pose.t)])
            out.append((float(off @ np.linalg.solve(np.asarray(match.pose.covariance), off)), k >= 70))
    return out


def test_a_pose_before_a_camera_is_nearly_as_certain_as_it_says_however_fast_it_moves() -> None:
    every = np.array([one for seed in (1, 3, 4) for one in follow_in_image(seed)])
    inside, fast = every[:, 0] < chi2.ppf(0.95, 6), every[:, 1] > 0.0
    assert len(every) > 450
    assert inside[~fast].mean() > 0.88
    assert inside[fast].mean() > 0.8  # .43 with accelerations of one size, learnt from frame to frame
