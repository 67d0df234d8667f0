"""The compiled fit of poses of a camera without a lens against that in NumPy for any camera, which shares no code."""

from __future__ import annotations

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.problems.pose_fit import absolute
from rootmatch.problems.pose_fit.pinhole_descent import factored, solved
from rootmatch.simulation import p3p_scene, up2p_scene


def both(monkeypatch: pytest.MonkeyPatch, problem: rm.Problem, points: object, assignments: np.ndarray) -> tuple:
    """The compiled fit and NumPy's."""
    quick = problem.fitted(points, assignments)
    with monkeypatch.context() as patch:
        patch.setattr(absolute, "_pinhole_fit", absolute.lens_fit)
        return quick, problem.fitted(points, assignments)


@pytest.mark.parametrize(("name", "tilt"), [("p3p", 0.0), ("up2p", 0.0), ("up2p", 0.02)])
def test_the_same_poses_as_in_numpy(name: str, tilt: float, monkeypatch: pytest.MonkeyPatch) -> None:
    for seed in range(6):
        scene = {"p3p": p3p_scene, "up2p": up2p_scene}[name](9, 4, noise=1.0, seed=seed)
        camera = scene.cameras[0]
        problem = rm.UP2P(camera, (0, 1, 0), (0, 1, 0), vertical_noise=tilt) if tilt else scene.problem
        points = problem.validated(scene.source, scene.target, np.linspace(0.5, 2.0, 13))
        right = np.array([scene.truth, np.where(np.arange(9) % 4 == 1, -1, scene.truth)])
        quick, slow = both(monkeypatch, problem, points, right)
        np.testing.assert_array_equal(quick.dof, slow.dof)
        np.testing.assert_array_equal(quick.seen, slow.seen)
        for field, tolerance in (
            ("chi2", 1e-6), ("evidence", 1e-6), ("rotation", 1e-5), ("translation", 1e-4), ("covariance", 1e-5),
            ("predicted", 1e-4), ("positions", 1e-4), ("jacobian", 1e-4),
        ):  # fmt: skip
            np.testing.assert_allclose(getattr(quick, field), getattr(slow, field), rtol=tolerance, atol=tolerance)
        # of a wrong assignment the two may end in other places, none much worse
        wrong = scene.truth.copy()
        wrong[[2, 5]] = wrong[[5, 2]]
        quick, slow = both(monkeypatch, problem, points, wrong[None])
        assert quick.chi2[0] > 50.0
        np.testing.assert_allclose(quick.chi2, slow.chi2, rtol=0.02)


def test_points_behind_the_camera_have_no_pose() -> None:
    scene = p3p_scene(6, 2, noise=1.0, seed=3)
    points = scene.problem.validated(scene.source, scene.target, 1.0)
    fit = scene.problem.fitted(points, np.random.default_rng(0).permuted(np.tile(np.arange(6), (40, 1)), axis=1))
    behind = fit.positions[..., 2].min(axis=1) <= 0.0
    np.testing.assert_array_equal(np.isinf(fit.chi2), behind)
    assert not np.isnan(fit.evidence).any()


def test_equations_that_determine_nothing_are_solved_with_a_huge_step() -> None:
    matrix = np.array([[4.0, 2.0, 0.0], [2.0, 3.0, 0.0], [0.0, 0.0, 0.0]])
    right = np.array([1.0, 2.0, 0.0])
    logarithm = factored(matrix, 3)
    solved(matrix, 3, right)
    np.testing.assert_allclose(right, [-0.125, 0.75, 0.0])
    assert logarithm == pytest.approx(np.log(8.0) + np.log(1e-300))
