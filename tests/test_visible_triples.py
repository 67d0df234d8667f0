"""Triples of points with normals: shapes that their images may have, against random cameras and the general search."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import permutations

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

import rootmatch as rm
from rootmatch.deadline import NEVER
from rootmatch.samplers.guided.detection_grid import build_grid
from rootmatch.samplers.guided.listed_triples import make_rings, run_listed_tests
from rootmatch.samplers.guided.model_views import ModelViews, model_views
from rootmatch.samplers.guided.sequential_test import SequentialTest, prepare_sets, run_sequential_tests
from rootmatch.samplers.guided.triangle_shapes import ANY, SIDE, image_cells
from rootmatch.samplers.guided.visibility import LOST, TriedSets, detected_views
from test_visibility import CAMERA, NOISE, ball, view

Floats = NDArray[np.float64]


def rotation(rng: np.random.Generator) -> Floats:
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return np.asarray(turn * np.linalg.det(turn))


def views_of(points: Floats, normals: Floats) -> ModelViews:
    return model_views(points, normals)


def tables_of(seed: int, clutter: int) -> tuple[object, NDArray[np.int64]]:
    points, normals, pixels, truth = view(seed, clutter)
    return rm.P3P(CAMERA).prepare(points, pixels, NOISE, normals), truth


def seen_from_random(
    rng: np.random.Generator, near: float, far: float, count: int
) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.int16]]]:
    """Which points of a ball are visible from random cameras, and the cells of their triples' shapes."""
    points, normals = ball(5)
    for _ in range(count):
        direction = rng.normal(size=3)
        camera = direction / np.linalg.norm(direction) * rng.uniform(near, far)
        towards = camera - points
        visible = (towards * normals).sum(axis=1) > 0.1 * np.linalg.norm(towards, axis=1)
        rays = -towards / np.linalg.norm(towards, axis=1, keepdims=True) @ rotation(rng)
        yield visible, image_cells(np.ascontiguousarray(rays.T))


def test_a_wave_and_all_of_them_are_of_one_type() -> None:
    """Those of a wave were read-only: where later frames took all, a kernel was loaded, or compiled, once more."""
    views, tables = views_of(*ball(5)), tables_of(5, 0)[0]
    one, every = views.wave(3, tables).prepared, views.every(tables, 10**9, NEVER, wide=True)[0].prepared
    assert [numba.typeof(part) for part in one] == [numba.typeof(part) for part in every]


def test_what_is_visible_has_a_shape_of_its_table_and_chance_seldom_has() -> None:
    wave = views_of(*ball(5)).wave(3, tables_of(5, 0)[0])
    sets, rng = wave.prepared.points, np.random.default_rng(0)
    rows = np.arange(len(sets))
    there, by_chance = [], []
    for visible, cells in seen_from_random(rng, 0.3, 3.0, 60):
        whole = visible[sets].all(axis=1)
        there.append(wave.shapes[rows, cells[sets[:, 0], sets[:, 1], sets[:, 2]]][whole])
        anyone = np.array([rng.choice(np.flatnonzero(visible), 3, replace=False) for _ in sets])
        by_chance.append(wave.shapes[rows, cells[anyone[:, 0], anyone[:, 1], anyone[:, 2]]])
    assert np.concatenate(there).size > 100
    assert np.concatenate(there).mean() > 0.99
    assert np.concatenate(by_chance).mean() < 0.4


def test_what_is_seen_from_near_has_a_shape_of_its_table_and_chance_seldom_has() -> None:
    wave = views_of(*ball(5)).wave(3, tables_of(5, 0)[0])
    sets, radius = wave.prepared.points, float(np.linalg.norm(ball(5)[0], axis=1).max())
    rows = np.arange(len(sets))
    there, by_chance = [], []
    for visible, cells in seen_from_random(np.random.default_rng(1), 1.1 * radius, 2.0 * radius, 400):
        own = cells[sets[:, 0], sets[:, 1], sets[:, 2]]
        wide = (own >= 2 * SIDE * SIDE) & (own < ANY)
        there.append(wave.shapes[rows, own][wide & visible[sets].all(axis=1)])
        by_chance.append(wave.shapes[rows, own][wide & ~visible[sets].any(axis=1)])
    assert np.concatenate(there).size > 50
    assert np.concatenate(there).mean() > 0.99
    assert np.concatenate(by_chance).mean() < 0.4


