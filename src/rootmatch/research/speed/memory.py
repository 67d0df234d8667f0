"""Peak memory of an exhaustive sweep, measured in a process of its own."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from joblib.externals.loky import ProcessPoolExecutor

from rootmatch.hypergraph.affinity import affinity
from rootmatch.research.speed.scenes import scene_and_tables
from rootmatch.samplers.exhaustive import exhaustive_tensor


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
