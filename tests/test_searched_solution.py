"""The solution named by a search against the solver's, and when the solver is asked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rootmatch.explain.match_options import MatchOptions
from rootmatch.explain.sampling import sample
from rootmatch.explain.searched_solution import completed, searched_solution
from rootmatch.explain.task import MatchingTask
from rootmatch.samplers.base import SampledTensor
from rootmatch.simulation import up2p_scene
from rootmatch.solvers import MultiStartAscent

SCENE = up2p_scene(20, 20, noise=1.0, seed=7)


@pytest.fixture(scope="module")
def searched() -> tuple[MatchingTask, SampledTensor]:
    task = MatchingTask.of(SCENE.problem, SCENE.source, SCENE.target, noise=1.0, options=MatchOptions(sampler="guided"))
    return task, sample(task)


def test_it_is_what_the_solver_finds(searched: tuple[MatchingTask, SampledTensor]) -> None:
    solution, solved = searched_solution(*searched), MultiStartAscent()(searched[1].tensor)
    assert solution is not None
    assert SCENE.accuracy(solution.assignment) == 1.0
    assert solution.score == pytest.approx(searched[1].tensor.score(solution.assignment))
    assert solution.score == pytest.approx(solved.score)
    assert np.array_equal(solution.soft.argmax(axis=1), solution.assignment)
    assert np.allclose(solution.soft.sum(axis=1), 1.0)


def test_points_that_were_left_out_are_added(searched: tuple[MatchingTask, SampledTensor]) -> None:
    tensor, whole = searched[1].tensor, MultiStartAscent()(searched[1].tensor).assignment
    part = np.where(np.arange(20) % 4 == 0, -1, whole)
    assert np.array_equal(completed(tensor, part)[0], whole)


@pytest.mark.parametrize(
    "changes", [{"conclusive": False}, {"assignments": None}, {"missed": 0.9}, {"assignments": "part"}]
)
def test_solver_is_asked_where_something_else_may_score_as_much(
    searched: tuple[MatchingTask, SampledTensor], changes: dict[str, object]
) -> None:
    task, sampled = searched
    if changes.get("assignments") == "part":
        assert sampled.assignments is not None
        changes = {"assignments": np.where(np.arange(20) < 10, sampled.assignments, -1)}
    assert searched_solution(task, sampled._replace(**changes)) is None  # type: ignore[arg-type]


def test_a_solver_that_was_named_is_asked(searched: tuple[MatchingTask, SampledTensor]) -> None:
    task, sampled = searched
    named = replace(task, options=replace(task.options, solver="ascent"))
    assert searched_solution(named, sampled) is None
