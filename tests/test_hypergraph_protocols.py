"""The public protocols: tensors against a tree over all ordered triangles, and a small sweep from end to end."""

from __future__ import annotations

import csv
import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.spatial import cKDTree
from typer.testing import CliRunner

from rootmatch.cli.app import app
from rootmatch.errors import InputError
from rootmatch.hypergraph.enumeration import subsets
from rootmatch.research.hypergraph import report
from rootmatch.research.hypergraph import run as protocols
from rootmatch.research.hypergraph.protocol import (
    DEFORMATION,
    ORDERS,
    OUTLIERS,
    POINTS,
    SETTINGS,
    Instance,
    instance,
    nearest_triangles,
    protocol_tensor,
)
from rootmatch.research.hypergraph.report import ACCURACY
from rootmatch.research.paper.settings import Setting
from rootmatch.research.paper.work_unit import Task, Unit
from rootmatch.solvers import get_solver

SMALL = {DEFORMATION: (Setting(DEFORMATION, 0, 0.1),), OUTLIERS: (Setting(OUTLIERS, 20, 0.01),)}


def turns(points: np.ndarray) -> np.ndarray:
    """Sines (T, 3) of triangles (T, 3, 2): at each point, from the next side to the one before, both of length 1."""
    found = []
    for k in range(3):
        on, back = (points[:, (k + s) % 3] - points[:, k] for s in (1, 2))
        cross = on[:, 0] * back[:, 1] - on[:, 1] * back[:, 0]
        found.append(cross / np.linalg.norm(on, axis=1) / np.linalg.norm(back, axis=1))
    return np.stack(found, axis=1)


def test_orders_are_all_orders_and_the_last_three_turn_over() -> None:
    assert {tuple(order) for order in ORDERS.tolist()} == set(itertools.permutations(range(3)))
    points = np.random.default_rng(1).normal(size=(1, 3, 2))
    signs = [np.sign(turns(points[:, order])[0, 0]) for order in ORDERS]
    assert signs == [signs[0]] * 3 + [-signs[0]] * 3


@pytest.mark.parametrize("count", [1, 7, 400, 6 * 220])
def test_most_alike_are_the_nearest_of_a_tree(count: int) -> None:
    rng = np.random.default_rng(2)
    source, target = rng.normal(size=(6, 2)), rng.normal(size=(12, 2))
    asked, index = turns(source[subsets(6, 3)]), subsets(12, 3)
    triangle, order, distance = nearest_triangles(asked, turns(target[index]), count)
    every = np.array(list(itertools.permutations(range(12), 3)))
    expected, _ = cKDTree(turns(target[every])).query(asked, k=count)
    np.testing.assert_allclose(np.sort(distance, axis=1), expected.reshape(len(asked), count), atol=1e-12)
    for row in range(len(asked)):
        corners = np.take_along_axis(index[triangle[row]], ORDERS[order[row]], axis=1)
        assert len({tuple(c) for c in corners.tolist()}) == count
        gap = np.linalg.norm(turns(target[corners]) - asked[row], axis=1)
        np.testing.assert_allclose(gap, distance[row], atol=1e-12)


def test_neighbours_of_a_symmetric_target_are_as_many_as_asked_for() -> None:
    """A regular polygon: all distances come many times."""
    angle = 2.0 * np.pi * np.arange(8) / 8.0
    asked = turns(np.random.default_rng(3).normal(size=(4, 2))[subsets(4, 3)])
    sines = turns(np.column_stack((np.cos(angle), np.sin(angle)))[subsets(8, 3)])
    triangle, order, _ = nearest_triangles(asked, sines, 50)
    assert triangle.shape == (4, 50)
    assert all(len(set(zip(t, o, strict=True))) == 50 for t, o in zip(triangle, order, strict=True))


@pytest.mark.parametrize("setting", [Setting(DEFORMATION, 0, 0.1), Setting(OUTLIERS, 5, 0.01)])
def test_tensor(setting: Setting) -> None:
    points = instance(setting, 3)
    n, n_target = len(points.source), len(points.target)
    assert (n, n_target) == (POINTS[setting.problem], POINTS[setting.problem] + setting.outliers)
    tensor = protocol_tensor(points, 3)
    i, j = np.divmod(tensor.indices, n_target)
    assert tensor.order == 3
    assert len({tuple(sorted(row)) for row in tensor.indices.tolist()}) == tensor.size
    assert all(len(set(row)) == 3 for row in [*i.tolist(), *j.tolist()])
    triangles, count = np.unique(np.sort(i, axis=1), axis=0, return_counts=True)
    assert set(count) == {n * n_target}
    # n·n' draws among all triangles, some of them several times: each is missed with probability exp(−n·n' / all)
    every = n * (n - 1) * (n - 2) / 6
    assert len(triangles) == pytest.approx(every * (1.0 - np.exp(-n * n_target / every)), rel=0.1)
    # among the hyper-edges of one triangle, which count alike, one scale takes weights to distances
    gap = np.linalg.norm(turns(points.source[i]) - turns(points.target[j]), axis=1)
    _, triangle, count = np.unique(np.sort(i, axis=1), axis=0, return_inverse=True, return_counts=True)
    mean_gap, mean_log = (np.bincount(triangle, of) / count for of in (gap, np.log(tensor.weights)))
    scale = -np.sum((gap - mean_gap[triangle]) ** 2) / np.sum(
        (gap - mean_gap[triangle]) * (np.log(tensor.weights) - mean_log[triangle])
    )
    # what is left is how often a triangle was drawn
    times = tensor.weights * np.exp(gap / scale)
    np.testing.assert_allclose(times, np.round(times), rtol=1e-6)
    assert np.bincount(triangle, np.round(times)) @ (1 / count) == pytest.approx(n * n_target)
    assert scale == pytest.approx(np.average(gap, weights=np.round(times)), rel=1e-6)
    # true hyper-edges are heavier
    true = (points.truth[i] == j).all(axis=1)
    assert tensor.weights[true].mean() > 1.3 * tensor.weights.mean()


