"""Hyper-edges a second of each residual, beside batched ``numpy.linalg.qr`` of the same problem's Sylvester matrices.

Everything in one run on the same machine; the ratio is what counts. ``--json`` prints one object.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable

import numba
import numpy as np

from rootmatch.affinity import Residual, affinity, exhaustive_tensor
from rootmatch.hyperedges import wide_first
from rootmatch.simulation import Scene, p3p_scene, three_plus_one_scene, up2p_scene

SCENES: dict[str, Callable[..., Scene]] = {"p3p": p3p_scene, "up2p": up2p_scene, "3p1": three_plus_one_scene}
SIZES = {"p3p": (10, 10), "up2p": (20, 20), "3p1": (8, 7)}
"""Points and outliers: 24.4, 67.5 and 2.3 million hyper-edges."""


def seconds(work: Callable[[], object], repeats: int) -> float:
    """Median time of a call, after one that is not counted."""
    work()
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return float(np.median(times))


def factorisations_per_second(degree: int, repeats: int) -> float:
    """Batched QR of Sylvester matrices of random unit polynomials."""
    rng = np.random.default_rng(0)
    batch = 20_000
    first, second = rng.normal(size=(2, batch, degree + 1))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    matrices = np.zeros((batch, 2 * degree, 2 * degree))
    for row in range(degree):
        matrices[:, row, row : row + degree + 1] = first
        matrices[:, degree + row, row : row + degree + 1] = second
    return batch / seconds(lambda: np.linalg.qr(matrices, mode="r"), repeats)


def hyperedges_per_second(scene: Scene, kind: str, repeats: int) -> tuple[float, int]:
    """Of an exhaustive sweep, selection included."""
    order = wide_first(scene.source)
    problem = scene.problem
    tables = problem.prepare(scene.source[order], scene.target, 1.0)
    # a narrow gate: kernels and screening are timed, not the selection of what passes
    weigh = affinity(Residual(kind), gate=0.3 if kind in ("normalised", "joint") else 1e-3 * problem.paper_rho)
    shape = (len(scene.source), len(scene.target))

    def sweep() -> int:
        _, evaluated = exhaustive_tensor(
            tables, weigh.residual.kernel_kind(problem.pair_count), weigh, shape, problem.order, max_hyperedges=100_000
        )
        return evaluated

    evaluated = sweep()
    return evaluated / seconds(sweep, repeats), evaluated


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problems", nargs="+", choices=list(SCENES), default=list(SCENES))
    parser.add_argument("--kinds", nargs="+", default=["joint", "normalised", "qr", "qr-both"])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = []
    for name in options.problems:
        n, outliers = SIZES[name]
        scene = SCENES[name](n=n, outliers=outliers, noise=1.0, seed=0)
        reference = factorisations_per_second(scene.problem.degree, options.repeats)
        for kind in options.kinds:
            rate, count = hyperedges_per_second(scene, kind, options.repeats)
            rows.append(
                {"problem": name, "kind": kind, "hyperedges": count, "per_second": rate, "qr_per_second": reference,
                 "ratio": rate / reference}
            )  # fmt: skip
            if not options.json:
                print(
                    f"{name:5s} {kind:11s} {count / 1e6:7.1f} M hyper-edges  {rate / 1e6:7.1f} M/s  "
                    f"QR {reference / 1e6:5.2f} M/s  ratio {rate / reference:6.0f}",
                    flush=True,
                )
    if options.json:
        print(json.dumps({"threads": numba.get_num_threads(), "rows": rows}))


if __name__ == "__main__":
    main()
