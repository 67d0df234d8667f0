"""Options and arguments of the wrong kind, size or shape: one clear error, before any work."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.errors import InputError
from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.simulation import p3p_scene
from rootmatch.solvers import Solution

SCENE = p3p_scene(6, 1, 0.5, 0)
CAMERA = rm.Camera(1000, 1000, 320, 240)


@pytest.mark.parametrize(
    ("option", "value", "text"),
    [
        ("max_hyperedges", -1, "max_hyperedges: -1 given; give a whole number of at least 1"),
        ("max_hyperedges", 1.5, "max_hyperedges: 1.5 given"),
        ("max_hyperedges", "x", "max_hyperedges: 'x' given"),
        ("max_evaluations", "x", "max_evaluations: 'x' given"),
        ("max_evaluations", True, "max_evaluations: True given"),
        ("samples", 0, "samples: 0 given"),
        ("seed", -1, "seed: -1 given"),
        ("rho", [1, 2], r"rho: \[1, 2\] given; give a positive number"),
        ("rho", float("nan"), "rho: nan given"),
        ("motions", 0, "motions: 0 given"),
        ("motions", 2.0, "motions: 2.0 given"),
        ("motions", None, "motions: None given"),
        ("motions", "some", "motions: 'some' given"),
        ("progress", "x", "progress: 'x' given; give a function"),
        ("sampler", 7, "sampler: 7 given; give a sampler"),
        ("sampler", "all", "sampler: 'all' given"),
        ("sampler", rm.Guided, "sampler: .*Guided.* given; give a sampler"),
        ("residual", 3, "residual: 3 given"),
        ("scheduler", 3, "scheduler: 3 given"),
        ("backend", "gpu", "backend: 'gpu' given"),
        ("solver", 3, "solver: got 3"),
        ("solver", "best", "solver: got 'best'"),
        ("preset", "thesis", "preset: 'thesis' given"),
    ],
)
def test_options_of_the_wrong_kind_are_refused(option: str, value: Any, text: str) -> None:
    with pytest.raises(InputError, match=text):
        rm.match(SCENE.source, SCENE.target, SCENE.problem, **{option: value})
    with pytest.raises(InputError, match=text):
        rm.Matcher(SCENE.source, SCENE.problem, **{option: value})


def test_what_is_missing_is_named() -> None:
    with pytest.raises(InputError, match=r"^target: 0 points given, at least 4 needed by p3p"):
        rm.match(SCENE.source, [], SCENE.problem)
    with pytest.raises(InputError, match=r"^noise: None given; give the standard deviation"):
        rm.match(SCENE.source, SCENE.target, SCENE.problem, noise=None)  # type: ignore[arg-type]


@pytest.mark.parametrize("problem", [5, "p3p", rm.P3P, None, CAMERA])
def test_what_is_no_problem_is_refused(problem: Any) -> None:
    text = "the class P3P was given; pass an instance, such as" if problem is rm.P3P else "give a problem such as"
    with pytest.raises(InputError, match=rf"^problem: .*{text} rootmatch\.P3P\(camera\)$"):
        rm.match(SCENE.source, SCENE.target, problem)


@pytest.mark.parametrize("make", [rm.P3P, rm.UP2P, rm.ThreePlusOne])
def test_a_matrix_is_no_camera(make: Any) -> None:
    with pytest.raises(InputError, match="camera: ndarray given; give a Camera"):
        make(CAMERA.matrix)


def test_a_sampler_that_returns_nothing_is_named() -> None:
    with pytest.raises(InputError, match=r"sampler: .* returned NoneType"):
        rm.match(SCENE.source, SCENE.target, SCENE.problem, sampler=lambda task: None)


def solution(assignment: Any, shape: tuple[int, int], score: float = 0.0) -> Solution:
    """What a caller's solver might return."""
    return Solution(np.zeros(shape), assignment, score, alternatives=[], converged=True, iterations=1)


@pytest.mark.parametrize(
    ("solver", "text"),
    [
        (lambda tensor, seed: None, r"returned NoneType; a solver returns a Solution"),
        (lambda tensor, seed: solution(np.arange(tensor.shape[0] - 1), tensor.shape), "assignment: .* of shape"),
        (lambda tensor, seed: solution(np.arange(tensor.shape[0]) + 99, tensor.shape), "assignment: 99 to"),
        (lambda tensor, seed: solution(np.zeros(tensor.shape[0], int), tensor.shape), "matched twice"),
        (lambda tensor, seed: solution(np.full(tensor.shape[0], -1), (1, 1)), "soft: shape"),
        (lambda tensor: None, "cannot be called with a tensor and seed="),
    ],
)
def test_what_a_solver_may_get_wrong_is_told(solver: Any, text: str) -> None:
    with pytest.raises(InputError, match=f"solver: .*{text}"):
        rm.match(SCENE.source, SCENE.target, SCENE.problem, residual="qr", solver=solver)


