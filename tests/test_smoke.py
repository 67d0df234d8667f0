"""A match of each problem, one derived, and every solver, in a minute: what the oldest versions declared must do.

``make smoke-oldest`` runs this file in an environment that has nothing newer than `pyproject.toml` asks for.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

import rootmatch as rm
from rootmatch.cli import app
from rootmatch.simulation import Scene, p3p_scene, three_plus_one_scene, up2p_scene
from rootmatch.solvers import SOLVERS, get_solver

CAMERA = rm.Camera(1000.0, 1000.0, 320.0, 240.0)
Case = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], rm.Problem, float]


def test_no_inside_of_numba_is_missing() -> None:
    program = [sys.executable, "-W", "error::RuntimeWarning", "-c", "import rootmatch.api"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def simulated(make: Callable[..., Scene], n: int, **more: float) -> Case:
    scene = make(n, noise=0.1, seed=1, **more)
    return scene.source, scene.target, scene.truth, scene.problem, 0.1


def planar() -> Case:
    """Two views from a cart that turns by 0.3 and drives forward."""
    rng = np.random.default_rng(1)
    points = rng.uniform((-3.0, -2.0, 6.0), (3.0, 2.0, 14.0), (7, 3))
    c, s = np.cos(0.3), np.sin(0.3)
    moved = points @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).T + (-2.0, 0.0, 1.0)
    return shuffled(rng, CAMERA.project(points), CAMERA.project(moved), rm.PlanarMotion(CAMERA, axis=(0, 1, 0)), 0.1)


def upright() -> Case:
    """A view with known vertical and unknown focal length."""
    rng = np.random.default_rng(2)
    points = rng.uniform(-2.0, 2.0, (7, 3))
    c, s = np.cos(0.7), np.sin(0.7)
    seen = points @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).T + (0.3, -0.2, 9.0)
    return shuffled(rng, points, CAMERA.project(seen), rm.UP2PF((320.0, 240.0), (0, 1, 0), (0, 1, 0)), 0.1)


def moved(dimension: int, scale: float, problem: rm.Problem) -> Case:
    """A point set and its scaled copy."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-1.0, 1.0, (9, dimension))
    turn = np.linalg.qr(rng.normal(size=(dimension, dimension)))[0]
    turn[0] *= np.linalg.det(turn)
    return shuffled(rng, points, scale * points @ turn.T + 0.5, problem, 0.001)


def shuffled(
    rng: np.random.Generator,
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    problem: rm.Problem,
    sigma: float,
) -> Case:
    place = rng.permutation(len(target))
    return source, (target + sigma * rng.normal(size=target.shape))[place], np.argsort(place), problem, sigma


def stated() -> rm.Problem:
    """Planar motion from its equation."""
    sp = pytest.importorskip("sympy")
    x, tx, tz = sp.symbols("x tx tz")
    turn = sp.Matrix([[1 - x**2, 0, 2 * x], [0, 1 + x**2, 0], [-2 * x, 0, 1 - x**2]])
    move = sp.Matrix([tx, 0, tz])
    rays = rm.Bearings(CAMERA)
    return rm.derive(
        "smoke", each=lambda p, q: q.dot(move.cross(turn * p)), minimal=2, shared=x, eliminate=[tx, tz],
        source=rays, target=rays,
    )  # fmt: skip


CASES: dict[str, Callable[[], Case]] = {
    "p3p": lambda: simulated(p3p_scene, 7),
    "up2p": lambda: simulated(up2p_scene, 7),
    "3p1": lambda: simulated(three_plus_one_scene, 7, baseline=5.0),
    "planar": planar,
    "up2pf": upright,
    "similarity": lambda: moved(2, 2.5, rm.Similarity(2)),
    "rigid": lambda: moved(3, 1.0, rm.Rigid(3)),
}


@pytest.mark.parametrize("name", CASES)
def test_each_problem_matches(name: str) -> None:
    source, target, truth, problem, sigma = CASES[name]()
    assert rm.match(source, target, problem, noise=sigma).assignment.tolist() == truth.tolist()


def test_a_guided_search_matches() -> None:
    source, target, truth, problem, sigma = simulated(up2p_scene, 10)
    match = rm.match(source, target, problem, noise=sigma, sampler="guided", seed=1)
    assert match.assignment.tolist() == truth.tolist()


def test_a_derived_problem_matches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROOTMATCH_CACHE_DIR", str(tmp_path))
    source, target, truth, _, sigma = planar()
    assert rm.match(source, target, stated(), noise=sigma).assignment.tolist() == truth.tolist()


@pytest.mark.parametrize("name", SOLVERS)
def test_each_solver_solves(name: str) -> None:
    source, target, truth, problem, sigma = simulated(up2p_scene, 7)
    tensor = rm.match(source, target, problem, noise=sigma).tensor
    assert get_solver(name)(tensor, seed=1).assignment.tolist() == truth.tolist()


def test_the_commands_match(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}

    def rootmatch(*arguments: str) -> str:
        done = CliRunner().invoke(app, arguments)
        assert done.exit_code == 0, done.output
        return done.stdout

    assert "--noise" in rootmatch("match", "--help")
    made = str(tmp_path / "made")
    rootmatch("simulate", "up2p", "--points", "7", "--noise", "0.1", "--seed", "1", "--output", made)
    command = [
        sys.executable, "-m", "rootmatch", "match", "made/model.csv", "made/image.csv", "--problem", "up2p",
        "--camera", "made/camera.json", "--noise", "0.1", "--plot", "out.png", "--json",
    ]  # fmt: skip
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr + done.stdout
    assert json.loads(done.stdout)
    assert (tmp_path / "out.png").stat().st_size > 1000
