"""Invariants against their definitions and under the transformations that keep them; nearest tuples against all."""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path

import numpy as np
import pytest

from robot_scenes import moved_points
from rootmatch.errors import InputError
from rootmatch.hypergraph import invariants
from rootmatch.hypergraph.invariants import (
    INVARIANTS,
    Invariant,
    angle_sines,
    cross_ratios,
    invariant_affinities,
    nearest_hyperedges,
    side_lengths,
    signed_sines,
)
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.solvers import get_solver

RNG = np.random.default_rng(0)
TRIANGLES = {2: RNG.normal(size=(50, 3, 2)), 3: RNG.normal(size=(50, 3, 3))}
FIVES = RNG.normal(size=(50, 5, 2))


@pytest.mark.parametrize("dimension", [2, 3])
def test_angles_and_sides_are_those_of_the_triangle(dimension: int) -> None:
    sines, sides = angle_sines(TRIANGLES[dimension]), side_lengths(TRIANGLES[dimension])
    for triangle, sine, side in zip(TRIANGLES[dimension], sines, sides, strict=True):
        for k in range(3):
            to = [triangle[(k + s) % 3] - triangle[k] for s in (1, 2)]
            angle = math.acos(to[0] @ to[1] / np.linalg.norm(to[0]) / np.linalg.norm(to[1]))
            assert sine[k] == pytest.approx(math.sin(angle), abs=1e-12)
            assert side[k] == pytest.approx(math.dist(triangle[(k + 1) % 3], triangle[(k + 2) % 3]))


def test_cross_ratios_are_those_of_pencils_of_lines() -> None:
    """|431||521| / |421||531|: of the four lines from point 1 to the others, measured on a transversal."""
    for five, found in zip(FIVES, cross_ratios(FIVES), strict=True):
        centre = five[0]
        # the lines through point 1 meet the transversal y = centre_y + 1
        place = {k: centre[0] + (five[k - 1] - centre)[0] / (five[k - 1] - centre)[1] for k in (2, 3, 4, 5)}
        ratio = (place[4] - place[3]) * (place[5] - place[2]) / ((place[4] - place[2]) * (place[5] - place[3]))
        angle = 2.0 * math.atan(ratio)
        np.testing.assert_allclose(found[:2], (math.cos(angle), math.sin(angle)), atol=1e-8)