@pytest.mark.parametrize("of", [(3, 3), None])
def test_a_samplers_tensor_is_of_its_task(of: tuple[int, int] | None) -> None:
    def sampler(task: SamplingTask) -> SampledTensor:
        order = task.order if of else task.order - 1
        return SampledTensor(rm.AffinityTensor(np.empty((0, order), np.int32), np.empty(0), of or task.shape), 0)

    with pytest.raises(InputError, match=r"sampler: .* returned a tensor of shape"):
        rm.match(SCENE.source, SCENE.target, SCENE.problem, sampler=sampler)


def test_a_solver_that_cannot_decide_is_told_once_a_line() -> None:
    given = SCENE.source, SCENE.target, SCENE.problem
    with pytest.warns(rm.InputWarning):
        rm.match(*given, solver="rrwhm")  # a compiler changes the filters, and all warnings are shown once more
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("default")
        for _ in range(2):
            rm.match(*given, solver="rrwhm")
        rm.match(*given, solver="rrwhm")
        rm.match(*given, solver="rrwhm", residual="qr")
        rm.match(*given, solver="rrwhm", preset="paper", samples=1000)
    assert len(told) == 2
    for one in told:
        assert one.category is rm.InputWarning
        assert "for p3p, fitted poses decide; this solver only adds proposals" in str(one.message)
        assert one.filename == __file__


def test_an_untrusted_match_of_the_paper_is_told_to_change_rho() -> None:
    match = rm.match(SCENE.source, SCENE.target, SCENE.problem, preset="paper", samples=100, rho=1e-12)
    assert match.status is rm.Status.UNTRUSTED
    assert "try another `rho`, or evaluate more hyper-edges with larger `samples`" in match.advice


@pytest.mark.parametrize("sampler", ["exhaustive", "guided", "auto", rm.Guided()])
def test_samples_are_of_the_random_sampler(sampler: Any) -> None:
    with pytest.raises(InputError, match=r'samples: it applies to sampler="random"'):
        rm.match(SCENE.source, SCENE.target, SCENE.problem, sampler=sampler, samples=1000)


@pytest.mark.parametrize("how", [{"sampler": "exhaustive"}, {"sampler": "random"}, {"sampler": "guided"}, {}])
def test_every_sampler_keeps_the_strongest_hyperedges(how: dict[str, Any]) -> None:
    every, few = (
        rm.match(SCENE.source, SCENE.target, SCENE.problem, max_hyperedges=maximum, **how)
        for maximum in (5_000_000, 10)
    )
    assert every.tensor.size > few.tensor.size == 10
    assert np.array_equal(np.sort(few.tensor.weights), np.sort(every.tensor.weights)[-10:])


@pytest.mark.parametrize("samples", [1_000_000_000, 99_999_999_999_999_999_999])
def test_samples_beyond_the_limit_are_refused_beforehand(samples: int) -> None:
    with pytest.raises(InputError, match=r"samples: .* above the limit"):
        rm.match(SCENE.source, SCENE.target, SCENE.problem, samples=samples)


def test_a_matcher_checks_its_normals_once() -> None:
    with pytest.raises(InputError, match=r"normals: shape \(5, 3\) given"):
        rm.Matcher(SCENE.source, SCENE.problem, normals=np.ones((5, 3)))


def test_a_matcher_names_an_unknown_option() -> None:
    with pytest.raises(TypeError, match="'hyperedge'"):
        rm.Matcher(SCENE.source, SCENE.problem, hyperedge="auto")  # type: ignore[call-arg]


def test_a_matcher_keeps_no_array_of_the_caller() -> None:
    """What is changed later changes no frame."""
    n = len(SCENE.source)
    target = np.asarray(SCENE.target)
    given = {
        "noise": np.full(len(target), 0.5),
        "bodies": np.zeros(n, int),
        "normals": np.tile((0.0, 0.0, -1.0), (n, 1)),
    }
    given["view_angle"] = np.full(n, 3.0)
    matcher = rm.Matcher(SCENE.source, SCENE.problem, **given)
    before = matcher.match(target)
    for array in given.values():
        array[:] = 3
    after = matcher.match(target)
    assert np.array_equal(before.assignment, after.assignment)
    assert before.probability == after.probability


def test_points_as_opencv_gives_them() -> None:
    given = rm.match(SCENE.source, SCENE.target, SCENE.problem, noise=0.5)
    nested = rm.match(SCENE.source[:, None, :], SCENE.target[:, None, :], SCENE.problem, noise=0.5)
    np.testing.assert_array_equal(given.assignment, nested.assignment)


def test_only_a_match_to_be_believed_is_true() -> None:
    assert rm.Status.MATCHED
    assert not rm.Status.AMBIGUOUS
    assert not rm.Status.UNTRUSTED


