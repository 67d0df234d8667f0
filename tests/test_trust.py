"""Nothing is called matched that no pose explains, however many hyper-edges agree or were sampled."""

from __future__ import annotations

import numpy as np

import rootmatch as rm
from posteriors import told
from rootmatch.explain.task import MatchingTask

CAMERA = rm.Camera(1000.0, 1000.0, 320.0, 240.0)


def test_points_that_no_pose_explains() -> None:
    # two of 286 hyper-edges agree, and the best pose is 717 px off
    rng = np.random.default_rng(1439)
    n, n_target = int(rng.integers(8, 21)), int(rng.integers(8, 31))
    source, target = rng.uniform(-2.0, 2.0, (n, 3)), rng.uniform((0.0, 0.0), (640.0, 480.0), (n_target, 2))
    noise = float(rng.choice([0.25, 0.5, 1.0]))
    match = rm.match(source, target, rm.UP2P(CAMERA, (0, 1, 0), (0, 1, 0)), noise=noise, seed=439)
    assert match.status is rm.Status.UNTRUSTED


def test_a_labelling_that_no_pose_fits_is_not_there() -> None:
    rng = np.random.default_rng(0)
    source, target = rng.uniform(-2.0, 2.0, (10, 3)), rng.uniform((0.0, 0.0), (640.0, 480.0), (10, 2))
    task = MatchingTask.of(rm.UP2P(CAMERA, (0, 1, 0), (0, 1, 0)), source, target, noise=0.5)
    assert told(task, [np.arange(10)]).probabilities.sum() < 0.05


def test_unrelated_points_and_sampled_hyperedges() -> None:
    rng = np.random.default_rng(5)
    for _ in range(5):
        source, target = rng.uniform(-2.0, 2.0, (20, 3)), rng.uniform((0.0, 0.0), (640.0, 480.0), (20, 2))
        match = rm.match(source, target, rm.P3P(CAMERA), noise=1.0, sampler="random", samples=100_000)
        assert match.status is rm.Status.UNTRUSTED


def test_a_noise_stated_far_too_small_is_not_trusted() -> None:
    rng = np.random.default_rng(6)
    source = rng.uniform(-2.0, 2.0, (12, 3))
    target = CAMERA.project(source + np.array([0.0, 0.0, 12.0])) + rng.normal(0.0, 2.0, (12, 2))
    match = rm.match(source, target, rm.P3P(CAMERA), noise=0.25)
    found = match.assignment >= 0
    right = np.array_equal(match.assignment[found], np.flatnonzero(found)) and found.sum() >= 11
    assert match.status is not rm.Status.MATCHED or right