def test_a_triple_seen_from_nearest_is_of_any_shape() -> None:
    wide = np.array([[0.8, -0.8, 0.0], [0.0, 0.1, 0.9], [0.3, 0.3, 0.3]])
    cells = image_cells(wide / np.linalg.norm(wide, axis=0))
    assert all(cells[order] == ANY for order in permutations(range(3)))


def test_only_triples_that_face_a_camera_amid_them_are_of_any_shape() -> None:
    whole = views_of(*ball(5)).every(tables_of(5, 0)[0], 10**9, NEVER, wide=True)[0]
    assert whole.shapes[:, ANY].mean() < 0.2  # who is inside of a ball sees no point's front
    rng = np.random.default_rng(2)
    plate = np.column_stack([rng.uniform(-1.0, 1.0, (8, 2)), np.zeros(8)])
    normals = np.tile([0.0, 0.0, 1.0], (8, 1))
    tables = rm.P3P(CAMERA).prepare(plate, rng.uniform(0.0, 400.0, (8, 2)), NOISE, normals)
    whole = views_of(plate, normals).every(tables, 10**9, NEVER, wide=True)[0]
    assert whole.shapes[:, ANY].all()


def test_missed_is_that_of_the_sets_tried() -> None:
    points, normals = ball(6)
    views = views_of(points, normals)
    tried = TriedSets(partial(detected_views, normals=normals), LOST)
    assert views.missed(7, 0) == 1.0
    for number in range(4):
        first, last = views.edges[number]
        tried.add(views.ordered[first:last])
        assert views.missed(7, number + 1) == pytest.approx(tried.missed(7), rel=1e-12)


@pytest.mark.parametrize("masked", [False, True])
def test_what_survives_is_what_survives_the_general_search(masked: bool) -> None:
    tables, truth = tables_of(0, 2)
    n, n_target = len(truth), tables.rays.shape[1]  # type: ignore[attr-defined]
    sets = views_of(
        np.ascontiguousarray(tables.points.T),
        np.ascontiguousarray(tables.normals[:3].T),  # type: ignore[attr-defined]
    ).wave(4, tables)
    chosen = sets.prepared.points
    grid = build_grid(tables.rays, 0.004)  # type: ignore[attr-defined]
    rules = SequentialTest(hit=3.0, fall=3.0, miss=-0.2, floor=-100.0, minimum=4, normals=True)
    rng = np.random.default_rng(2)
    allowed = rng.random((n, n_target)) < 0.8 if masked else np.empty((0, 0), np.bool_)
    if masked:
        allowed[np.flatnonzero(truth >= 0), truth[truth >= 0]] = True
    ring = make_rings(np.arange(n_target), grid.positions, [n_target - 1])[0]
    found, _, counts = run_listed_tests(
        tables, grid, rules, sets.prepared, ring,
        shapes=sets.shapes, cells=image_cells(grid.rays), allowed=allowed, keep=4000, chunks=2,
    )  # fmt: skip
    general = prepare_sets(tables, chosen, sets.prepared.others, np.zeros(len(chosen), np.int64))
    arrangements = np.array(list(permutations(range(n_target), 2)), np.int32)
    every, _, all_counts = run_sequential_tests(
        tables, grid, rules, general, arrangements, 0, len(chosen) * len(arrangements), allowed, 4000, 2
    )
    rows = {tuple(row) for row in found.reshape(-1, 5).tolist() if row[0] >= 0}
    expected = {tuple(row) for row in every.reshape(-1, 5).tolist() if row[0] >= 0}
    assert len(rows & expected) >= 0.99 * len(rows)
    assert len(rows & expected) >= 0.97 * len(expected)
    assert counts[:, 0].sum() < 0.5 * all_counts[:, 0].sum()


