"""All measurements on an NVIDIA GPU, in one command: ``python benchmarks/gpu.py --output DIR``.

Runs the tests of the CUDA backend on the GPU, checks whole tensors against the CPU's, and measures
hyper-edges/s of every kernel in float64, and screened in float32 where there is a kernel, the share of the GPU's peak,
all hyper-edges of 30 against 30 points in both, from how many hyper-edges on it is quicker than the CPU, and the
contraction. DIR/cuda.json has the figures, DIR/cuda.md the
tables for docs/notebook/performance.md.

``--quick`` uses the smallest sizes: with ``NUMBA_ENABLE_CUDASIM=1 NUMBA_DISABLE_JIT=1`` the command itself can be tried
without a GPU.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import cuda as numba_cuda

import rootmatch
from rootmatch.backends import cpu, cuda, cuda_float32
from rootmatch.backends.cuda_contraction import DeviceTensor
from rootmatch.backends.strongest import Enumeration
from rootmatch.hypergraph.affinity import NOISE_KINDS, Residual, affinity
from rootmatch.hypergraph.enumeration import exhaustive_count, farthest_point_order
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems.residual_dispatch import has_single
from rootmatch.research.speed.timing import seconds
from rootmatch.samplers.exhaustive import exhaustive_tensor
from rootmatch.simulation import SCENES

ROOT = Path(__file__).resolve().parents[1]
KINDS = ("joint", "normalised", "qr", "qr-both", "svd")
SIZES = {"p3p": (20, 10), "up2p": (40, 10), "3p1": (20, 10)}
MINIMUM = {"p3p": (5, 1), "up2p": (5, 1), "3p1": (5, 1)}
PRECISIONS = {"float64": cuda, "float32": cuda_float32}
SINGLES_A_CLOCK = {(6, 0): 64, (7, 0): 64, (7, 2): 64, (7, 5): 64, (8, 0): 64}
"""Fused multiply-adds in float32 per multiprocessor and clock, by compute capability; 128 on the others."""
PANELS = 8
"""Random panels of slabs whose operations are counted."""
REACH = {"normalised": 5e9, "exhaustive": 5.0}
"""Goals: P3P hyper-edges/s, and seconds for 30 against 30."""


def card() -> dict[str, Any]:
    """Name, versions and peak of the GPU."""
    made: dict[str, Any] = {
        "date": datetime.date.today().isoformat(),
        "rootmatch": rootmatch.__version__,
        "numba_cuda": getattr(numba_cuda, "__version__", "") or version("numba-cuda"),
        "simulated": cuda.SIMULATED,
    }
    if cuda.SIMULATED:
        return made | {"name": "Numba's simulator", "peak": {}}
    device = numba_cuda.get_current_device()
    name = device.name.decode() if isinstance(device.name, bytes) else str(device.name)
    capability = tuple(device.compute_capability)
    multiprocessors, clock = int(device.MULTIPROCESSOR_COUNT), 1e3 * device.CLOCK_RATE
    a_clock = {
        "float64": cuda_float32.DOUBLES_A_CLOCK.get(capability, 2), "float32": SINGLES_A_CLOCK.get(capability, 128)
    }  # fmt: skip
    peak = {precision: 2.0 * fused * multiprocessors * clock for precision, fused in a_clock.items()}
    return made | {
        "name": name, "compute_capability": capability, "multiprocessors": multiprocessors, "clock_hz": clock,
        "peak": peak,
    }  # fmt: skip


def tests(folder: Path) -> str:
    """Run the tests of the CUDA backend on the GPU; returns the last line of pytest."""
    results = folder / "cuda-results.npz"
    paths = os.pathsep.join([str(ROOT / "tests"), str(ROOT / "src"), *sys.path])
    environment = {**os.environ, "PYTHONPATH": paths, "ROOTMATCH_CUDA_RESULTS": str(results)}
    subprocess.run(
        [sys.executable, "-W", "ignore", str(ROOT / "tests" / "cuda_results.py"), str(results)],
        env=environment, check=True,
    )  # fmt: skip
    # the GPU's results are in the file; the other side is the CPU, compiled
    here = {**environment, "NUMBA_ENABLE_CUDASIM": "0", "NUMBA_DISABLE_JIT": "0"}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", str(ROOT / "tests" / "test_cuda.py")],
        env=here, check=False, capture_output=True, text=True, cwd=ROOT,
    )  # fmt: skip
    if done.returncode:
        print(done.stdout[-5000:], file=sys.stderr)
    return done.stdout.strip().splitlines()[-1]


def enumeration(problem: str, kind: str, points: int, outliers: int) -> tuple[Enumeration, Any]:
    scene = SCENES[problem](n=points, outliers=outliers, noise=1.0, seed=0)
    tables = scene.problem.prepare(scene.source[farthest_point_order(scene.source)], scene.target, 1.0)
    weigh = affinity(Residual(kind), None if kind in NOISE_KINDS else scene.problem.paper_rho)
    shape = (len(scene.source), len(scene.target))
    residual = weigh.residual.kernel_kind(scene.problem.pair_count)
    return Enumeration.of(tables, residual, shape, scene.problem.order, None), weigh


def precisions(problem: str, kind: str) -> list[str]:
    """The precisions in which the GPU evaluates it."""
    work, _ = enumeration(problem, kind, *MINIMUM[problem])
    return list(PRECISIONS) if has_single(work.tables, work.kind) else ["float64"]


def agreement(problem: str, kind: str, precision: str, points: int, outliers: int) -> dict[str, Any]:
    """Whole tensors of GPU and CPU: hyper-edges in only one of them (at the gate), and the difference of the rest."""
    work, weigh = enumeration(problem, kind, points, outliers)
    tensors = [
        exhaustive_tensor(work.tables, work.kind, weigh, work.shape, work.order, backend=backend)[0]
        for backend in (cpu, PRECISIONS[precision])
    ]
    here, there = ({tuple(row): w for row, w in zip(t.indices.tolist(), t.weights, strict=True)} for t in tensors)
    both = [row for row in here if row in there]
    apart = [abs(here[row] - there[row]) for row in both]
    return {
        "problem": problem, "kind": kind, "precision": precision, "hyperedges": len(here),
        "only_processor": len(here) - len(both), "only_card": len(there) - len(both), "worst": max(apart, default=0.0),
        "beyond_1e-9": float(np.mean(np.array(apart) > 1e-9)) if apart else 0.0,
    }  # fmt: skip


def rate(
    problem: str, kind: str, precision: str, size: tuple[int, int], maximum: float, repeats: int
) -> dict[str, Any]:
    """Hyper-edges per second of a part of an exhaustive sweep, with a gate that almost nothing passes."""
    work, weigh = enumeration(problem, kind, *size)
    gate = 0.3 if kind in NOISE_KINDS else 1e-2 * weigh.rho
    middle = work.ranks // 2
    last = min(work.ranks, middle + max(1, int(maximum) // work.per_slab))
    started = time.perf_counter()
    strongest = PRECISIONS[precision].strongest
    evaluated = strongest(work, middle, last, gate, 100_000).evaluated
    first = time.perf_counter() - started
    spent = seconds(lambda: strongest(work, middle, last, gate, 100_000), repeats)
    return {
        "problem": problem, "kind": kind, "precision": precision, "shape": work.shape, "hyperedges": evaluated,
        "seconds": spent, "per_second": evaluated / spent, "first_call_seconds": first,
    }  # fmt: skip


def operations(rows: list[dict[str, Any]]) -> None:
    """Add to each row the operations per hyper-edge, counted by running the kernel on counting numbers."""
    from rootmatch.research.speed.operation_count import operations as counted

    cases = [(row["problem"], row["kind"], row["shape"][0], row["shape"][1] - row["shape"][0]) for row in rows]
    for row, count in zip(rows, counted(cases, PANELS), strict=True):
        row["operations"] = count


def exhaustive(kind: str, precision: str, points: int) -> dict[str, Any]:
    """The tensor of all hyper-edges of as many source and target points, with the default gate and limit."""
    work, weigh = enumeration("p3p", kind, points, 0)
    started = time.perf_counter()
    tensor, evaluated = exhaustive_tensor(
        work.tables, work.kind, weigh, work.shape, work.order, backend=PRECISIONS[precision]
    )
    return {
        "kind": kind, "precision": precision, "points": points, "hyperedges": evaluated, "kept": tensor.size,
        "seconds": time.perf_counter() - started,
    }  # fmt: skip


def break_even(points: int, repeats: int) -> dict[str, Any]:
    """All hyper-edges of P3P of as many source and target points: GPU and CPU, both warm."""
    work, weigh = enumeration("p3p", "joint", points, 0)
    spent = {}
    for name, backend in (("card", cuda), ("processor", cpu)):

        def tensor(backend: Any = backend) -> Any:
            return exhaustive_tensor(work.tables, work.kind, weigh, work.shape, work.order, backend=backend)

        tensor()
        spent[name] = seconds(tensor, repeats)
    count = exhaustive_count(*work.shape, work.order)
    return {"points": points, "hyperedges": count, **spent, "threads": numba.get_num_threads()}


STARTED = """
import time
import numpy, rootmatch
from rootmatch.backends import selection
from rootmatch.backends.strongest import Enumeration
from rootmatch.hypergraph.affinity import affinity
from rootmatch.samplers.exhaustive import exhaustive_tensor
from rootmatch.simulation import p3p_scene
scene = p3p_scene(n=6, noise=1.0, seed=0)
tables = scene.problem.prepare(scene.source, scene.target, 1.0)
weigh = affinity("joint")
started = time.perf_counter()
backend = selection.choose_backend("cuda", 1e12)
exhaustive_tensor(tables, weigh.residual.kernel_kind(1), weigh, (6, 6), 4, backend=backend)
print(time.perf_counter() - started)
"""


def start() -> float:
    """Seconds that a process needs from the choice of the GPU to its first tensor, by compiled kernels on disk."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), *sys.path])}
    for _ in range(1 if cuda.SIMULATED else 2):  # nothing is compiled for the simulator
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", STARTED], env=environment, check=True, capture_output=True, text=True
        )
    return float(done.stdout)


