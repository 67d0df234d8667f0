"""σ: estimated from the answer, or different from point to point."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain.explain import explain
from rootmatch.explain.finding import Finding
from rootmatch.explain.noise_estimation import estimate_noise_and_solve, solve_scale, truncated_mean
from rootmatch.explain.task import MatchingTask
from rootmatch.simulation import p3p_scene, three_plus_one_scene, up2p_scene


@pytest.mark.parametrize(("make", "clutter"), [(p3p_scene, 0), (up2p_scene, 10)])
def test_estimate_is_near_the_truth(make, clutter: int) -> None:  # type: ignore[no-untyped-def]
    factors = []
    for seed in range(16):
        sigma = (0.1, 0.4, 1.0, 2.0)[seed % 4]
        scene = make(n=10, outliers=clutter, noise=sigma, seed=2000 + seed)
        match = rm.match(scene.source, scene.target, scene.problem, noise="auto")
        factors.append(match.noise / sigma)
    assert np.mean(np.abs(np.log(factors)) < np.log(1.5)) >= 0.9


def test_estimate_of_exact_points_is_small() -> None:
    scene = p3p_scene(n=10, seed=0)
    match = rm.match(scene.source, scene.target, scene.problem, noise="auto")
    assert match.noise < 0.01
    np.testing.assert_array_equal(match.assignment, scene.truth)


def test_noise_of_two_views_and_two_point_sets_is_estimated() -> None:
    """Which no image decides: the generous first guess is the only one."""
    scene = three_plus_one_scene(10, 0, 0.5, 1, baseline=1.0)
    match = rm.match(scene.source, scene.target, scene.problem, noise="auto")
    assert 0.2 < match.noise < 1.0
    rng = np.random.default_rng(0)
    source = rng.uniform(-1.0, 1.0, (8, 3))
    match = rm.match(source, source + rng.normal(scale=0.002, size=(8, 3)), rm.Rigid(), noise="auto")
    assert 0.0008 < match.noise < 0.004


def test_other_words_are_refused() -> None:
    scene = p3p_scene(n=10, seed=0)
    with pytest.raises(rm.InputError, match="noise"):
        rm.match(scene.source, scene.target, scene.problem, noise="some")


def test_noise_of_each_point_weighs_each_point() -> None:
    """Half of the detections are ten times as noisy: told so, all are matched; told the mean, fewer."""
    told = mean = 0.0
    for seed in range(12):
        exact = up2p_scene(n=10, outliers=6, noise=0.0, seed=seed)
        rng = np.random.default_rng(seed)
        sigma = np.where(rng.random(16) < 0.5, 0.3, 3.0)
        target = exact.target + sigma[:, None] * rng.normal(size=(16, 2))
        told += exact.accuracy(rm.match(exact.source, target, exact.problem, noise=sigma).assignment)
        mean += exact.accuracy(rm.match(exact.source, target, exact.problem, noise=0.3).assignment)
    assert told >= 12 * 0.95
    assert told > mean + 0.5


def test_poses_know_as_much_less_as_their_noise_is_estimated() -> None:
    """That of a t-distribution: ν / (ν − 2) times the covariance at the same σ."""
    scene = p3p_scene(n=8, noise=0.5, seed=3)
    told = rm.match(scene.source, scene.target, scene.problem, noise="auto")
    known = rm.match(scene.source, scene.target, scene.problem, noise=told.noise)
    assert told.pose is not None
    assert known.pose is not None
    assert told.pose.dof == 2 * 8 - 6
    np.testing.assert_allclose(told.pose.covariance, known.pose.covariance * (10.0 / 8.0), rtol=1e-3)


@pytest.mark.parametrize("dof", [1, 2])
def test_scale_of_residuals_of_the_law_is_found(dof: int) -> None:
    drawn = np.random.default_rng(0).chisquare(dof, 200_000)
    assert solve_scale(4.0 * drawn, truncated_mean(dof)) == pytest.approx(4.0, rel=0.02)
    drawn[:2000] = 1e6  # a few that are no residuals of the law change little
    assert solve_scale(4.0 * drawn, truncated_mean(dof)) == pytest.approx(4.0, rel=0.12)


def test_no_long_search_is_spent_on_a_guess_of_noise_that_is_far_too_large() -> None:
    """20 of 60 points: at ten times its noise, where hardly a hypothesis is beyond chance, a search takes 5·10⁸."""
    rng = np.random.default_rng(36000)
    source = rng.uniform(-0.5, 0.5, (60, 3)) * [1.0, 1.0, 0.6]
    camera = rm.Camera(1200.0, 1200.0, 640.0, 480.0)
    inside = source @ Rotation.random(rng=rng).as_matrix().T + [0.1, 0.1, 2.0]
    target = camera.project(inside[:20]) + rng.normal(scale=0.3, size=(20, 2))
    spent: list[Finding] = []

    def counted(task: MatchingTask) -> Finding:
        spent.append(explain(task))
        return spent[-1]

    task = MatchingTask.of(rm.P3P(camera), source, target, noise="auto")
    found = estimate_noise_and_solve(task, counted)
    assert found.status
    np.testing.assert_array_equal(found.assignment[:20], np.arange(20))
    assert sum(each.evaluated for each in spent) < 2e8


def test_noise_of_a_rig_is_not_that_of_a_wrong_pose() -> None:
    """At a generous σ the searches in single cameras may miss the right pose, which explains far more at its own σ."""
    right = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        source, camera = rng.uniform(-0.15, 0.15, (7, 3)), rm.Camera(900.0, 900.0, 640.0, 480.0)
        views = [
            (camera, Rotation.from_rotvec([0.0, turn, 0.0]).as_matrix(), np.array([0.0, 0.0, 1.8]))
            for turn in (-0.7, 0.0, 0.7)
        ]
        placed = source @ Rotation.random(rng=rng).as_matrix().T
        detections, cameras, truth = [], [], np.full((3, 7), -1)
        for k, (_, R, t) in enumerate(views):
            seen = np.sort(rng.choice(7, 4, replace=False))
            truth[k, seen] = sum(map(len, detections)) + np.arange(4)
            pixels = camera.project(placed[seen] @ R.T + t) + rng.normal(scale=0.3, size=(4, 2))
            detections.append(np.vstack([pixels, rng.uniform(0.0, [1280.0, 960.0], (3, 2))]))
            cameras += [k] * 7
        match = rm.match(source, (np.vstack(detections), cameras), rm.P3P(rm.Rig(views)), noise="auto")
        right += bool(match) and bool((match.sightings.assignment[truth >= 0] == truth[truth >= 0]).all())
        assert not match or 0.15 < match.noise < 0.6
    assert right >= 9
