"""The CUDA backend on Numba's simulator, against the processor; on a card where there is one (benchmarks/gpu.py)."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rootmatch as rm
from cuda_cases import CASES, LIMITED, SINGLE, SOLVED, case_tables, given_hyperedges, random_tensor
from rootmatch import backends
from rootmatch.backends import cpu, selection
from rootmatch.backends.strongest import Enumeration, Strongest
from rootmatch.hypergraph.affinity import affinity
from rootmatch.samplers.exhaustive import exhaustive_tensor
from rootmatch.samplers.random import random_tensor as sampled_tensor
from rootmatch.simulation import three_plus_one_scene, up2p_scene
from rootmatch.solvers import PowerIteration

FOLDER = Path(__file__).parent
SHARP = 1e-9
"""Relative difference between a kernel here and there."""


def moved_by_rounding(tables: Any, seed: int) -> Any:
    """The tables with every number changed by a rounding error or two."""
    rng = np.random.default_rng(seed)
    return type(tables)(
        *(a * (1.0 + 4e-16 * rng.uniform(-1.0, 1.0, a.shape)) if a.dtype == np.float64 else a for a in tables)
    )


def check_equal(there: Any, here: Any, others: list[Any], floor: float = 1e-13) -> None:
    """Equal to 1e-9; of the few that rounding of the input moves farther (near double roots), as far as that goes."""
    moved = np.max([np.abs(other - here) for other in others], axis=0)
    difference = np.abs(there - here)
    sharp = difference <= SHARP * np.abs(here) + floor
    assert sharp.mean() > 0.8
    assert np.all(sharp | (difference <= 30.0 * moved))


needs_numba_cuda = pytest.mark.skipif(find_spec("numba_cuda") is None, reason="numba-cuda is not installed")


def run(*arguments: str, **variables: str) -> str:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(FOLDER), *sys.path]), **variables}
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def there(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """What the simulated card found; ROOTMATCH_CUDA_RESULTS names a file of a real one's."""
    path = os.environ.get("ROOTMATCH_CUDA_RESULTS")
    if path is None:
        path = str(tmp_path_factory.mktemp("cuda") / "results.npz")
        run(str(FOLDER / "cuda_results.py"), path, NUMBA_ENABLE_CUDASIM="1", NUMBA_DISABLE_JIT="1")
    with np.load(path) as archive:
        return dict(archive)


@needs_numba_cuda
class TestKernels:
    @pytest.mark.parametrize("name", list(CASES))
    def test_residuals_of_given_hyperedges(self, name: str, there: Any) -> None:
        case = CASES[name]
        tables, kind, edges = case_tables(case), case.kind(case.pairs), given_hyperedges(case)
        here = cpu.residuals(tables, kind, *edges)
        others = [cpu.residuals(moved_by_rounding(tables, seed), kind, *edges) for seed in range(8)]
        check_equal(there[f"{name} given"], here, others)
        assert np.ptp(here) > 0.0

    @pytest.mark.parametrize("name", list(CASES))
    def test_sweep_finds_the_same_in_the_same_order(self, name: str, there: Any) -> None:
        case = CASES[name]
        work = Enumeration.of(case_tables(case), case.kind(case.pairs), case.shape, case.order, case.mask())
        here = cpu.strongest(work, *case.ranks(work), case.gate, case.limit)
        codes, at, of = np.intersect1d(there[f"{name} codes"], here.codes, return_indices=True)
        # of equal residuals at the limit, rounding chooses
        assert len(there[f"{name} codes"]) == len(here.codes)
        assert np.all(np.diff(there[f"{name} codes"]) > 0)
        assert np.all(np.delete(here.residuals, of) >= (1.0 - SHARP) * here.residuals.max())
        assert len(codes) > 0.9 * len(here.codes)
        others = []
        for seed in range(8):
            moved = replace(work, tables=moved_by_rounding(work.tables, seed))
            found = cpu.strongest(moved, *case.ranks(work), case.gate, 10**6)
            others.append(found.residuals[np.searchsorted(found.codes, codes)])
        check_equal(there[f"{name} residuals"][at], here.residuals[of], others)
        assert there[f"{name} evaluated"] == here.evaluated
        assert len(here.codes) >= 10

    @pytest.mark.parametrize("name", list(LIMITED))
    def test_whole_tensors(self, name: str, there: Any) -> None:
        """In launches of 200 hyper-edges with room for 8 at first, so that room is made and the gate sinks."""
        case, limit = LIMITED[name]
        weigh = affinity("joint", gate=case.gate)
        kind = case.kind(case.pairs)
        tensor, evaluated = exhaustive_tensor(
            case_tables(case), kind, weigh, case.shape, case.order, max_hyperedges=limit
        )
        assert tensor.size == limit or limit == 10**6
        np.testing.assert_array_equal(there[f"{name} indices"], tensor.indices)
        np.testing.assert_allclose(there[f"{name} weights"], tensor.weights, rtol=SHARP)
        assert there[f"{name} evaluated"] == evaluated
        drawn, _ = sampled_tensor(case_tables(case), kind, weigh, case.shape, case.order, 150, 3)
        np.testing.assert_array_equal(there[f"{name} drawn indices"], drawn.indices)
        np.testing.assert_allclose(there[f"{name} drawn weights"], drawn.weights, rtol=SHARP)


