"""All measurements of ``rootmatch benchmark``, in one run on one machine."""

from __future__ import annotations

import platform
import statistics
import sys
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numba
from joblib.externals.loky import ProcessPoolExecutor

from rootmatch._version import __version__
from rootmatch.api import match
from rootmatch.backends.strongest import Progress
from rootmatch.hypergraph.affinity import affinity
from rootmatch.matcher import Matcher
from rootmatch.research.speed.contraction import measure_contraction
from rootmatch.research.speed.kernels import rates
from rootmatch.research.speed.operation_count import operations
from rootmatch.research.speed.peak_flops import peak
from rootmatch.research.speed.scenes import NOISE, make_scene, scene_and_tables
from rootmatch.research.speed.timing import seconds
from rootmatch.samplers.exhaustive import exhaustive_tensor

FRAMES = 9
"""Frames of a tracked scene, after the first ones."""

NOTE = (
    "Only ratios within one run are meaningful: rates depend on the machine and its load. "
    "The first run compiles, which takes minutes and is not timed."
)

Case = tuple[str, int, int]
"""Problem, points, outliers."""
ALL_KINDS = ("joint", "normalised", "qr", "qr-both")


def peak_megabytes() -> float | None:
    """Peak memory of this process in MiB; None if the system does not report it."""
    status = Path("/proc/self/status")
    if status.is_file():  # on Linux, getrusage inherits the parent's peak
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 2.0**10
    try:
        import resource
    except ImportError:
        return None
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / (2.0**20 if sys.platform == "darwin" else 2.0**10)


def measure_memory(problem: str, points: int, outliers: int) -> dict[str, Any]:
    """Peak memory of an exhaustive sweep and of the library alone, in MiB, and bytes per kept hyper-edge."""
    with ProcessPoolExecutor(1) as pool:
        figures: dict[str, Any] = pool.submit(_measure_sweep, problem, points, outliers).result()
    return figures


def _measure_sweep(problem: str, points: int, outliers: int) -> dict[str, Any]:
    """Build the tensor of a scene in this process and look at its memory."""
    scene, tables = scene_and_tables(problem, points, outliers)
    before = peak_megabytes()
    weighting = affinity("joint")
    shape = (len(scene.source), len(scene.target))
    kind = weighting.residual.kernel_kind(scene.problem.pair_count)
    tensor, evaluated = exhaustive_tensor(tables, kind, weighting, shape, scene.problem.order)
    bytes_each = (tensor.indices.nbytes + tensor.weights.nbytes) / max(tensor.size, 1)
    return {
        "case": f"{problem} {shape[0]} × {shape[1]}, exhaustive", "hyperedges": evaluated, "kept": tensor.size,
        "peak_megabytes": peak_megabytes(), "peak_megabytes_before": before, "bytes_each": bytes_each,
    }  # fmt: skip


def measure_matches(problem: str, points: int, outliers: int, seeds: range) -> dict[str, Any]:
    """Median time and evaluations and mean accuracy over scenes, after a warm-up scene."""
    spent, accuracy, evaluations = [], [], []
    for seed in (seeds[0], *seeds):
        scene = make_scene(problem, points, outliers, seed)
        result = match(scene.source, scene.target, scene.problem, noise=NOISE, seed=seed)
        spent.append(result.seconds)
        accuracy.append(scene.accuracy(result.assignment))
        evaluations.append(result.evaluated)
    return _row(f"{problem} {points} + {outliers}", spent[1:], accuracy[1:], evaluations[1:])


def measure_tracked(problem: str, points: int, outliers: int, seeds: range) -> dict[str, Any]:
    """Time of the median frame of a `Matcher`, with its accuracy."""
    spent, accuracy, evaluations = [], [], []
    for seed in seeds:
        scene = make_scene(problem, points, outliers, seed)
        matcher = Matcher(scene.source, scene.problem, noise=NOISE, seed=seed)
        result = matcher.match(scene.target)
        spent.append(seconds(partial(matcher.match, scene.target), FRAMES))
        accuracy.append(scene.accuracy(result.assignment))
        evaluations.append(result.evaluated)
    return _row(f"{problem} {points} + {outliers}, tracked", spent, accuracy, evaluations)


