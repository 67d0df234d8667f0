"""Peak memory of a whole exhaustive match, each size in a process of its own.

The largest is 12 points against 32 detections with P3P: 427 million hyper-edges, of which those below the gate are
kept. The peak is the operating system's (``ru_maxrss``) and includes the interpreter and the compiled kernels; the
smallest size shows how much that is. A warm-up run keeps the compiler out of the figure.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time

SIZES = ((6, 8), (12, 20), (12, 32))
"""Source points and detections."""
MEGABYTE = 1 << 20


def measured(n: int, n_target: int, most: int) -> dict[str, float]:
    """One match in this process."""
    from rootmatch import match
    from rootmatch.simulation import p3p_scene

    scene = p3p_scene(n, n_target - n, noise=1.0, seed=0)
    started = time.perf_counter()
    found = match(
        scene.source, scene.target, scene.problem, sampler="exhaustive", max_hyperedges=most, noise=scene.noise
    )
    seconds = time.perf_counter() - started
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return {
        "hyperedges": float(found.hyperedges),
        "kept": float(found.tensor.size),
        "accuracy": float((found.assignment == scene.truth).mean()),
        "seconds": seconds,
        "peak_megabytes": peak / MEGABYTE,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--most", type=int, default=5_000_000, help="hyper-edges to keep at most")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--one", nargs=2, type=int, metavar=("N", "N'"), help="measure one size in this process")
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(measured(*arguments.one, arguments.most)))
        return
    result = {}
    for size in (SIZES[0], *SIZES):
        command = [sys.executable, __file__, "--most", str(arguments.most), "--one", *map(str, size)]
        printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        result["{} against {}".format(*size)] = json.loads(printed)
    if arguments.json:
        print(json.dumps(result))
        return
    print(f"{'':16s} {'hyper-edges':>12s} {'kept':>10s} {'accuracy':>9s} {'seconds':>8s} {'peak MB':>8s}")
    for name, row in result.items():
        print(
            f"{name:16s} {row['hyperedges']:12.0f} {row['kept']:10.0f} {row['accuracy']:9.2f} "
            f"{row['seconds']:8.2f} {row['peak_megabytes']:8.0f}"
        )


if __name__ == "__main__":
    main()
