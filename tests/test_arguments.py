"""Options and arguments of the wrong kind, size or shape: one clear error, before any work."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.errors import InputError
from rootmatch.simulation import p3p_scene

SCENE = p3p_scene(6, 1, 0.5, 0)
CAMERA = rm.Camera(1000, 1000, 320, 240)


@pytest.mark.parametrize(
    ("option", "value", "text"),
    [
        ("max_hyperedges", -1, "max_hyperedges: -1 given; give a whole number of at least 1"),
        ("max_hyperedges", 1.5, "max_hyperedges: 1.5 given"),
        ("max_hyperedges", "x", "max_hyperedges: 'x' given"),
        ("limit", "x", "limit: 'x' given"),
        ("limit", True, "limit: True given"),
        ("samples", 0, "samples: 0 given"),
        ("seed", -1, "seed: -1 given"),
        ("rho", [1, 2], r"rho: \[1, 2\] given; give a positive number"),
        ("rho", float("nan"), "rho: nan given"),
        ("motions", 0, "motions: 0 given"),
        ("motions", 2.0, "motions: 2.0 given"),
        ("motions", None, "motions: None given"),
        ("motions", "some", "motions: 'some' given"),
        ("progress", "x", "progress: 'x' given; give a function"),
        ("hyperedges", 7, "hyperedges: 7 given; give a sampler"),
        ("hyperedges", "all", "hyperedges: 'all' given"),
        ("hyperedges", rm.Guided, "hyperedges: .*Guided.* given; give a sampler"),
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


@pytest.mark.parametrize("problem", [5, "p3p", rm.P3P, None, CAMERA])
def test_what_is_no_problem_is_refused(problem: Any) -> None:
    with pytest.raises(InputError, match=r"problem: .*give a problem such as"):
        rm.match(SCENE.source, SCENE.target, problem)


@pytest.mark.parametrize("make", [rm.P3P, rm.UP2P, rm.ThreePlusOne])
def test_a_matrix_is_no_camera(make: Any) -> None:
    with pytest.raises(InputError, match="camera: ndarray given; give a Camera"):
        make(CAMERA.matrix)


def test_a_sampler_that_returns_nothing_is_named() -> None:
    with pytest.raises(InputError, match=r"hyperedges: .* returned NoneType"):
        rm.match(SCENE.source, SCENE.target, SCENE.problem, hyperedges=lambda task: None)


@pytest.mark.parametrize("samples", [1_000_000_000, 99_999_999_999_999_999_999])
def test_samples_beyond_the_limit_are_refused_beforehand(samples: int) -> None:
    with pytest.raises(InputError, match=r"samples: .* above the limit"):
        rm.match(SCENE.source, SCENE.target, SCENE.problem, samples=samples)


def test_a_matcher_checks_its_normals_once() -> None:
    with pytest.raises(InputError, match=r"normals: shape \(5, 3\) given"):
        rm.Matcher(SCENE.source, SCENE.problem, normals=np.ones((5, 3)))


def test_a_matcher_names_an_unknown_option() -> None:
    with pytest.raises(InputError, match="no option 'hyperedge'"):
        rm.Matcher(SCENE.source, SCENE.problem, hyperedge="auto")


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
