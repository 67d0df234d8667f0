"""Every kernel is compiled for a card down to its machine code, where NVIDIA's compiler is; no card is needed.

``pip install nvidia-cuda-nvcc-cu12 nvidia-cuda-nvrtc-cu12 nvidia-cuda-runtime-cu12`` brings it. What the simulator
cannot tell: whether numba-cuda knows every function, whether anything is left unresolved, and how many registers it
takes.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

SCRIPT = Path(__file__).parent / "cuda_compiled.py"


@pytest.fixture(scope="module")
def compiled() -> list[dict[str, Any]]:
    if find_spec("numba_cuda") is None:
        pytest.skip("numba-cuda is not installed")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(SCRIPT.parent), *sys.path])}
    environment |= {"NUMBA_ENABLE_CUDASIM": "0", "NUMBA_DISABLE_JIT": "0"}
    done = subprocess.run([sys.executable, str(SCRIPT)], capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    found = json.loads(done.stdout)
    if "absent" in found:
        pytest.skip(f"no NVVM: {found['absent']}")
    rows: list[dict[str, Any]] = found["kernels"]
    return rows


def test_every_kernel_compiles_with_nothing_left_unresolved(compiled: list[dict[str, Any]]) -> None:
    assert len(compiled) > 40
    for row in compiled:
        assert row["unresolved"] == [], row


def test_nothing_is_computed_in_the_other_precision(compiled: list[dict[str, Any]]) -> None:
    for row in compiled:
        assert row["double" if row["in_single"] else "single"] == [], row
    swept = [row for row in compiled if row["driver"] == "sweep_kernel"]
    assert sum(row["in_single"] for row in swept) == 4
    for row in swept:
        assert len(row["single" if row["in_single"] else "double"]) > 50, row


def test_registers_do_not_overflow_into_memory(compiled: list[dict[str, Any]]) -> None:
    """What is spilled of the 255 registers is next to nothing, but for singular values, which are large by nature."""
    measured = [row for row in compiled if row["registers"]]
    if not measured:
        pytest.skip("no ptxas")
    for row in measured:
        assert row["spilled"] == 0 or not row["in_single"], row
        assert row["spilled"] <= (600 if row["kind"] == "SVD" else 160), row
