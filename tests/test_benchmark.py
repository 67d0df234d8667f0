"""The command that measures: that everything in it runs and what it counts is right; no time is judged."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from typing import NamedTuple

import pytest
from typer.testing import CliRunner, Result

from rootmatch.cli.app import app
from rootmatch.research import speed as benchmark
from rootmatch.research.speed import Plan, Results, run
from rootmatch.research.speed.operation_count import Counted, operations


def test_counted_numbers_compute_as_floats_and_stay_counted() -> None:
    a, b = Counted(3.0), Counted(4.0)
    values = {
        a + b: 7.0,
        a - b: -1.0,
        1.0 - a: -2.0,
        2.0 * a * b: 24.0,
        a / b: 0.75,
        1 / b: 0.25,
        -a: -3.0,
        abs(-a): 3.0,
    }
    assert all(found == wanted and type(found) is Counted for found, wanted in values.items())
    assert a / Counted(0.0) == float("inf")
    assert Counted(0.0) / 0.0 != 0.0


def test_operations_of_a_hyperedge() -> None:
    """A closed form for quartics costs more than one for quadratics; what is shared by many images costs little."""
    cases = [("p3p", "qr", 5, 2), ("up2p", "qr", 5, 2), ("p3p", "joint", 5, 2), ("p3p", "joint", 12, 8)]
    quartic, quadratic, small, large = operations(cases, 2)
    # by hand 45 for the closed form of two quadratics and 20 for the coefficients, and a part for nothing at n = 7
    assert 40 < quadratic < 120
    assert 2 * quadratic < quartic < 900
    assert large < small / 2


class Measured(NamedTuple):
    """All measurements of the least sizes as the command makes them, how far they said to be, and what it printed."""

    plan: Plan
    results: Results
    seen: list[tuple[int, int]]
    printed: Result


@pytest.fixture(scope="module")
def measured() -> Measured:
    made: list[tuple[Plan, Results]] = []
    seen: list[tuple[int, int]] = []

    def noted(plan: Plan, progress: Callable[[int, int], object]) -> Results:
        made.append((plan, run(plan, lambda *far: (seen.append(far), progress(*far)))))
        return made[-1][1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(benchmark, "run", noted)
        printed = CliRunner().invoke(app, ["benchmark", "--tiny", "--json"])
    assert printed.exit_code == 0, printed.output
    return Measured(*made[-1], seen, printed)


def test_run_of_the_least_sizes(measured: Measured) -> None:
    plan, results, seen, _ = measured
    assert plan == Plan.tiny()
    assert seen == [(k + 1, plan.steps) for k in range(plan.steps)]
    assert [(row["problem"], row["kind"]) for row in results.kernels] == [("p3p", "joint"), ("up2p", "joint")]
    # C(5, 4) · 6·5·4·3 and C(5, 3) · 6·5·4
    assert [row["hyperedges"] for row in results.kernels] == [1800, 1200]
    for row in results.kernels:
        assert row["ratio"] == pytest.approx(row["per_second"] / row["qr_per_second"])
        assert row["share_of_peak"] == pytest.approx(row["per_second"] * row["operations"] / results.peak_operations)
    assert results.memory["hyperedges"] == 5 * 8 * 7 * 6 * 5
    assert results.memory["bytes_each"] <= 40.0
    assert results.contraction["hyperedges"] == 2000
    assert {row["case"] for row in results.matches} == {"p3p 5 + 3, tracked", "up2p 6 + 2"}


def test_the_command_prints_one_json_object_or_tables(measured: Measured, monkeypatch: pytest.MonkeyPatch) -> None:
    found = json.loads(measured.printed.stdout)
    assert "ratios" in found["note"].lower()
    assert len(found["kernels"]) == 2
    assert "100 %" in measured.printed.stderr
    monkeypatch.setattr(benchmark, "run", lambda plan, progress: measured.results)
    done = CliRunner().invoke(app, ["benchmark", "--tiny", "--quiet"])
    assert "numpy.linalg.qr" in done.stdout
    assert "peak memory" in done.stdout
    assert done.stderr == ""


@pytest.mark.skipif(sys.platform == "win32", reason="the system does not report it")
def test_peak_memory_rises_by_what_is_filled_and_does_not_fall() -> None:
    program = """if True:
        import numpy as np
        from rootmatch.research.speed.run import peak_megabytes
        before = peak_megabytes()
        block = np.ones((300, 2**17))  # a MiB each
        during = peak_megabytes()
        del block
        print(before, during, peak_megabytes())
    """
    done = subprocess.run([sys.executable, "-c", program], text=True, capture_output=True, check=True)
    before, during, after = map(float, done.stdout.split())
    assert 10.0 < before < during < 1e5
    # what was freed before, or has not been given back, may be used again
    assert 200.0 < during - before < 330.0
    assert after == pytest.approx(during, abs=5.0)
