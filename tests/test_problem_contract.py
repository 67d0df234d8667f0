"""Every exported problem × every public feature: it works, or it gives one clear error, as the problem declares.

A problem that is added to `rootmatch.problems.PROBLEMS` needs a line in `CASES` here and has to keep all of it. Scenes
are small and easy: what is asked for is that features and problems go together, not how far either goes.
"""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

import rootmatch as rm
from robot_scenes import INTRINSICS, moved_points, robot, zoomed
from rootmatch.backends.selection import device_backend
from rootmatch.hypergraph.affinity import KINDS, NOISE_KINDS
from rootmatch.problems import PROBLEMS, problem_class
from rootmatch.problems.derived.problem import DerivedProblem
from rootmatch.problems.kernels import ProblemKernels, kernel_record
from rootmatch.problems.points import TwoViews
from rootmatch.problems.residual_kinds import Joint
from rootmatch.report.json_record import match_record
from rootmatch.report.pictures import match_figure
from rootmatch.samplers.completion import Completion
from rootmatch.simulation import p3p_scene, three_plus_one_scene, up2p_scene
from rootmatch.solvers import SOLVERS

CAMERA = rm.Camera(*INTRINSICS)


class Case(NamedTuple):
    """A problem, an easy scene of it and its truth: the target of each source point, and the pose as `rm.Pose`."""

    problem: rm.Problem
    source: np.ndarray
    target: np.ndarray
    truth: np.ndarray
    noise: float
    R: np.ndarray
    t: np.ndarray

    @property
    def n(self) -> int:
        return len(self.source)

    @property
    def n_target(self) -> int:
        return len(self.target)

    @property
    def kernels(self) -> ProblemKernels:
        return kernel_record(self.problem.prepare(self.source, self.target))

    @property
    def views(self) -> TwoViews | None:
        return self.problem.two_views(self.problem.validated(self.source, self.target))

    def match(self, **options: Any) -> rm.Match:
        return rm.match(self.source, self.target, self.problem, **{"noise": self.noise, **options})


def simulated(scene: Any) -> Case:
    R, t = scene.poses[0]
    return Case(scene.problem, scene.source, scene.target, scene.truth, scene.noise, R, t)


def planar() -> Case:
    scene = robot(7, outliers=1, noise=0.05, seed=4)
    problem = rm.PlanarMotion(CAMERA, axis=scene.vertical, axis2=scene.vertical)
    return Case(problem, scene.source, scene.target, scene.truth, 0.05, scene.rotation, scene.translation)


def derived() -> Case:
    """A problem as `rootmatch.derive` makes them, with formulas whose kernels `PlanarMotion` has compiled already."""
    case = planar()
    assert isinstance(case.problem, rm.PlanarMotion)
    behind = case.problem.derived
    return case._replace(problem=DerivedProblem("own", behind.generated, behind.source, behind.target))


def unknown_zoom() -> Case:
    scene = zoomed(6, outliers=1, noise=0.1, seed=0, depth=5.0)
    problem = rm.UP2PF((320.0, 240.0), scene.vertical, (0, 1, 0))
    return Case(problem, scene.source, scene.target, scene.truth, 0.1, scene.rotation, scene.translation)


def point_sets(problem: type[rm.Similarity], dimension: int) -> Case:
    source, target, truth = moved_points(dimension, 7, 1, 0.002, 3, 1.0 if problem is rm.Rigid else 1.7)
    pose = np.linalg.lstsq(np.c_[source, np.ones(7)], target[truth], rcond=None)[0].T
    scale = np.linalg.det(pose[:, :dimension]) ** (1.0 / dimension)
    return Case(problem(dimension), source, target, truth, 0.002, pose[:, :dimension] / scale, pose[:, dimension])