@needs_numba_cuda
@pytest.mark.parametrize("name", list(SINGLE))
def test_screened_in_single_precision(name: str, there: Any) -> None:
    """The same hyper-edges but for some at the gate, with the residuals of double precision."""
    case = SINGLE[name]
    work = Enumeration.of(case_tables(case), case.kind(case.pairs), case.shape, case.order, case.mask())
    here = cpu.strongest(work, *case.ranks(work), case.gate, case.limit)
    codes, at, of = np.intersect1d(there[f"{name} screened codes"], here.codes, return_indices=True)
    assert np.array_equal(codes, there[f"{name} screened codes"])
    assert np.all(np.delete(here.residuals, of) > 0.99 * case.gate)
    assert len(codes) >= 10
    others = [
        cpu.strongest(
            replace(work, tables=moved_by_rounding(work.tables, seed)), *case.ranks(work), case.gate, case.limit
        ).residuals[of]
        for seed in range(8)
    ]
    check_equal(there[f"{name} screened residuals"][at], here.residuals[of], others)
    assert there[f"{name} screened evaluated"] == here.evaluated


@needs_numba_cuda
@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_contraction(order: int, there: Any) -> None:
    tensor, x = random_tensor(order)
    np.testing.assert_allclose(there[f"contraction {order}"], tensor.contract(x), rtol=1e-12)


@needs_numba_cuda
def test_solver_on_a_tensor_on_the_card(there: Any) -> None:
    tensor, _ = random_tensor(3)
    np.testing.assert_allclose(there["power"], PowerIteration(iterations=2)(tensor).soft, rtol=1e-9, atol=1e-12)


@needs_numba_cuda
@pytest.mark.parametrize("backend", ["cuda", "cuda-float32"])
def test_whole_match(backend: str, there: Any) -> None:
    scene = up2p_scene(**SOLVED)
    here = rm.match(scene.source, scene.target, scene.problem, noise=scene.noise, backend="cpu")
    np.testing.assert_array_equal(there[f"{backend} assignment"], here.assignment)
    np.testing.assert_array_equal(there[f"{backend} indices"], here.tensor.indices)
    np.testing.assert_allclose(there[f"{backend} weights"], here.tensor.weights, rtol=SHARP)
    assert there[f"{backend} evaluated"] == here.evaluated
    assert (here.assignment == scene.truth).all()