def test_integer_prior_weights_where_nothing_agrees() -> None:
    unrelated = np.random.default_rng(3).uniform(0, 480, (7, 2))
    found = rm.match(SCENE.source, unrelated, SCENE.problem, noise=0.01, candidates=np.ones((6, 7), int))
    assert found.status is not rm.Status.MATCHED


PAIRS_ALLOWED = {
    "fewer than the order": [(0, 0), (1, 1)],
    "in one column": [(i, 0) for i in range(6)],
    "in one row": [(0, j) for j in range(7)],
}


@pytest.mark.parametrize("weight", [5e-324, 1e-30, 1e9])
def test_uniform_prior_weights_change_nothing(weight: float) -> None:
    uniform = np.full((len(SCENE.source), len(SCENE.target)), weight)
    found = rm.match(SCENE.source, SCENE.target, SCENE.problem, noise=0.5, candidates=uniform)
    assert np.array_equal(found.assignment, SCENE.truth)


@pytest.mark.parametrize("weight", [1.1e9, 1e15, 1e100, 1e308])
def test_prior_weights_beside_which_points_count_for_nothing_are_refused(weight: float) -> None:
    with pytest.raises(InputError, match="at most 1e"):
        rm.match(SCENE.source, SCENE.target, SCENE.problem, noise=0.5, candidates=np.full((6, 7), weight))


@pytest.mark.parametrize("pairs", PAIRS_ALLOWED.values(), ids=PAIRS_ALLOWED)
@pytest.mark.parametrize("weight", [True, 3])
def test_candidates_without_a_single_hyperedge(pairs: list[tuple[int, int]], weight: Any) -> None:
    candidates = np.zeros((6, 7), type(weight))
    for pair in pairs:
        candidates[pair] = weight
    found = rm.match(SCENE.source, SCENE.target, SCENE.problem, noise=0.5, candidates=candidates)
    assert found.status is rm.Status.UNTRUSTED
    assert found.evaluated == 0


def test_a_prior_is_no_evidence() -> None:
    """Prior weights may choose among assignments; that points agree is shown by hyper-edges alone."""
    rng = np.random.default_rng(3)
    for trial in range(20):
        unrelated = rng.uniform(0, 480, (7, 2))
        weights = rng.uniform(0.0, 100.0, (6, 7))
        bare = rm.match(SCENE.source, unrelated, SCENE.problem, noise=0.5)
        for given in (np.full((6, 7), 100.0), weights):
            found = rm.match(SCENE.source, unrelated, SCENE.problem, noise=0.5, candidates=given)
            assert found.status is not rm.Status.MATCHED or bare.status is rm.Status.MATCHED, trial


@pytest.mark.parametrize("frame", [[], np.empty((0, 2)), SCENE.target[:1], SCENE.target[:3]])
def test_a_frame_of_few_detections_is_an_empty_match(frame: Any) -> None:
    match = rm.Matcher(SCENE.source, SCENE.problem).match(frame)
    assert match.status is rm.Status.UNTRUSTED
    assert match.assignment.tolist() == [-1] * 6
    assert match.soft_assignment.shape == (6, len(frame))
    assert match.probability == match.log_odds == 0.0  # as of enough detections among which nothing is found
    assert match.noise_factor is None
    assert not (match.confidence > 0.9).any()
    assert "given, at least 4 needed" in match.advice


@pytest.mark.parametrize(
    "problem",
    [
        rm.Rigid(dimension=3),
        rm.Similarity(dimension=3),
        rm.PlanarMotion(rm.Camera(800, 800, 320, 240), axis=(0, 1, 0), axis2=(0, 1, 0)),
        rm.P3P(rm.Rig([(rm.Camera(800, 800, 320, 240), np.eye(3), np.zeros(3))])),
    ],
)
def test_a_frame_of_few_points_has_the_probability_zero(problem: rm.Problem) -> None:
    source = SCENE.source[:, : problem.source_dimension]
    frame: Any = np.zeros((1, problem.target_dimension))
    match = rm.Matcher(source, problem).match((frame[:, :2], [0]) if isinstance(problem, rm.P3P) else frame)
    assert match.status is rm.Status.UNTRUSTED
    assert match.probability == match.log_odds == 0.0


def test_what_has_no_probability_has_none_with_few_detections() -> None:
    matcher = rm.Matcher(SCENE.source, SCENE.problem, preset="paper")
    assert matcher.match(SCENE.target[:2]).probability is None


def test_a_frame_of_one_detection_many_times_is_an_empty_match() -> None:
    match = rm.Matcher(SCENE.source, SCENE.problem, noise="auto").match(SCENE.target[[1, 1, 1, 1, 1, 1]])
    assert match.status is rm.Status.UNTRUSTED
    assert (match.assignment == -1).all()
    assert "all 6 detections are the same" in match.advice
    with pytest.raises(InputError, match="target: all points are the same"):
        rm.match(SCENE.source, SCENE.target[[1] * 6], SCENE.problem)