CASES: dict[str, Callable[[], Case]] = {
    "p3p": lambda: simulated(p3p_scene(6, 1, noise=0.2, seed=1)),
    "up2p": lambda: simulated(up2p_scene(6, 1, noise=0.2, seed=1)),
    "3p1": lambda: simulated(three_plus_one_scene(7, 1, noise=0.1, seed=1, baseline=4.0)),
    "planar": planar,
    "up2pf": unknown_zoom,
    "similarity": lambda: point_sets(rm.Similarity, 2),
    "similarity in space": lambda: point_sets(rm.Similarity, 3),
    "rigid": lambda: point_sets(rm.Rigid, 2),
    "rigid in space": lambda: point_sets(rm.Rigid, 3),
    "derived": derived,
}
case_of = cache(lambda name: CASES[name]())


@cache
def plain_match(name: str) -> rm.Match:
    return case_of(name).match()


@pytest.fixture(params=list(CASES))
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def case(name: str) -> Case:
    return case_of(name)


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as here:
        yield here.scheduler_address


def one_to_one(assignment: np.ndarray, shape: tuple[int, int]) -> bool:
    matched = assignment[assignment >= 0]
    return bool(
        assignment.shape == shape[:1]
        and assignment.dtype == np.int64
        and assignment.min() >= -1
        and assignment.max() < shape[1]
        and len(set(matched.tolist())) == len(matched)
    )


def holds(match: rm.Match, case: Case) -> None:
    """What every match keeps, whatever it was asked for."""
    shape = case.n, case.n_target
    assert one_to_one(match.assignment, shape)
    for other, _ in match.alternatives:
        assert one_to_one(other, shape)
        assert not np.array_equal(other, match.assignment)
    assert match.soft_assignment.shape == match.tensor.shape == shape
    assert (match.soft_assignment >= 0.0).all()
    assert 0.0 <= match.margin <= 1.0
    assert match.probability is None or 0.0 <= match.probability <= 1.0
    assert isinstance(match.converged, bool)
    assert isinstance(match.status, rm.Status)
    assert match.advice
    assert match.evaluated > 0
    assert match.score >= 0.0
    assert ((match.motion_labels >= 0) == (match.assignment >= 0)).all()
    sizes = np.bincount(match.motion_labels[match.motion_labels >= 0])
    assert (np.diff(sizes) <= 0).all()
    assert (sizes > 0).all()


def right(match: rm.Match, case: Case) -> None:
    holds(match, case)
    assert match.assignment.tolist() == case.truth.tolist()


def same(one: rm.Match, other: rm.Match) -> None:
    np.testing.assert_array_equal(one.assignment, other.assignment)
    np.testing.assert_allclose(one.score, other.score, rtol=1e-12)
    assert one.status is other.status


def refused(argument: str, case: Case, use: Callable[[], object]) -> None:
    """One error in one line: the argument, the problem, what it lacks; what to do instead."""
    with pytest.raises(rm.InputError) as caught:
        use()
    text = str(caught.value)
    assert text.startswith(f"{argument}: {case.problem.name} ")
    assert "; " in text
    assert "\n" not in text


def works_or_is_refused(declared: object, argument: str, case: Case, use: Callable[[], rm.Match]) -> None:
    if declared:
        right(use(), case)
    else:
        refused(argument, case, use)


def test_every_exported_problem_is_here() -> None:
    assert set(PROBLEMS) <= set(CASES)
    for name in PROBLEMS:
        assert problem_class(name).name == name
        assert getattr(rm, problem_class(name).__name__) is problem_class(name) is type(case_of(name).problem)


def test_what_is_declared_fits_together(case: Case) -> None:
    problem = case.problem
    assert problem.order == problem.minimal + 1
    assert case.source.shape[1] == problem.source_dimension
    assert case.target.shape[1] == problem.target_dimension
    assert problem.min_for_pose == 0 or problem.min_for_pose >= problem.minimal
    assert len(case.kernels.residuals) == len(KINDS)
    assert 1 <= problem.constraints <= problem.pair_count