class TestChoice:
    def test_without_numba_cuda(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(selection, "find_spec", lambda name: None)
        scene = up2p_scene(**SOLVED)
        with pytest.raises(rm.InputError, match=r"numba-cuda.*not installed.*rootmatch\[gpu\]"):
            rm.match(scene.source, scene.target, scene.problem, backend="cuda")
        assert selection.choose_backend("auto", 1e12) is cpu

    @needs_numba_cuda
    def test_without_a_card(self) -> None:
        """In a process that sees no card, whatever this machine has; it is not looked for before it is needed."""
        code = (
            "import sys\n"
            "import rootmatch as rm\n"
            "assert not [name for name in sys.modules if name.startswith(('numba_cuda', 'numba.cuda.'))]\n"
            "from rootmatch.backends import cpu, selection\n"
            "from rootmatch.simulation import up2p_scene\n"
            f"scene = up2p_scene(**{SOLVED!r})\n"
            "assert selection.choose_backend('auto', 1e12) is cpu\n"
            "try:\n"
            "    rm.match(scene.source, scene.target, scene.problem, backend='cuda')\n"
            "except rm.InputError as error:\n"
            "    print(error)\n"
        )
        said = run("-c", code, CUDA_VISIBLE_DEVICES="", NUMBA_ENABLE_CUDASIM="0")
        assert "finds no GPU" in said
        assert "()" not in said
        assert said.count("\n") == 1

    @needs_numba_cuda
    def test_numba_cuda_that_does_not_work_with_this_numpy(self) -> None:
        code = (
            "import sys\n"
            "import rootmatch as rm\n"
            "from rootmatch.jit.cuda import register_kernels\n"
            "sys.modules['numba.cuda.cudaimpl'] = None\n"
            "try:\n"
            "    register_kernels()\n"
            "except rm.InputError as error:\n"
            "    print(error)\n"
        )
        said = run("-c", code, NUMBA_ENABLE_CUDASIM="0")
        assert "another version of numba-cuda or NumPy" in said
        assert f"NumPy {np.__version__}" in said

    @needs_numba_cuda
    @pytest.mark.skipif("ROOTMATCH_CUDA_RESULTS" in os.environ, reason="a real card's results")
    def test_a_simulated_card_is_never_preferred(self, there: Any) -> None:
        assert there["auto is the processor"]

    @pytest.mark.parametrize(
        ("scene", "residual"), [(three_plus_one_scene(**SOLVED), "joint"), (up2p_scene(**SOLVED), "qr")]
    )
    def test_single_precision_only_where_the_ranking_survives(self, scene: Any, residual: str) -> None:
        """Said before a card is looked for."""
        with pytest.raises(rm.InputError, match=r"ranking.*single precision; use backend=\"cuda\""):
            rm.match(scene.source, scene.target, scene.problem, residual=residual, backend="cuda-float32")

    @pytest.mark.parametrize("slow", [False, True])
    def test_auto_screens_on_cards_slow_in_double(self, slow: bool, monkeypatch: pytest.MonkeyPatch) -> None:
        double, single = SimpleNamespace(SIMULATED=False), SimpleNamespace(pays=lambda: slow)
        monkeypatch.setattr(selection, "device_backend", lambda: double)
        monkeypatch.setattr(backends, "cuda_float32", single, raising=False)
        assert selection.choose_backend("auto", 1e12, True) is (single if slow else double)
        assert selection.choose_backend("auto", 1e12, False) is double
        assert selection.choose_backend("cuda", 1e12, True) is double
        assert selection.choose_backend("cuda-float32", 1e12, True) is single
        assert selection.choose_backend("auto", selection.PAYS - 1, True) is cpu

    def test_few_hyperedges_stay_on_the_processor(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(selection, "device_backend", lambda: pytest.fail("asked for a card"))
        assert selection.choose_backend("auto", selection.PAYS - 1) is cpu


@pytest.mark.parametrize("limit", [1, 7, 100, 5000])
@pytest.mark.parametrize("parts", [1, 3, 40])
def test_strongest_do_not_depend_on_the_order_they_come_in(limit: int, parts: int) -> None:
    rng = np.random.default_rng(limit + parts)
    residuals = rng.integers(0, 50, 1000) / 10.0  # many ties
    best = np.sort(np.lexsort((np.arange(1000), residuals))[:limit])
    kept = Strongest(limit, np.inf)
    for part in np.array_split(rng.permutation(1000), parts):
        passing = part[residuals[part] <= kept.gate]
        kept.add(passing.astype(np.int64), residuals[passing])
    codes, values = kept.settle()
    np.testing.assert_array_equal(codes, best)
    np.testing.assert_array_equal(values, residuals[best])


@needs_numba_cuda
def test_the_benchmark_runs_on_a_simulated_card(tmp_path: Path) -> None:
    sizes = ("--quick", "--no-tests", "--kinds", "joint", "--output", str(tmp_path))
    script = FOLDER.parent / "benchmarks" / "gpu.py"
    code = "import runpy, sys, cuda_results; cuda_results.wait_for_threads(); sys.argv = sys.argv[1:]\n"
    code += "runpy.run_path(sys.argv[0], run_name='__main__')"
    run("-W", "ignore", "-c", code, str(script), *sizes, NUMBA_ENABLE_CUDASIM="1", NUMBA_DISABLE_JIT="1")
    assert "| p3p | `joint` | float64 | 5 × 6 |" in (tmp_path / "cuda.md").read_text(encoding="utf-8")