@pytest.mark.parametrize("how", ["match", "matcher", "tracker"])
def test_two_detections_at_one_pixel_cost_no_other_match(how: str) -> None:
    scene = p3p_scene(10, 1, 0.5, 0)
    target = np.vstack([scene.target, scene.target[2]])
    given = scene.source, scene.problem
    match = {
        "match": lambda: rm.match(given[0], target, given[1], noise=0.5),
        "matcher": lambda: rm.Matcher(*given, noise=0.5).match(target),
        "tracker": lambda: rm.Tracker(*given, noise=0.5).update(target),
    }[how]()
    assert match.status is rm.Status.MATCHED
    (double,) = np.flatnonzero(scene.truth == 2)
    assert match.assignment[double] == -1
    np.testing.assert_array_equal(np.delete(match.assignment, double), np.delete(scene.truth, double))
    assert "1 of the points may have another detection, or none" in match.advice


@pytest.mark.parametrize("minimum", [0.999, 0.99999999, 1.0])
def test_a_probability_that_none_reaches_is_refused(minimum: float) -> None:
    with pytest.raises(InputError, match=rf"min_probability: {minimum!r} given; give less than 0\.999"):
        rm.match(SCENE.source, SCENE.target, SCENE.problem, min_probability=minimum)


def test_two_images_are_told_their_problems() -> None:
    with pytest.raises(InputError, match=r"^source: shape \(7, 2\) given, \(m, 3\) expected; for two images use"):
        rm.match(SCENE.target, SCENE.target, SCENE.problem)
    with pytest.raises(InputError, match=r"^target: shape \(6, 3\) given, \(m, 2\) expected$"):
        rm.match(SCENE.source, SCENE.source, SCENE.problem)


@pytest.mark.parametrize("problem", [5, rm.P3P])
def test_a_matcher_needs_a_problem(problem: Any) -> None:
    with pytest.raises(InputError, match=r"^problem: .* such as rootmatch\.P3P\(camera\)$"):
        rm.Matcher(SCENE.source, problem)


@pytest.mark.parametrize(
    ("points", "text"),
    [
        (np.ma.masked_greater(SCENE.source, 1.0), "masked"),
        (SCENE.source * 1j, "not an array of numbers"),
        (SCENE.source.astype(str), "not an array of numbers"),
        (SCENE.source * 1e150, r"lies beyond 1e\+100; choose another unit"),
        ((SCENE.source * 1e-150).tolist(), "all points lie within 1e-100; choose another unit"),
        ([[10**400, 0, 0]] * 6, "not an array of numbers"),
        ("points.csv", "not an array of numbers"),
        ({"x": 1}, "not an array of numbers"),
    ],
)
def test_points_that_are_no_finite_numbers_of_a_sane_size(points: Any, text: str) -> None:
    with pytest.raises(InputError, match=text):
        rm.match(points, SCENE.target, SCENE.problem)


def test_a_derived_problem_is_shown_without_its_code() -> None:
    shown = repr(rm.PlanarMotion(CAMERA, axis=(0, 1, 0)).derived)
    assert shown.startswith("DerivedProblem('planar', source=Bearings(")
    assert len(shown) < 1000


@pytest.mark.parametrize("noise", [0, 0.0, (np.arange(len(SCENE.target)) > 0).astype(float)])
def test_exact_detections_are_refused(noise: Any) -> None:
    with pytest.raises(InputError, match=r"^noise: 0 given, which no measured point can fit; give"):
        rm.match(SCENE.source, SCENE.target, SCENE.problem, noise=noise)


def test_too_few_detections_are_counted_in_the_callers_words() -> None:
    with pytest.raises(InputError, match=r"^target: 3 points given, at least 4 needed by p3p without prior=$"):
        rm.match(SCENE.source, SCENE.target[:3], SCENE.problem)


def test_detections_of_a_rig_without_cameras_are_refused() -> None:
    rig = rm.Rig([(rm.Camera(800.0, 800.0, 320.0, 240.0), np.eye(3), np.zeros(3))])
    with pytest.raises(InputError, match=r"for a rig, give \(pixels, camera index of each\)"):
        rm.match(SCENE.source, SCENE.target, rm.P3P(rig))


@pytest.mark.parametrize("name", ["seed", "max_hyperedges"])
def test_none_stands_for_no_number_that_has_a_default(name: str) -> None:
    with pytest.raises(InputError, match=f"^{name}: None given; give a whole number, or leave it out$"):
        rm.match(SCENE.source, SCENE.target, SCENE.problem, **{name: None})