def test_polynomials_of_minimal_sets_share_a_root(case: Case) -> None:
    m = case.problem.minimal
    sets = np.array([[*range(m - 1), last] for last in (m - 1, m)])
    polynomials = case.problem.coefficients(case.source[sets], case.target[case.truth[sets]])
    assert polynomials.shape == (2, case.problem.degree + 1)
    first, second = (np.roots(row) for row in polynomials)
    assert np.abs(first[:, None] - second).min() < 0.05 * (1.0 + np.abs(first).min())


def test_match(name: str, case: Case) -> None:
    match = plain_match(name)
    right(match, case)
    assert match.status is rm.Status.MATCHED
    assert match.score == pytest.approx(match.tensor.score(match.assignment))
    points, problem = match.task.points, case.problem
    searched = problem.point_clouds, problem.two_views, problem.at_focal_lengths
    weighed = problem.takes_prior or any(one(points) is not None for one in searched)
    assert (match.probability is not None) == weighed


def test_matcher_takes_frames_of_any_size(name: str, case: Case) -> None:
    matcher = rm.Matcher(case.source, case.problem, noise=case.noise)
    same(matcher.match(case.target), plain_match(name))
    fewer = np.delete(case.target, case.truth[0], axis=0)
    same(matcher.match(fewer), rm.match(case.source, fewer, case.problem, noise=case.noise))
    same(matcher.match(case.target, noise=np.full(case.n_target, case.noise)), plain_match(name))


def test_poses(name: str, case: Case) -> None:
    match = plain_match(name)
    if not case.problem.min_for_pose:
        assert match.pose is None
        refused("pose", case, lambda: match.poses)
        refused("pose", case, lambda: match.alternative_poses)
        return
    (pose,) = match.poses
    assert pose is not None
    R, t = pose
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R @ R.T, np.eye(len(R)), atol=1e-9)
    np.testing.assert_allclose(R, case.R, atol=0.05)
    if case.problem.source_dimension == 2 and hasattr(case.problem, "camera"):
        np.testing.assert_allclose(t, case.t / np.linalg.norm(case.t), atol=0.05)
    else:
        np.testing.assert_allclose(t, case.t, atol=0.2)
    assert pose.scale == pytest.approx(1.7, abs=0.01) if case.problem.name == "similarity" else pose.scale == 1.0
    assert (pose.focal is not None) == (case.problem.name == "up2pf")
    size = (6 if len(R) == 3 else 3) + (case.problem.name in ("similarity", "up2pf"))
    assert pose.covariance is not None
    assert pose.covariance.shape == (size, size)
    assert pose.points is not None
    assert pose.points.tolist() == np.flatnonzero(case.truth >= 0).tolist()
    assert pose.residuals is not None
    assert pose.residuals.shape == (case.n,)
    assert pose.predicted is not None
    assert pose.predicted.shape == (case.n, case.target.shape[1])
    distances = np.linalg.norm(case.target[case.truth] - pose.predicted, axis=1)
    np.testing.assert_allclose(pose.residuals, distances, rtol=1e-6, atol=1e-9)
    assert pose.rms == pytest.approx(np.sqrt((distances**2).mean()))
    assert pose.rms_sigma is not None
    assert 0.1 < pose.rms_sigma < 3.0
    assert pose.inliers is not None
    assert set(pose.inliers) <= set(pose.points)
    np.testing.assert_array_equal(match.poses[0].R, R)  # type: ignore[union-attr]
    assert len(match.alternative_poses) == len(match.alternatives)
    few = match.assignment.copy()
    few[case.problem.min_for_pose - 1 :] = -1
    assert match.poses_of(few) == [None]
    with pytest.raises(rm.InputError, match="assignment: "):
        match.poses_of(few[:-1])


def test_normals(case: Case) -> None:
    """Towards the camera all points are visible; a point that looks away is not matched."""
    visible = np.ones((case.n, 3))
    if case.problem.takes_normals:
        visible = -case.R.T @ case.t - case.source
    works_or_is_refused(case.problem.takes_normals, "normals", case, lambda: case.match(normals=visible))
    if not case.problem.takes_normals:
        refused("normals", case, lambda: rm.Matcher(case.source, case.problem, normals=visible))
    else:
        visible[0] *= -1.0
        match = case.match(normals=visible)
        holds(match, case)
        assert match.assignment[0] != case.truth[0]


