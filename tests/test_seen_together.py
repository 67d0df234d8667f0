"""Objects whose points are nearly all seen together: their normals tell a search nothing, but the judge something."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

import rootmatch as rm
from rootmatch.explain.match_options import MatchOptions
from rootmatch.explain.task import MatchingTask
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.search import Search
from rootmatch.samplers.guided.visibility import covisible_share, facing_points
from rootmatch.samplers.guided.visible_search import VisibleSearch, choose_search, ranks_triples

CAMERA = rm.Camera(900.0, 900.0, 640.0, 480.0)
NOISE = 0.3
Points = NDArray[np.float64]


def board(seed: int, tilt: float) -> tuple[Points, Points, Points, NDArray[np.int64]]:
    """Points of a flat board, their normals, pixels and truth, seen so many degrees off its normal among clutter."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-0.15, 0.15, (18, 2)), np.zeros(18)])
    normals = np.tile([0.0, 0.0, -1.0], (18, 1))
    turn, lean = rng.uniform(0.0, 2.0 * np.pi), np.radians(tilt)
    about_z = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[np.cos(lean), 0.0, np.sin(lean)], [0.0, 1.0, 0.0], [-np.sin(lean), 0.0, np.cos(lean)]])
    pixels = CAMERA.project(points @ (about_y @ about_z).T + [0.0, 0.02, 0.8]) + rng.normal(scale=NOISE, size=(18, 2))
    seen = np.sort(rng.permutation(18)[:15])
    middle, width = pixels.mean(axis=0), 2.0 * pixels.std(axis=0).max()
    pixels = np.vstack([pixels[seen], middle + rng.uniform(-width, width, (5, 2))])
    order = rng.permutation(len(pixels))
    truth = np.full(18, -1)
    truth[seen] = np.argsort(order)[: len(seen)]
    return points, normals, pixels[order], truth


def searched(points: Points, pixels: Points, normals: Points, view_angle: float | None = None) -> Search:
    """The search that suits these points, at its end."""
    task = MatchingTask.of(
        rm.P3P(CAMERA), points, pixels, noise=NOISE, options=MatchOptions(), normals=normals, view_angle=view_angle
    )
    search = choose_search(task.sampling_task, GuidedOptions(), task.deadline)
    search.run()
    return search


def test_the_share_of_triples_is_that_of_all_triples_in_all_views() -> None:
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(9, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    views = facing_points(normals)
    triples = np.array(list(combinations(range(9), 3)))
    shown = views[:, triples].all(axis=2)[views.sum(axis=1) >= 3]
    assert covisible_share(normals) == pytest.approx(shown.mean())


def test_one_side_of_a_plate_is_seen_together_and_two_sides_are_not() -> None:
    normals = np.tile([0.0, 0.0, 1.0], (20, 1))
    assert covisible_share(normals) == 1.0
    assert covisible_share(normals, np.zeros(20)) == 1.0
    normals[:10] *= -1.0
    assert covisible_share(normals) < 0.15
    assert covisible_share(np.zeros((20, 3))) == 1.0  # no normal hides anything
    assert covisible_share(normals[9:11]) == 0.0


@pytest.mark.parametrize("view_angle", [None, 0.5 * np.pi])
@pytest.mark.parametrize("seed", range(4))
def test_a_board_at_a_grazing_angle_is_found_by_the_search_itself(seed: int, view_angle: float | None) -> None:
    points, normals, pixels, truth = board(seed, 80.0)
    search = searched(points, pixels, normals, view_angle)
    assert not isinstance(search, VisibleSearch)
    assert search.conclusive
    assert search.is_beyond_chance()
    match = rm.match(points, pixels, rm.P3P(CAMERA), noise=NOISE, normals=normals, view_angle=view_angle)
    assert match.status is rm.Status.MATCHED
    claimed = match.assignment >= 0
    assert np.array_equal(match.assignment[claimed], truth[claimed])
    assert claimed.sum() >= 14


@pytest.mark.parametrize("seed", range(2))
def test_a_plate_with_two_sides_is_found_at_a_grazing_angle(seed: int) -> None:
    """All points of the side that is seen are seen edge-on, and those of the other side are not."""
    front, normals, pixels, truth = board(seed, 78.5)
    back = np.random.default_rng([seed, 1]).uniform(-0.15, 0.15, (18, 3)) * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.005]
    points, normals = np.vstack([front, back]), np.vstack([normals, -normals])
    assert isinstance(search := searched(points, pixels, normals), VisibleSearch)
    assert search.conclusive
    assert search.is_beyond_chance()
    match = rm.match(points, pixels, rm.P3P(CAMERA), noise=NOISE, normals=normals)
    claimed = match.assignment >= 0
    assert match.status is rm.Status.MATCHED
    assert np.array_equal(match.assignment[claimed], np.append(truth, np.full(18, -1))[claimed])
    assert claimed.sum() >= 14


def test_what_is_found_without_normals_is_judged_with_them() -> None:
    points, normals, pixels, _ = board(0, 40.0)
    assert rm.match(points, pixels, rm.P3P(CAMERA), noise=NOISE, normals=normals)
    assert not rm.match(points, pixels, rm.P3P(CAMERA), noise=NOISE, normals=-normals)


def test_a_rig_ranks_triples_of_a_board_by_its_normals_all_the_same() -> None:
    points, normals, pixels, _ = board(0, 40.0)
    task = MatchingTask.of(rm.P3P(CAMERA), points, pixels, noise=NOISE, options=MatchOptions(), normals=normals)
    assert ranks_triples(task.sampling_task)
