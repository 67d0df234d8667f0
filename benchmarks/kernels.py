"""Hyper-edges per second of each residual, against batched ``numpy.linalg.qr`` of the problem's Sylvester matrices.

The first part of ``rootmatch benchmark``, for selected problems and kinds. Everything in one run on the same
machine; only the ratio is meaningful. ``--json`` prints one object.
"""

from __future__ import annotations

import argparse
import json

import numba

from rootmatch.research.speed import Plan
from rootmatch.research.speed.kernels import rates


def main() -> None:
    plan = Plan()
    names = [case[0] for case in plan.kernels]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problems", nargs="+", choices=names, default=names)
    parser.add_argument("--kinds", nargs="+", default=plan.kinds)
    parser.add_argument("--repeats", type=int, default=plan.repeats)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = []
    for problem, points, outliers in plan.kernels:
        if problem not in options.problems:
            continue
        measured = rates(problem, options.kinds, points, outliers, plan.batch, options.repeats)
        for kind, rate in zip(options.kinds, measured, strict=True):
            ratio = rate.per_second / rate.qr_per_second
            rows.append({"problem": problem, "kind": kind, **rate._asdict(), "ratio": ratio})
            if not options.json:
                print(
                    f"{problem:5s} {kind:11s} {rate.hyperedges / 1e6:7.1f} M hyper-edges  "
                    f"{rate.per_second / 1e6:7.1f} M/s  QR {rate.qr_per_second / 1e6:5.2f} M/s  ratio {ratio:6.0f}",
                    flush=True,
                )
    if options.json:
        print(json.dumps({"threads": numba.get_num_threads(), "rows": rows}))


if __name__ == "__main__":
    main()
