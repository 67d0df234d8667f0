"""Tensors that a Dask cluster builds, against one process: the same to the last bit."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from functools import partial
from operator import truediv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import rootmatch as rm
from rootmatch.backends import dask as module
from rootmatch.backends.dask import Cluster
from rootmatch.cli import app
from rootmatch.hypergraph.affinity import affinity
from rootmatch.problems.similarity.problem import Rigid
from rootmatch.samplers.exhaustive import exhaustive_tensor
from rootmatch.samplers.random import random_tensor
from rootmatch.simulation import p3p_scene, up2p_scene
from tiny_sweep import sweep


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    distributed = pytest.importorskip("distributed")
    with pytest.MonkeyPatch.context() as patch:
        # the workers import tiny_sweep from here
        patch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)]))
        workers = distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None)
    with workers:
        yield workers.scheduler_address


def same(one: Any, two: Any, tolerance: float = 0.0) -> None:
    assert one[1] == two[1]
    np.testing.assert_array_equal(one[0].indices, two[0].indices)
    np.testing.assert_allclose(one[0].weights, two[0].weights, rtol=tolerance, atol=0.0)


@pytest.mark.parametrize("limit", [50, 5_000_000])
def test_all_hyperedges(scheduler: str, limit: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """In many pieces, of which the first fill the limit and lower the gate for the others."""
    monkeypatch.setattr(module, "PIECE", 2000)
    scene = p3p_scene(n=6, outliers=1, noise=1.0, seed=3)
    tables = scene.problem.prepare(scene.source, scene.target, 1.0)
    weigh = affinity("joint", gate=20.0)
    kind = weigh.residual.kernel_kind(6)
    workers = Cluster(scheduler, dict)
    told: list[tuple[int, int]] = []
    here = exhaustive_tensor(tables, kind, weigh, (6, 7), 4, max_hyperedges=limit)
    there = exhaustive_tensor(
        tables, kind, weigh, (6, 7), 4, max_hyperedges=limit, backend=workers,
        progress=lambda done, total: told.append((done, total)),
    )  # fmt: skip
    same(here, there)
    assert here[0].size == min(limit, here[0].size)
    assert here[0].size >= 50
    assert len(told) > 5
    assert told[-1][0] == told[-1][1]
    assert told == sorted(told)


def test_random_hyperedges(scheduler: str) -> None:
    scene = up2p_scene(n=6, outliers=2, noise=1.0, seed=3)
    tables = scene.problem.prepare(scene.source, scene.target, 1.0)
    weigh = affinity("normalised", gate=20.0)
    kind = weigh.residual.kernel_kind(3)
    mask = np.random.default_rng(0).random((6, 8)) < 0.9
    arguments = tables, kind, weigh, (6, 8), 3, 200_000, 5
    there = random_tensor(*arguments, candidates=mask, backend=Cluster(scheduler, dict))
    same(random_tensor(*arguments, candidates=mask), there)


@pytest.mark.parametrize("options", [{}, {"preset": "paper"}, {"sampler": "exhaustive", "motions": "auto"}])
def test_whole_match(scheduler: str, options: dict[str, Any]) -> None:
    scene = up2p_scene(n=6, outliers=2, noise=0.5, seed=1)
    here, there = (
        rm.match(scene.source, scene.target, scene.problem, noise=0.5, scheduler=address, **options)
        for address in (None, scheduler)
    )
    same((here.tensor, here.evaluated), (there.tensor, there.evaluated))
    np.testing.assert_array_equal(here.assignment, there.assignment)
    assert here.status is there.status


def test_kernels_that_are_made_when_a_problem_is_used(scheduler: str) -> None:
    """A derived problem's kernels are compiled from text; another's module is not imported with the package.

    Code that was just compiled and code that is found on disk may differ in the last digits here.
    """
    rng = np.random.default_rng(2)
    camera = rm.Camera(800.0, 800.0, 320.0, 240.0)
    pixels = rng.uniform((0.0, 0.0), (640.0, 480.0), (6, 2))
    shifted = pixels + np.array([30.0, 0.0]) + rng.normal(size=pixels.shape)
    points = rng.uniform(-1.0, 1.0, (6, 2))
    for source, target, problem, noise in (
        (points, points[::-1] + np.array([0.5, 0.2]), Rigid(), 0.01),
        (pixels, shifted, rm.PlanarMotion(camera, axis=(0, 1, 0)), 1.0),
    ):
        here, there = (
            rm.match(source, target, problem, noise=noise, sampler="exhaustive", scheduler=address)
            for address in (None, scheduler)
        )
        same((here.tensor, here.evaluated), (there.tensor, there.evaluated), tolerance=1e-12)
        assert here.tensor.size > 0


class TestErrors:
    def match(self, **options: Any) -> None:
        scene = up2p_scene(n=4, seed=1)
        rm.match(scene.source, scene.target, scene.problem, **options)

    def test_guided_search(self, scheduler: str) -> None:
        with pytest.raises(rm.InputError, match=r"one process.*exhaustive"):
            self.match(scheduler=scheduler, sampler="guided")

    @pytest.mark.parametrize("backend", ["cuda", "cuda-float32"])
    def test_card(self, scheduler: str, backend: str) -> None:
        with pytest.raises(rm.InputError, match=rf'CPUs.*leave backend="{backend}"'):
            self.match(scheduler=scheduler, backend=backend)

    def test_nobody_there(self, monkeypatch: pytest.MonkeyPatch) -> None:
        pytest.importorskip("distributed")
        monkeypatch.setattr(module, "CONNECT_SECONDS", 0.3)
        with pytest.raises(rm.InputError, match=r"127\.0\.0\.1:1 does not answer.*dask scheduler"):
            self.match(scheduler="tcp://127.0.0.1:1")

    @pytest.mark.parametrize("scheduler", ["results", "tcp://127.0.0.1", "tcp://127.0.0.1:99999999", "ftp://x"])
    def test_what_is_no_address(self, scheduler: str, monkeypatch: pytest.MonkeyPatch) -> None:
        distributed = pytest.importorskip("distributed")
        # a client that was begun would wait for itself when it is let go
        monkeypatch.setattr(distributed, "Client", None)
        with pytest.raises(rm.InputError, match=f"{scheduler} does not answer"):
            self.match(scheduler=scheduler)

    @pytest.mark.parametrize("scheduler", ["tls://127.0.0.1:1", "tls://"])
    def test_no_certificates(self, scheduler: str) -> None:
        pytest.importorskip("distributed")
        with pytest.raises(rm.InputError, match=f"{scheduler} needs certificates; name them in Dask's configuration"):
            self.match(scheduler=scheduler)

    def test_without_dask(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def absent(name: str) -> Any:
            raise ImportError(name)

        monkeypatch.setattr(module, "import_module", absent)
        with pytest.raises(rm.InputError, match=r"pip install 'rootmatch\[cluster\]'"):
            self.match(scheduler="tcp://127.0.0.1:1")

    def test_a_piece_that_fails(self, scheduler: str) -> None:
        scene = up2p_scene(n=5, seed=1)
        tables = scene.problem.prepare(scene.source, scene.target, 1.0)
        weigh = affinity("joint")
        fails = partial(truediv, 1, 0)
        with pytest.raises(rm.RootmatchError, match=r"a piece failed on a worker.*ZeroDivisionError"):
            exhaustive_tensor(
                tables, weigh.residual.kernel_kind(3), weigh, (5, 5), 3, backend=Cluster(scheduler, fails)
            )


def test_command_line(scheduler: str, tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    files = [str(scene / name) for name in ("model.csv", "image.csv")]
    matched = ["match", *files, "--problem", "up2p", "--camera", str(scene / "camera.json"), "--json"]
    printed = []
    for arguments in (
        ["simulate", "up2p", "--points", "6", "--seed", "1", "--output", str(scene)],
        matched,
        [*matched, "--scheduler", scheduler],
    ):
        result = CliRunner().invoke(app, arguments, catch_exceptions=False)
        assert result.exit_code == 0, result.output
        printed.append(json.loads(result.stdout) | {"seconds": 0} if arguments[0] == "match" else {})
    assert printed[1] == printed[2]
    assert sorted(printed[1]["assignment"]) == list(range(6))


def test_a_sweep_of_the_paper_gives_the_same_rows(scheduler: str, tmp_path: Path) -> None:
    assert sweep(tmp_path / "there.sqlite", scheduler=scheduler) == sweep(tmp_path / "here.sqlite")