def contraction(edges: int, n: int, order: int, repeats: int) -> dict[str, Any]:
    """One contraction on the GPU, copies of x and v included, and on the CPU."""
    rng = np.random.default_rng(0)
    source = np.argsort(rng.random((edges, n)), axis=1)[:, :order]
    target = np.argsort(rng.random((edges, n)), axis=1)[:, :order]
    tensor = AffinityTensor((source * n + target).astype(np.int32), rng.random(edges), (n, n))
    device, x = DeviceTensor.of(tensor), rng.random((n, n))
    here, there = tensor.contract(x), device.contract(x)
    return {
        "hyperedges": edges, "order": order, "n": n, "card_ms": 1e3 * seconds(lambda: device.contract(x), repeats),
        "processor_ms": 1e3 * seconds(lambda: tensor.contract(x), repeats),
        "worst_relative": float(np.max(np.abs(there - here) / np.maximum(np.abs(here), 1e-300))),
    }  # fmt: skip


def markdown(found: dict[str, Any]) -> str:
    """The tables for docs/notebook/performance.md."""
    about, peak = found["card"], found["card"]["peak"]
    what = f"{about['name']}, {about['date']}, numba-cuda {about['numba_cuda']}, rootmatch {about['rootmatch']}"
    what += "".join(f"; peak in {precision} {maximum / 1e12:.1f} Tflop/s" for precision, maximum in peak.items())
    lines = [
        f"Card: {what}. Command: `python benchmarks/gpu.py`.", "", f"Tests on the card: {found['tests']}", "",
        "| problem | residual | precision | points | hyper-edges/s | operations each | share of peak | first call |",
        "|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for row in found["rates"]:
        count = row.get("operations")
        maximum = peak.get(row["precision"])
        share = f"{100 * row['per_second'] * count / maximum:.1f} %" if maximum and count else "–"
        lines.append(
            f"| {row['problem']} | `{row['kind']}` | {row['precision']} | {row['shape'][0]} × {row['shape'][1]} | "
            f"{row['per_second']:.3g} | {'–' if count is None else f'{count:.0f}'} | {share} | "
            f"{row['first_call_seconds']:.1f} s |"
        )
    lines += ["", "| all hyper-edges of P3P | residual | precision | looked at | kept | seconds |", "|---" * 6 + "|"]
    lines += [
        f"| {row['points']} × {row['points']} | `{row['kind']}` | {row['precision']} | {row['hyperedges']:.3g} | "
        f"{row['kept']:,} | {row['seconds']:.2f} |"
        for row in found["exhaustive"]
    ]
    lines += ["", f"A process starts the card in {found['start']:.1f} s.", ""]
    lines += ["| all hyper-edges of P3P `joint` | card | processor | ratio |", "|---|---|---|---|"]
    lines += [
        f"| {row['points']} × {row['points']}, {row['hyperedges']:.2g} | {row['card']:.3f} s | "
        f"{row['processor']:.3f} s, {row['threads']} threads | {row['processor'] / row['card']:.1f} |"
        for row in found["break_even"]
    ]
    lines += ["", "| contraction | order | card | processor | ratio |", "|---|---|---|---|---|"]
    lines += [
        f"| {row['hyperedges']:,} hyper-edges, n = {row['n']} | {row['order']} | {row['card_ms']:.2f} ms | "
        f"{row['processor_ms']:.2f} ms | {row['processor_ms'] / row['card_ms']:.1f} |"
        for row in found["contraction"]
    ]
    lines += [
        "", "| tensor against the processor's | hyper-edges | in one alone | worst difference | above 1e-9 |",
        "|---|---|---|---|---|",
    ]  # fmt: skip
    lines += [
        f"| {row['problem']} `{row['kind']}`, {row['precision']} | {row['hyperedges']:,} | "
        f"{row['only_processor'] + row['only_card']} | "
        f"{row['worst']:.1e} | {100 * row['beyond_1e-9']:.2f} % |"
        for row in found["agreement"]
    ]
    return "\n".join(lines) + "\n"


def verdict(found: dict[str, Any]) -> list[str]:
    """The goals and whether they are met."""
    said = [
        f"P3P normalised, {row['precision']}: {row['per_second']:.3g} hyper-edges/s, "
        f"{REACH['normalised']:.0e} asked for in float64"
        for row in found["rates"]
        if (row["problem"], row["kind"]) == ("p3p", "normalised")
    ]
    return said + [
        f"30 × 30, {row['precision']}: {row['seconds']:.2f} s, {REACH['exhaustive']:.0f} s asked for"
        for row in found["exhaustive"]
        if row["kind"] == "normalised" and row["points"] == 30
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("cuda-benchmark"))
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--hyperedges", type=float, default=1e9, help="evaluated for each rate")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="smallest sizes, to try the command")
    parser.add_argument("--no-tests", action="store_true")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    quick = options.quick
    sizes = MINIMUM if quick else SIZES
    repeats = 1 if quick else options.repeats

    def said(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    found: dict[str, Any] = {"card": card()}
    said(f"card: {found['card']}")
    found["tests"] = "not run" if options.no_tests else tests(options.output)
    said(f"tests: {found['tests']}")
    maximum = 50.0 if quick else options.hyperedges
    found["rates"] = []
    for problem, size in sizes.items():
        for kind in options.kinds:
            for precision in precisions(problem, kind):
                # a hundred times the work of the others
                row = rate(problem, kind, precision, size, maximum / 20 if kind == "svd" else maximum, repeats)
                said(
                    f"{problem} {kind} {precision}: {row['per_second']:.3g} hyper-edges/s, "
                    f"first call {row['first_call_seconds']:.1f} s"
                )
                found["rates"].append(row)
    try:
        operations(found["rates"])
    except (ImportError, subprocess.CalledProcessError) as error:
        said(f"operations not counted: {error!r}")
    points = 5 if quick else 30
    found["exhaustive"] = []
    for kind in ("normalised", "joint"):
        for precision in precisions("p3p", kind):
            number = exhaustive_count(points, points, 4)
            said(f"all {number:.3g} hyper-edges of {points} × {points}, {kind}, {precision}")
            found["exhaustive"].append(exhaustive(kind, precision, points))
    found["start"] = start()
    found["break_even"] = [break_even(points, repeats) for points in ((5,) if quick else (12, 16, 20, 24))]
    counts = ((100, 4, 3),) if quick else ((1_000_000, 20, 3), (5_000_000, 30, 4))
    found["contraction"] = [contraction(edges, n, order, repeats) for edges, n, order in counts]
    compared = (
        {"p3p": (4, 1), "up2p": (4, 1), "3p1": (4, 1)} if quick else {"p3p": (10, 6), "up2p": (16, 8), "3p1": (9, 6)}
    )
    found["agreement"] = [
        agreement(problem, kind, precision, *size)
        for problem, size in compared.items()
        for kind in ("joint", "normalised", "qr")
        if kind in options.kinds
        for precision in precisions(problem, kind)
    ]
    (options.output / "cuda.json").write_text(json.dumps(found, indent=1), encoding="utf-8")
    (options.output / "cuda.md").write_text(markdown(found), encoding="utf-8")
    print(markdown(found))
    for line in verdict(found):
        print(line)


if __name__ == "__main__":
    main()