def test_rings_have_each_image_triple_once() -> None:
    """Those of one size after the other are those of the largest alone."""
    tables, _ = tables_of(0, 12)
    grid = build_grid(tables.rays, 0.004)  # type: ignore[attr-defined]
    sets, images = views_of(*ball(0)).wave(2, tables), np.arange(0, tables.rays.shape[1], 2)  # type: ignore[attr-defined]
    rules = SequentialTest(hit=3.0, fall=3.0, miss=-0.2, floor=-100.0, minimum=3, normals=True)
    none = np.empty((0, 0), np.bool_)

    def tried(sizes: list[int]) -> list[tuple[int, ...]]:
        every = []
        for ring in make_rings(images, grid.positions, sizes):
            found, _, _ = run_listed_tests(
                tables, grid, rules, sets.prepared, ring,
                shapes=sets.shapes, cells=image_cells(grid.rays), allowed=none, keep=4000, chunks=2,
            )  # fmt: skip
            every += [tuple(row) for row in found.reshape(-1, 5).tolist() if row[0] >= 0]
        return sorted(every)

    assert (whole := tried([len(images) - 1]))
    assert tried([3, 6, len(images) - 1]) == whole
    costs = [ring.cost for ring in make_rings(images, grid.positions, [3, 6, len(images) - 1])]
    assert sum(costs) == len(images) * (len(images) - 1) * (len(images) - 2)


def body(seed: int, n: int, strays: int, fold: int = 1) -> tuple[Floats, Floats, Floats]:
    """Points (n, 3) of a closed surface that looks the same after part of a turn, their normals, and detections."""
    rng = np.random.default_rng(seed)
    normals, axes = rng.normal(size=(n // fold, 3)), np.array([0.12, 0.12, 0.08])
    turns = [np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) for c, s in parts_of_a_turn(fold)]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = np.concatenate([normals * axes @ turn.T for turn in turns])
    normals = np.concatenate([normals / axes @ turn.T for turn in turns])
    turn = rotation(rng).T
    inside = points @ turn + np.array([0.0, 0.0, 1.2])
    cosine = -(
        (inside * (normals @ turn)).sum(axis=1) / np.linalg.norm(inside, axis=1) / np.linalg.norm(normals, axis=1)
    )
    seen = cosine > 0.2
    pixels = CAMERA.project(inside[seen]) + rng.normal(scale=NOISE, size=(int(seen.sum()), 2))
    return points, normals, np.concatenate([pixels, rng.uniform((0.0, 0.0), (1280.0, 960.0), (strays, 2))])


def parts_of_a_turn(fold: int) -> list[tuple[float, float]]:
    """Cosines and sines of equal parts of a turn."""
    angles = 2.0 * np.pi * np.arange(fold) / fold
    return list(zip(np.cos(angles).tolist(), np.sin(angles).tolist(), strict=True))


def test_an_object_that_is_small_in_a_large_image_is_found_soon() -> None:
    """Images that lie close together come first; 14.7 million evaluations where they do not."""
    points, normals, pixels = body(4, 24, 60)
    match = rm.match(points, pixels, rm.P3P(CAMERA), noise=NOISE, normals=normals)
    assert match.status is rm.Status.MATCHED
    assert match.evaluated < 7_000_000


@pytest.mark.parametrize("fold", [1, 2])
def test_rivals_of_many_points_are_met_by_local_triples(fold: int) -> None:
    """A body that looks the same after half a turn has another pose. Wide ones take 16 and 11 million evaluations."""
    points, normals, pixels = body(1, 100, 0, fold)
    match = rm.match(points, pixels, rm.P3P(CAMERA), noise=NOISE, normals=normals)
    assert (match.status is rm.Status.MATCHED) == (fold == 1)
    assert bool(len(match.alternatives)) == (fold == 2)
    assert match.evaluated < 3_000_000
