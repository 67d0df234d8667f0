"""All measurements of ``rootmatch benchmark``, in one run on one machine."""

from __future__ import annotations

import platform
from dataclasses import dataclass, field
from typing import Any

import numba

from rootmatch._version import __version__
from rootmatch.backends.strongest import Progress
from rootmatch.research.speed.contraction import measure_contraction
from rootmatch.research.speed.kernels import rates
from rootmatch.research.speed.matches import measure_matches, measure_tracked
from rootmatch.research.speed.memory import measure_memory
from rootmatch.research.speed.operation_count import operations
from rootmatch.research.speed.peak_flops import peak

NOTE = (
    "Only ratios within one run are meaningful: rates depend on the machine and its load. "
    "The first run compiles, which takes minutes and is not timed."
)

Case = tuple[str, int, int]
"""Problem, points, outliers."""
ALL_KINDS = ("joint", "normalised", "qr", "qr-both")


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