def test_a_mirrored_target_is_not_alike() -> None:
    """The published codes' sines have a sign; without it this would match as well."""
    points = instance(Setting(DEFORMATION, 0, 0.0), 0)
    mirrored = Instance(points.source, points.target * (-1.0, 1.0), points.truth)
    scores = [protocol_tensor(p, 0).score(points.truth) for p in (points, mirrored)]
    assert scores[1] < 0.05 * scores[0]


def test_instances_are_shuffled_and_near_the_truth() -> None:
    points = instance(Setting(OUTLIERS, 30, 0.01), 5)
    assert np.abs(points.target[points.truth] - points.source).max() < 0.05
    assert not np.array_equal(points.truth, np.arange(10))
    again = instance(Setting(OUTLIERS, 30, 0.01), 5)
    np.testing.assert_array_equal(points.target, again.target)


def test_what_is_published_is_among_the_settings() -> None:
    levels = {(s.problem, s.noise if s.problem == DEFORMATION else s.outliers) for c in SETTINGS.values() for s in c}
    assert set(ACCURACY) <= levels
    assert len(SETTINGS[DEFORMATION]) == 9


def test_small_sweep_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(protocols, "TIMED_INSTANCES", 1)
    monkeypatch.setattr(protocols, "TIMED_REPEATS", 1)
    files = protocols.reproduce(tmp_path, instances=2, jobs=1, settings=SMALL)
    assert [path.name for path in files] == ["hypergraph.md", "hypergraph.csv", "hypergraph.png", "hypergraph.svg"]
    table = (tmp_path / "hypergraph.csv").read_text()
    rows = list(csv.DictReader(table.splitlines()))
    assert len(rows) == 2 * len(protocols.SOLVERS)
    assert {row["instances"] for row in rows} == {"2"}
    found = {(row["protocol"], row["solver"]): float(row["accuracy"]) for row in rows}
    for solver in ("ascent", "rrwhm-published", "rrwhm", "rrwhm-soft", "bcagm", "power-l1"):
        assert found[DEFORMATION, solver] >= 0.85
        assert found[OUTLIERS, solver] >= 0.95
    text = (tmp_path / "hypergraph.md").read_text()
    assert "| 20 | " in text
    assert "(1.00)" in text

    done = []
    whole = protocols.evaluate

    def watched(unit):  # type: ignore[no-untyped-def]
        done.append(unit.seed)
        return whole(unit)

    monkeypatch.setattr(protocols, "evaluate", watched)
    monkeypatch.setattr(protocols, "milliseconds", lambda: dict.fromkeys(protocols.SOLVERS, 1.0))
    monkeypatch.setattr(report, "draw", lambda _: Figure(figsize=(2.0, 1.5)))
    protocols.reproduce(tmp_path, instances=2, jobs=1, settings=SMALL)
    assert done == []
    assert (tmp_path / "hypergraph.csv").read_text() == table
    protocols.reproduce(tmp_path, instances=3, jobs=1, settings=SMALL)
    assert done == [2, 2]


def test_the_same_seed_gives_the_same_rows() -> None:
    unit = Unit(1, (Task(setting := SMALL[OUTLIERS][0], protocols.make_plan(SMALL)[setting]),))
    assert protocols.evaluate(unit) == protocols.evaluate(unit)


def test_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = {}

    def work(output, **options):  # type: ignore[no-untyped-def]
        asked.update(options, output=output)
        return (output / "hypergraph.md",)

    monkeypatch.setattr(protocols, "reproduce", work)
    done = CliRunner().invoke(app, ["reproduce", "hypergraph", "--output", "x", "--instances", "3", "--quiet"])
    assert done.exit_code == 0, done.output
    assert done.stdout == "x/hypergraph.md\n"
    with asked.pop("progress")("scenes") as show:
        assert show is None
    assert asked == {
        "output": Path("x"),
        "instances": 3,
        "seed": 0,
        "jobs": -1,
        "scheduler": None,
    }


@pytest.mark.parametrize("change", [{"instances": 0}, {"seed": -1}, {"jobs": 0}])
def test_bad_counts(change: dict[str, int], tmp_path: Path) -> None:
    with pytest.raises(InputError):
        protocols.reproduce(tmp_path, **change)
    assert list(tmp_path.iterdir()) == []


def test_names_are_those_of_the_library() -> None:
    for name, solver in protocols.SOLVERS.items():
        ours = get_solver(name)
        assert type(ours) is type(solver)
        ignored = {"keep", "iterations"} if name.startswith("power") else {"keep"}
        for field in dataclasses.fields(ours):
            assert field.name in ignored or getattr(ours, field.name) == getattr(solver, field.name)