def test_view_angle(case: Case) -> None:
    """A point is seen within the angle of its normal, by searches (with their slack) and by fits."""
    with pytest.raises(rm.InputError, match="view_angle: it is measured from the normals"):
        case.match(view_angle=0.7)
    if not case.problem.takes_normals:
        return
    normals = -case.R.T @ case.t - case.source
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    aside = np.cross(normals[0], [0.3, 1.0, 0.2])
    aside /= np.linalg.norm(aside)
    normals[0] = np.cos(np.radians(60.0)) * normals[0] + np.sin(np.radians(60.0)) * aside
    angles = np.full(case.n, np.radians(40.0))
    match = case.match(normals=normals, view_angle=angles)
    holds(match, case)
    assert match.assignment[0] != case.truth[0]
    angles[0] = np.radians(75.0)
    match = case.match(normals=normals, view_angle=angles)
    assert match.assignment[0] == case.truth[0]
    with pytest.raises(rm.InputError, match="view_angle: shape"):
        case.match(normals=normals, view_angle=angles[1:])
    with pytest.raises(rm.InputError, match=r"1.3°, within which no point .* --view-angle 70"):
        case.match(normals=normals, view_angle=np.radians(1.3))
    with pytest.raises(rm.InputError, match=r"\(0, π\]"):
        case.match(normals=normals, view_angle=0.0)


@pytest.mark.parametrize("kind", ["mask", "weights"])
def test_candidates(case: Case, kind: str) -> None:
    allowed = np.random.default_rng(0).random((case.n, case.n_target)) < 0.6
    allowed[np.arange(case.n), case.truth] = True
    right(case.match(candidates=allowed if kind == "mask" else 0.3 * allowed), case)
    allowed[0] = False
    match = case.match(candidates=allowed if kind == "mask" else 0.3 * allowed)
    holds(match, case)
    assert match.assignment[0] == -1


@pytest.mark.parametrize("motions", [2, "auto"])
def test_motions(case: Case, motions: Any) -> None:
    """There is one; what is matched is right, and asked for any number of them that one is found."""
    match = case.match(motions=motions)
    holds(match, case)
    matched = match.assignment >= 0
    assert (match.assignment[matched] == case.truth[matched]).all()
    if motions == "auto":
        assert matched.all()
        assert (match.motion_labels == 0).all()


def test_noise_is_estimated(case: Case) -> None:
    match = case.match(noise="auto")
    right(match, case)
    assert case.noise / 10.0 < match.noise < 10.0 * case.noise


def test_noise_of_each_point(name: str, case: Case) -> None:
    same(case.match(noise=np.full(case.n_target, case.noise)), plain_match(name))
    right(case.match(noise=case.noise * np.linspace(0.8, 2.0, case.n_target)), case)


def test_noise_of_source_and_target_apart(name: str, case: Case) -> None:
    declared = case.problem.noisy_source
    pair = case.noise, case.noise
    works_or_is_refused(declared, "noise", case, lambda: case.match(noise=pair))
    if declared:
        same(case.match(noise=pair), plain_match(name))
        each = np.full(case.n, 1.5 * case.noise), np.full(case.n_target, case.noise)
        right(case.match(noise=each), case)
        assert case.match(noise=each).score > plain_match(name).score


def test_exhaustive(name: str, case: Case) -> None:
    same(case.match(sampler="exhaustive"), plain_match(name))


def test_random(case: Case) -> None:
    right(case.match(sampler="random", samples=100_000), case)


def test_paper_preset(case: Case) -> None:
    holds(case.match(preset="paper", samples=20_000), case)


def test_guided(case: Case) -> None:
    points = case.problem.validated(case.source, case.target)
    searched = case.problem.point_clouds(points) or case.problem.at_focal_lengths(points) or case.views
    declared = case.kernels.hypotheses or searched
    works_or_is_refused(declared, "sampler", case, lambda: case.match(sampler="guided"))
    if not declared:
        refused("sampler", case, lambda: case.match(sampler=rm.Guided()))


