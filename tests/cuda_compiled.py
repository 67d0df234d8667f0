"""Run by test_cuda_compiles.py: compiles the drivers for every kernel and prints what became of them as JSON."""

from __future__ import annotations

import json
import re
import subprocess
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from numba import cuda, typeof, types

CAPABILITY = (9, 0)
COMPUTES = r"\b(?:add|sub|mul|fma|div|sqrt|rcp|rsqrt|abs|neg|min|max|setp|selp|cvt)\.\S*{}\b[^;]*"
"""Instructions on numbers of a type, but for moves, loads and stores."""


def probe(x):  # type: ignore[no-untyped-def]
    x[0] = 1.0


def compiler_missing() -> str | None:
    """Why nothing can be compiled here, if so."""
    try:
        cuda.compile(probe, types.void(types.float64[:]), cc=CAPABILITY, device=False, abi="numba")
    except Exception as error:
        return f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"
    return None


def assembler() -> str | None:
    """NVIDIA's assembler, of the Python package or of a toolkit."""
    import importlib.util
    import shutil

    spec = importlib.util.find_spec("nvidia")
    for folder in (spec.submodule_search_locations or []) if spec else []:
        for path in Path(folder).glob("**/bin/ptxas"):
            return str(path)
    return shutil.which("ptxas")


def measured(ptx: str, ptxas: str | None) -> dict[str, Any]:
    """Registers and bytes spilled, by the assembler."""
    if ptxas is None:
        return {"registers": 0, "spilled": 0}
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "kernel.ptx"
        source.write_text(ptx)
        command = [ptxas, "-v", "-arch=sm_90", str(source), "-o", str(source.with_suffix(".cubin"))]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        return {"registers": 0, "spilled": 0, "refused": done.stderr[-300:]}
    return {
        "registers": max(int(number) for number in re.findall(r"Used (\d+) registers", done.stderr)),
        "spilled": sum(int(number) for number in re.findall(r"(\d+) bytes spill stores", done.stderr)),
    }


def kernels() -> list[dict[str, Any]]:
    import numba.cuda.dispatcher

    # device functions are compiled for the card at hand, and there is none
    numba.cuda.dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=CAPABILITY)
    from cuda_cases import CASES, case_tables
    from rootmatch.backends import cuda as backend
    from rootmatch.backends import cuda_contraction, cuda_float32
    from rootmatch.jit.cuda import register_kernels
    from rootmatch.jit.float32 import round_tables
    from rootmatch.problems.residual_dispatch import has_single

    def array(dimensions: int, dtype: Any = types.float64) -> Any:
        return types.Array(dtype, dimensions, "C")

    i8, i4, flag = types.int64, types.int32, types.boolean
    indices, listed = array(2, i4), array(2, i8)
    wanted = {(case.problem, case.kind): case for case in CASES.values()}
    register_kernels()
    made = []
    ptxas = assembler()

    def add(problem: str, kind: str, driver: Any, arguments: Any, single: bool = False) -> None:
        ptx, _ = cuda.compile(driver, types.void(*arguments), cc=CAPABILITY, device=False, abi="numba")
        made.append(
            {
                "problem": problem, "kind": kind, "driver": driver.__name__, "in_single": single,
                "unresolved": re.findall(r"\.extern \.func[^;]*?(\w+)\s*\(", ptx),
                "single": re.findall(COMPUTES.format("f32"), ptx), "double": re.findall(COMPUTES.format("f64"), ptx),
                **measured(ptx, ptxas),
            }
        )  # fmt: skip

    def add_sweep(problem: str, kind: type, tables: Any, number: Any) -> None:
        typed, single = (typeof(tables), typeof(kind(1))), number is types.float32
        rows, found = array(3, number), (array(1, i8), array(1, number), array(1, i8))
        add(problem, kind.__name__, backend.panel_kernel, (*typed, listed, indices, i8, rows), single)
        add(
            problem, kind.__name__, backend.sweep_kernel,
            (*typed, listed, i8, i8, indices, number, flag, array(2, flag), i8, i8, rows, rows, *found), single,
        )  # fmt: skip

    for (problem, kind), case in wanted.items():
        tables = case_tables(case)
        typed = typeof(tables), typeof(kind(1))
        add(problem, kind.__name__, backend.evaluate_kernel, (*typed, indices, indices, array(1)))
        add_sweep(problem, kind, tables, types.float64)
        if has_single(tables, kind(1)):
            add_sweep(problem, kind, round_tables(tables), types.float32)
            numbered = array(1, i8), array(1)
            add(problem, kind.__name__, cuda_float32.exact_kernel, (*typed, listed, indices, i8, i8, *numbered))
    contracted = indices, array(1), array(1), array(1, i8), array(1, i4), array(1)
    add("", "", cuda_contraction.contract_kernel, contracted)
    return made


if __name__ == "__main__":
    missing = compiler_missing()
    print(json.dumps({"absent": missing} if missing else {"kernels": kernels()}))
