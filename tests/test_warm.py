"""The kernels that are compiled ahead are those that a solution needs."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rootmatch.cli.cold import LATE

SOLVE = """
import sys
import numpy as np
from rootmatch.solvers.warm import is_cold
assert not is_cold()
import pkgutil
from importlib import import_module
from rootmatch import AffinityTensor
from rootmatch.hypergraph import contraction
from rootmatch.solvers import ascent
rng = np.random.default_rng(1)
order = int(sys.argv[1])
edges = [rng.permutation(9)[:order] * 8 + rng.permutation(8)[:order] for _ in range(3000)]
tensor = AffinityTensor(edges, rng.random(3000), (9, 8), rng.random((9, 8)))
from rootmatch.solvers import get_solver
solution = get_solver("ascent")(tensor)
assert abs(solution.score - tensor.score(solution.assignment)) < 1e-9
hits = 0
parts = [import_module(f"{ascent.__name__}.{part.name}") for part in pkgutil.iter_modules(ascent.__path__)]
for module in (contraction, *parts):
    for name, value in vars(module).items():
        if hasattr(value, "stats") and value.py_func.__module__ == module.__name__ and name != "_first_fault":
            assert not value.stats.cache_misses, name
            hits += sum(value.stats.cache_hits.values())
assert hits >= 7
"""


def test_a_solution_finds_all_its_kernels_after_warming(tmp_path: Path) -> None:
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    for program in ([LATE, "4", "solver"], [LATE, "3", "solver"], [SOLVE, "4"], [SOLVE, "3"]):
        done = subprocess.run([sys.executable, "-c", *program], env=env, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


SEARCH = """
import rootmatch as rm
from rootmatch.samplers.guided import hypothesis_clustering as clustering
from rootmatch.simulation import p3p_scene, up2p_scene
make = {"p3p": p3p_scene, "up2p": up2p_scene}[PROBLEM]
scene = make(12, 8, 1.0, 1)
normals = scene.source if NORMALS else None
rm.match(scene.source, scene.target, scene.problem, noise=1.0, hyperedges="guided", normals=normals)
for kernel in (clustering._cluster, clustering.candidate_hyperedges):
    assert sum(kernel.stats.cache_hits.values()) == 1
    assert not kernel.stats.cache_misses
"""


@pytest.mark.parametrize(("problem", "normals"), [("p3p", True), ("up2p", False)])
def test_a_search_finds_its_kernels_after_warming(tmp_path: Path, problem: str, normals: bool) -> None:
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    search = SEARCH.replace("PROBLEM", repr(problem)).replace("NORMALS", repr(normals))
    for program in ([LATE, "4", "search"], [search]):
        done = subprocess.run([sys.executable, "-c", *program], env=env, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


PACKED = """
import rootmatch as rm
from rootmatch.simulation import up2p_scene
from rootmatch.solvers.packing.branch_and_bound import search
from rootmatch.solvers.packing.tabu_search import pack
from rootmatch.solvers.warm import is_cold
assert not is_cold(several=True)
scene = up2p_scene(10, 4, 0.5, 1, motions=2)
rm.match(scene.source, scene.target, scene.problem, noise=0.5, motions=2)
for kernel in (pack, search):
    assert sum(kernel.stats.cache_hits.values()) == 1
    assert not kernel.stats.cache_misses
"""


def test_a_packing_finds_its_kernels_after_warming(tmp_path: Path) -> None:
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    for program in ([LATE, "4", "groups"], [PACKED]):
        done = subprocess.run([sys.executable, "-c", *program], env=env, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


def test_an_empty_cache_is_cold(tmp_path: Path) -> None:
    program = "from rootmatch.solvers.warm import is_cold; assert is_cold() and is_cold(several=True)"
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    assert subprocess.run([sys.executable, "-c", program], env=env, check=False).returncode == 0