def _row(case: str, spent: list[float], accuracy: list[float], evaluations: list[int]) -> dict[str, Any]:
    return {
        "case": case, "scenes": len(spent), "milliseconds": 1e3 * statistics.median(spent),
        "accuracy": statistics.fmean(accuracy), "evaluations": statistics.median(evaluations),
    }  # fmt: skip


@dataclass(frozen=True)
class Plan:
    """What to measure, and at which sizes."""

    kernels: tuple[Case, ...] = (("p3p", 10, 10), ("up2p", 20, 20), ("3p1", 8, 7))
    """24.4, 67.5 and 2.3 million hyper-edges."""
    kinds: tuple[str, ...] = ALL_KINDS
    batch: int = 20_000
    """Matrices factorised per call."""
    contraction: tuple[int, int] = (1_000_000, 20)
    """Hyper-edges, and n = n'."""
    matches: tuple[Case, ...] = (
        ("p3p", 10, 10),
        ("p3p", 20, 20),
        ("p3p", 50, 50),
        ("up2p", 20, 20),
        ("up2p", 100, 100),
    )
    tracked: Case = ("p3p", 5, 3)
    scenes: int = 5
    memory: Case = ("p3p", 12, 20)
    """Exhaustive 12 × 32: 427 million hyper-edges."""
    rounds: int = 500_000
    """Rounds of the loop that measures the machine's peak."""
    samples: int = 3
    """Random panels per operation count."""
    repeats: int = 5

    @classmethod
    def tiny(cls) -> Plan:
        """The smallest sizes that run, to check that everything works."""
        return cls(
            kernels=(("p3p", 5, 1), ("up2p", 5, 1)), kinds=("joint",), batch=50, contraction=(2_000, 8),
            matches=(("up2p", 6, 2),), tracked=("p3p", 5, 3), scenes=1, memory=("p3p", 5, 3), rounds=10, samples=1,
            repeats=1,
        )  # fmt: skip

    @property
    def steps(self) -> int:
        """Total number of measurements."""
        return len(self.kernels) + len(self.matches) + 5


@dataclass
class Results:
    """The measurements; rates are per second."""

    note: str = NOTE
    version: str = __version__
    machine: str = ""
    threads: int = 0
    peak_operations: float = 0.0
    kernels: list[dict[str, Any]] = field(default_factory=list)
    contraction: dict[str, float] = field(default_factory=dict)
    matches: list[dict[str, Any]] = field(default_factory=list)
    memory: dict[str, Any] = field(default_factory=dict)


def run(plan: Plan, progress: Progress | None = None) -> Results:
    """Carry out a plan; ``progress`` is called with (measurements done, total)."""
    done = 0

    def step() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, plan.steps)

    results = Results(machine=f"{platform.machine()} {platform.system()}", threads=numba.get_num_threads())
    results.peak_operations = peak(plan.rounds, plan.repeats)
    step()
    cases = [(problem, kind, points, outliers) for problem, points, outliers in plan.kernels for kind in plan.kinds]
    counts = dict(zip(cases, operations(cases, plan.samples), strict=True))
    step()
    for problem, points, outliers in plan.kernels:
        measured = rates(
            problem=problem, kinds=plan.kinds, points=points, outliers=outliers, batch=plan.batch, repeats=plan.repeats
        )
        for kind, rate in zip(plan.kinds, measured, strict=True):
            each = counts[problem, kind, points, outliers]
            results.kernels.append(
                {
                    "problem": problem, "kind": kind, **rate._asdict(), "ratio": rate.per_second / rate.qr_per_second,
                    "operations": each, "share_of_peak": rate.per_second * each / results.peak_operations,
                }
            )  # fmt: skip
        step()
    results.contraction = measure_contraction(*plan.contraction, plan.repeats)
    step()
    seeds = range(1000, 1000 + plan.scenes)
    results.matches.append(measure_tracked(*plan.tracked, seeds))
    step()
    for case in plan.matches:
        results.matches.append(measure_matches(*case, seeds))
        step()
    results.memory = measure_memory(*plan.memory)
    step()
    return results
