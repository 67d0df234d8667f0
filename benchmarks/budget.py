"""How closely a match keeps to `max_seconds`, stage by stage of the library and over many scenes; a table.

python benchmarks/budget.py --seeds 5 --threads 1

Kernels are compiled by one match of each kind before. A match is over where it takes more than a tenth and 5 ms above
its limit, by the clock (so run it on an idle machine) and, in brackets, in processor time.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from typing import Any

import numba
import numpy as np

import rootmatch as rm
from rootmatch.simulation import Scene, p3p_scene, three_plus_one_scene, up2p_scene

LIMITS = (0.01, 0.02, 0.05, 0.1, 0.25, 1.0)
SLACK, FIXED = 1.1, 0.005
FIRST_SEED = 20_000


def kinds(seed: int) -> Iterator[tuple[str, Scene, dict[str, Any]]]:
    """Scenes of every sampler, solver and way to assess."""
    yield "P3P 10 + 10, exhaustive", p3p_scene(10, 10, 1.0, seed), {"sampler": "exhaustive"}
    yield "P3P 20 + 20, guided", p3p_scene(20, 20, 1.0, seed), {}
    yield "P3P 50 + 50, guided", p3p_scene(50, 50, 1.0, seed), {}
    yield "P3P 20 against 40 unrelated", _unrelated(p3p_scene(20, 20, 1.0, seed), seed), {}
    yield "up2p 50 + 50, guided", up2p_scene(50, 50, 1.0, seed), {}
    yield "up2p 30 + 30, exhaustive", up2p_scene(30, 30, 1.0, seed), {"sampler": "exhaustive"}
    yield "up2p 20 + 20, random", up2p_scene(20, 20, 1.0, seed), {"sampler": "random", "samples": 2_000_000}
    yield "3P1 12 + 5, exhaustive", three_plus_one_scene(12, 5, 0.5, seed), {}
    yield "up2p, 8 motions of 5", up2p_scene(40, 0, 0.5, seed, motions=8), {"motions": "auto"}
    yield "P3P, 3 motions of 8", p3p_scene(24, 0, 0.5, seed, motions=3), {"motions": 3}
    yield "P3P 10 + 5, noise unknown", p3p_scene(10, 5, 1.0, seed), {"noise": "auto"}
    yield "P3P 10 + 5, the paper's preset", p3p_scene(10, 5, 0.5, seed), {"preset": "paper"}


def _unrelated(scene: Scene, seed: int) -> Scene:
    from dataclasses import replace

    target = np.random.default_rng(seed).uniform((0.0, 0.0), (640.0, 480.0), scene.target.shape)
    return replace(scene, target=target, truth=np.full(len(scene.source), -1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=0, help="of Numba; all by default")
    parser.add_argument("--only", default="", help="kinds whose name contains this")
    options = parser.parse_args()
    if options.threads:
        numba.set_num_threads(options.threads)
    over = busy = total = 0
    print("| scene | max_seconds | median s | worst s | limited | over | right, limited | matched and wrong |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    names = [name for name, _, _ in kinds(0) if options.only in name]
    for number, name in enumerate(names):
        _, scene, more = next(kind for kind in kinds(0) if kind[0] == name)
        rm.match(scene.source, scene.target, scene.problem, **{"noise": scene.noise, "max_seconds": 2.0, **more})
        for limit in LIMITS:
            times, limited, late, over_cpu, right, wrong = [], 0, 0, 0, 0, 0
            for seed in range(FIRST_SEED + 100 * number, FIRST_SEED + 100 * number + options.seeds):
                _, scene, more = next(kind for kind in kinds(seed) if kind[0] == name)
                started, worked = time.perf_counter(), time.process_time()
                found = rm.match(
                    scene.source, scene.target, scene.problem, **{"noise": scene.noise, "max_seconds": limit, **more}
                )
                times.append(time.perf_counter() - started)
                over_cpu += time.process_time() - worked > SLACK * limit + FIXED
                limited += found.stopped_early
                late += times[-1] > SLACK * limit + FIXED
                matched = found.assignment >= 0
                good = bool((found.assignment[matched] == scene.truth[matched]).all())
                right += found.stopped_early and good and matched.sum() >= 0.9 * (scene.truth >= 0).sum() > 0
                wrong += found.status is rm.Status.MATCHED and not good
            over, busy, total = over + late, busy + over_cpu, total + len(times)
            print(
                f"| {name} | {limit:g} | {np.median(times):.4f} | {max(times):.4f} | {limited} of {len(times)} |"
                f" {late} ({over_cpu}) | {right} | {wrong} |",
                flush=True,
            )
    print(
        f"\n{over} of {total} matches over {SLACK:g} × max_seconds + {1e3 * FIXED:g} ms by the clock,"
        f" {busy} in processor time"
    )


if __name__ == "__main__":
    main()
