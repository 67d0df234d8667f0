"""Measured correspondences with ground truth, identities shuffled; skipped where the data are absent."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

import rootmatch as rm

Load = Callable[[str], dict[str, NDArray]]


def shuffled_view(
    data: dict[str, NDArray], view: int, points: NDArray | None, seed: int
) -> tuple[NDArray, NDArray, rm.P3P, NDArray]:
    """Model points, shuffled detections, problem and truth (−1: unseen) of one view, or of some of its points."""
    chosen = np.arange(len(data["points3d"])) if points is None else points
    image = data["points2d"][view][chosen]
    seen = np.flatnonzero(np.isfinite(image).all(axis=1))
    order = np.random.default_rng(seed).permutation(len(seen))
    truth = np.full(len(chosen), -1, dtype=np.int64)
    truth[seen[order]] = np.arange(len(seen))
    problem = rm.P3P(rm.Camera.from_matrix(data["K"][view]))
    return data["points3d"][chosen], image[seen[order]], problem, truth


def test_headset_view_0(load_shared: Load) -> None:
    source, target, problem, truth = shuffled_view(load_shared("vive_hmd_lighthouse"), 0, None, seed=0)
    assert (len(source), len(target)) == (32, 12)
    match = rm.match(source, target, problem, noise=0.1)
    np.testing.assert_array_equal(match.assignment, truth)


@pytest.mark.parametrize("view", range(4))
def test_headset_with_normals(load_shared: Load, view: int) -> None:
    data = load_shared("vive_hmd_lighthouse")
    source, target, problem, truth = shuffled_view(data, view, None, seed=view)
    match = rm.match(source, target, problem, noise=0.1, normals=data["normals3d"])
    np.testing.assert_array_equal(match.assignment, truth)


@pytest.mark.parametrize("view", range(4))
def test_film_tracks(load_shared: Load, view: int) -> None:
    source, target, problem, truth = shuffled_view(load_shared("tears_of_steel_01"), view, None, seed=view)
    match = rm.match(source, target, problem, noise=1.3)
    np.testing.assert_array_equal(match.assignment, truth)


@pytest.mark.parametrize("view", range(4))
def test_random_dots_of_the_cavity_target(load_shared: Load, view: int) -> None:
    data = load_shared("openptv_cavity_target")
    seen = np.flatnonzero(np.isfinite(data["points2d"][view]).all(axis=1))
    points = np.random.default_rng(view).choice(seen, 20, replace=False)
    source, target, problem, truth = shuffled_view(data, view, points, seed=view)
    match = rm.match(source, target, problem, noise=0.75)
    np.testing.assert_array_equal(match.assignment, truth)