def test_completion(case: Case) -> None:
    works_or_is_refused(case.kernels.completion, "sampler", case, lambda: case.match(sampler=Completion()))


def test_scheduler(name: str, case: Case, scheduler: str) -> None:
    same(case.match(scheduler=scheduler), plain_match(name))
    matcher = rm.Matcher(case.source, case.problem, noise=case.noise, scheduler=scheduler)
    same(matcher.match(case.target), plain_match(name))


@pytest.mark.parametrize("kind", KINDS)
def test_each_residual(case: Case, kind: str) -> None:
    """True hyper-edges have far smaller residuals than random ones."""
    rng = np.random.default_rng(0)
    order = case.problem.order
    source = np.array([rng.permutation(case.n)[:order] for _ in range(200)])
    wrong = np.array([rng.permutation(case.n_target)[:order] for _ in range(200)])
    points = case.source, case.target, case.problem, source
    true = rm.residuals(*points, case.truth[source], kind, case.noise)
    false = rm.residuals(*points, wrong, kind, case.noise)
    assert true.shape == (200,)
    assert (true >= 0.0).all()
    assert np.median(true) < 0.3 * np.median(false)
    if kind in NOISE_KINDS:
        assert np.median(true) < 3.0


def test_pairs_that_a_residual_does_not_have(case: Case) -> None:
    beyond = rm.Residual("qr", pairs=(case.problem.pair_count,)) if case.problem.pair_count < 6 else None
    if beyond is not None:
        refused("residual", case, lambda: case.match(residual=beyond))
        index = [[*range(case.problem.order)]]
        refused("residual", case, lambda: rm.residuals(case.source, case.target, case.problem, index, index, beyond))
    last = rm.Residual("joint", pairs=(case.problem.pair_count - 1,))
    right(case.match(residual=last, sampler="random", samples=100_000), case)


@pytest.mark.parametrize("solver", SOLVERS)
def test_each_solver(case: Case, solver: str) -> None:
    right(case.match(solver=solver), case)


def test_single_precision(case: Case) -> None:
    """Where there is no card that is said, after whether the problem has such kernels."""
    if not case.kernels.residuals[Joint].single:
        refused("backend", case, lambda: case.match(backend="cuda-float32"))
        return
    try:
        device_backend()
    except rm.InputError:
        with pytest.raises(rm.InputError, match="numba-cuda"):
            case.match(backend="cuda-float32")
    else:
        right(case.match(backend="cuda-float32"), case)


def test_json(name: str, case: Case) -> None:
    record = json.loads(json.dumps(match_record(plain_match(name)), allow_nan=False))
    assert record["assignment"] == case.truth.tolist()
    assert record["status"] == "matched"
    assert record["noise"] == case.noise
    assert (record["poses"] is not None) == bool(case.problem.min_for_pose)
    each = case.match(noise=np.full(case.n_target, case.noise))
    assert json.loads(json.dumps(match_record(each), allow_nan=False))["noise"] is None


def test_picture(name: str, case: Case) -> None:
    match = plain_match(name)
    poses = match.poses if case.problem.min_for_pose else None
    camera = getattr(case.problem, "camera", None)
    figure = match_figure(
        match.source,
        match.target,
        match.assignment,
        motions=match.motion_labels,
        truth=case.truth,
        poses=poses,
        camera=camera,
    )
    assert len(figure.axes) == 2
    assert len(figure.artists) == case.n


def test_pickling(name: str, case: Case) -> None:
    again = pickle.loads(pickle.dumps(case.problem))
    assert again == case.problem
    assert hash(again) == hash(case.problem)
    match = plain_match(name)
    kept = pickle.loads(pickle.dumps(match))
    same(kept, match)
    assert kept.problem == case.problem
    assert match_record(kept) == match_record(match)