def test_what_each_transformation_keeps() -> None:
    rng = np.random.default_rng(1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    moved = TRIANGLES[3] @ turn.T + rng.normal(size=3)
    np.testing.assert_allclose(side_lengths(moved), side_lengths(TRIANGLES[3]), rtol=1e-12)
    np.testing.assert_allclose(angle_sines(3.7 * moved), angle_sines(TRIANGLES[3]), atol=1e-9)
    homography = np.eye(3) + 0.2 * rng.normal(size=(3, 3))
    lifted = np.concatenate((FIVES, np.ones((50, 5, 1))), axis=2) @ homography.T
    np.testing.assert_allclose(cross_ratios(lifted[..., :2] / lifted[..., 2:]), cross_ratios(FIVES), atol=1e-6)


def test_signed_sines_tell_a_triangle_from_its_mirror_image() -> None:
    triangles = TRIANGLES[2]
    for triangle, sines in zip(triangles, signed_sines(triangles), strict=True):
        for k in range(3):
            to = [triangle[(k + s) % 3] - triangle[k] for s in (1, 2)]
            angle = math.atan2(to[0][0] * to[1][1] - to[0][1] * to[1][0], to[0] @ to[1])
            assert sines[k] == pytest.approx(math.sin(angle), abs=1e-12)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    np.testing.assert_allclose(signed_sines(1.9 * triangles @ turn.T + 3.0), signed_sines(triangles), atol=1e-9)
    np.testing.assert_allclose(signed_sines(triangles * (-1.0, 1.0)), -signed_sines(triangles), atol=1e-12)


def test_what_they_do_not_keep() -> None:
    assert np.abs(side_lengths(1.1 * TRIANGLES[2]) - side_lengths(TRIANGLES[2])).min() > 1e-3
    assert np.median(np.abs(angle_sines(TRIANGLES[2] * (1.0, 1.3)) - angle_sines(TRIANGLES[2]))) > 1e-2
    assert np.median(np.abs(cross_ratios(FIVES**3) - cross_ratios(FIVES))) > 1e-2


@pytest.mark.parametrize("name", INVARIANTS)
def test_features_are_finite_where_points_coincide_or_lie_on_a_line(name: str) -> None:
    order = INVARIANTS[name].order
    line = np.column_stack((np.arange(float(order)), np.arange(float(order))))
    assert np.all(np.isfinite(INVARIANTS[name].features(np.stack((line, np.zeros_like(line))))))


@pytest.mark.parametrize("name", INVARIANTS)
def test_nearest_tuples_are_the_nearest_of_all(name: str) -> None:
    order = INVARIANTS[name].order
    n = order + 1
    source, target, _ = moved_points(2, n, noise=0.02, seed=3)
    i, j, gap = nearest_hyperedges(source, target, name, tuples=4, neighbours=5, seed=1)
    assert i.shape == j.shape == (20, order)
    every = np.array(list(itertools.permutations(range(n), order)))
    features = INVARIANTS[name].features
    of_target = features(target[every])
    tuples = sorted({tuple(sorted(row)) for row in i.tolist()})
    assert len(tuples) == 4
    for chosen in tuples:
        mine = [k for k, row in enumerate(i.tolist()) if tuple(sorted(row)) == chosen]
        assert len(mine) == 5
        # each hyper-edge once: the increasing source tuple against target tuples in all orders
        table = np.linalg.norm(features(source[None, list(chosen)]) - of_target, axis=1)
        np.testing.assert_allclose(np.sort(gap[mine]), np.sort(table)[:5], atol=1e-12)
    for a, b, g in zip(i, j, gap, strict=True):
        assert g == pytest.approx(float(np.linalg.norm(features(source[None, a]) - features(target[None, b]))))
    assert len(of_target) == math.perm(n, order)


def test_affinities_make_a_tensor_whose_weights_fall_with_the_distance() -> None:
    source, target, truth = moved_points(2, 8, outliers=2, noise=0.005, seed=4)
    indices, weights, shape = invariant_affinities(source, target, "angles", seed=0)
    tensor = AffinityTensor(indices, weights, shape)
    assert tensor.shape == (8, 10)
    assert tensor.order == 3
    assert weights.min() > 0.0
    assert weights.max() <= 1.0
    assert len({tuple(sorted(row)) for row in indices.tolist()}) == len(indices)
    right = truth[indices // 10] == indices % 10
    inside = (truth[indices // 10] == indices % 10).all(axis=1)
    assert right.shape == indices.shape
    assert weights[inside].mean() > 2.0 * weights[~inside].mean()


@pytest.mark.parametrize(
    ("name", "dimension", "scale"),
    [("angles", 2, 1.7), ("signed-angles", 2, 0.8), ("angles", 3, 0.4), ("distances", 2, 1.0), ("distances", 3, 1.0)],
)
def test_the_classical_pipeline_matches(name: str, dimension: int, scale: float) -> None:
    """Points, their nearest tuples, a tensor, a solver."""
    accuracy = []
    for seed in range(4):
        source, target, truth = moved_points(dimension, 10, 3, 0.005, seed, scale)
        tensor = AffinityTensor(*invariant_affinities(source, target, name, seed=seed))
        accuracy.append(np.mean(get_solver("ascent")(tensor, seed=0).assignment == truth))
    assert np.mean(accuracy) >= 0.95


def test_a_homography_by_cross_ratios() -> None:
    rng = np.random.default_rng(7)
    source = rng.uniform(-1.0, 1.0, (7, 2))
    homography = np.eye(3) + 0.15 * rng.normal(size=(3, 3))
    lifted = np.column_stack((source, np.ones(7))) @ homography.T
    order = rng.permutation(7)
    target = (lifted[:, :2] / lifted[:, 2:])[order] + 1e-4 * rng.normal(size=(7, 2))
    indices, weights, shape = invariant_affinities(source, target, "cross-ratios", tuples=21, neighbours=30)
    found = get_solver("ascent")(AffinityTensor(indices, weights, shape), seed=0)
    assert np.array_equal(found.assignment, np.argsort(order))


def test_the_same_seed_gives_the_same_and_another_another() -> None:
    source, target, _ = moved_points(2, 12, seed=5)
    one, again, other = (nearest_hyperedges(source, target, tuples=20, neighbours=3, seed=s) for s in (1, 1, 2))
    for a, b in zip(one, again, strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(one[0], other[0])


def test_several_trees_find_what_one_does(monkeypatch: pytest.MonkeyPatch) -> None:
    source, target, _ = moved_points(2, 8, seed=5)
    one = nearest_hyperedges(source, target, "angles", neighbours=20)
    monkeypatch.setattr(invariants, "TREE_TUPLES", 100)
    several = nearest_hyperedges(source, target, "angles", neighbours=20)
    np.testing.assert_array_equal(one[0], several[0])
    np.testing.assert_allclose(np.sort(one[2].reshape(-1, 20)), np.sort(several[2].reshape(-1, 20)), atol=1e-15)


def test_an_invariant_of_ones_own() -> None:
    """The ratio of two sides and nothing else."""
    own = Invariant(3, (2,), lambda p: side_lengths(p)[:, :1] / side_lengths(p)[:, 1:2])
    source, target, _ = moved_points(2, 6, seed=6, scale=2.0)
    _, _, gap = nearest_hyperedges(source, target, own, tuples=10, neighbours=1)
    assert gap.max() < 1e-9


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"invariant": "areas"}, "one of angles"),
        ({"invariant": "cross-ratios", "source": np.eye(3), "target": np.eye(3)}, "2 coordinates"),
        ({"source": np.zeros(5)}, "source"),
        ({"target": np.zeros((5, 2))}, "the same"),
        ({"target": np.array([[0.0, np.nan]] * 4)}, "NaN"),
        ({"tuples": 0}, "tuples"),
        ({"neighbours": 2.5}, "neighbours"),
        ({"source": np.eye(2)}, "at least 3"),
        (
            {"invariant": Invariant(3, (2,), lambda p: p[0])},
            r"features of shape \(3, 2\) for points of shape \(20, 3, 2",
        ),
        ({"invariant": Invariant(3, (2,), lambda p: p)}, "a row for each tuple"),
        ({"invariant": Invariant(3, (2,), lambda p: p[:, 0] * np.inf)}, "features of NaN or infinity"),
    ],
)
def test_bad_input(change: dict[str, object], text: str) -> None:
    points = np.random.default_rng(0).normal(size=(6, 2))
    with pytest.raises(InputError, match=text):
        nearest_hyperedges(**{"source": points, "target": points, **change})  # type: ignore[arg-type]


def test_the_page_of_more_problems_runs(capsys: pytest.CaptureFixture[str]) -> None:
    page = Path(__file__).resolve().parents[1] / "docs" / "more-problems.md"
    names: dict = {}
    for block in re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE):
        exec(compile(block, page.name, "exec"), names)
    assert capsys.readouterr().out == ""
    assert names["robot"].order == 3
    assert names["zoom"].order == 4
    assert 0.0 <= names["found"][0] < 4.0
    listed = (page.parent / "howto" / "graph-matching.md").read_text(encoding="utf-8")
    for name in INVARIANTS:
        assert f'`"{name}"`' in listed
