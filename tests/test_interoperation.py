"""The worked example of other libraries' arrays runs, and its claims hold."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

import rootmatch as rm

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "interoperation" / "graphs.py"


def test_the_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    lines = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"imported: \d+ edges from \d+ entries, 100% right", lines[0])
    assert lines[1].endswith("100% right")
    assert re.fullmatch(r"exported: \d+ entries, 100% right by the leading eigenvector", lines[2])
    assert "max_bytes" in lines[3]


def test_pairs_are_indexed_as_said() -> None:
    """K of the example against its definition, entry by entry."""
    names = runpy.run_path(str(EXAMPLE))
    first, second, _ = names["two_graphs"](4, seed=0)
    dense = names["dense_affinity"](first, second[:3, :3])
    a, b = first.toarray(), second.toarray()[:3, :3]
    for i, j in np.ndindex(4, 4):
        for k, m in np.ndindex(3, 3):
            alike = np.exp(-((a[i, j] - b[k, m]) ** 2) / 0.1) if a[i, j] > 0.0 and b[k, m] > 0.0 else 0.0
            assert dense[k * 4 + i, m * 4 + j] == pytest.approx(alike)
    tensor = rm.AffinityTensor.from_dense(dense, (4, 3), layout="column", conflicts="drop")
    for pairs, weight in zip(tensor.indices, tensor.weights, strict=True):
        (i, k), (j, m) = (divmod(int(pair), 3) for pair in pairs)
        assert weight == pytest.approx(np.exp(-((a[i, j] - b[k, m]) ** 2) / 0.1))


def test_the_table_of_the_readme_names_what_there_is() -> None:
    text = EXAMPLE.with_name("README.md").read_text(encoding="utf-8")
    for name in ("from_dense", "to_dense", "from_coo", "to_coo", "from_scipy", "to_scipy"):
        assert name in text
        assert hasattr(rm.AffinityTensor, name)
