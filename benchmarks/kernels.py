"""Hyper-edges a second of each residual, beside batched ``numpy.linalg.qr`` of the same problem's Sylvester matrices.

The first part of ``rootmatch benchmark``, with a choice of problems and kinds. Everything in one run on the same
machine; the ratio is what counts. ``--json`` prints one object.
"""

from __future__ import annotations

import argparse
import json

import numba

from rootmatch.benchmark import Plan
from rootmatch.benchmark.kernels import factorisations_per_second, hyperedges_per_second
from rootmatch.benchmark.scenes import made


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
        degree = made(problem, points, outliers).problem.degree
        reference = factorisations_per_second(degree, plan.batch, options.repeats)
        for kind in options.kinds:
            rate, count = hyperedges_per_second(problem, kind, points, outliers, options.repeats)
            rows.append(
                {"problem": problem, "kind": kind, "hyperedges": count, "per_second": rate, "qr_per_second": reference,
                 "ratio": rate / reference}
            )  # fmt: skip
            if not options.json:
                print(
                    f"{problem:5s} {kind:11s} {count / 1e6:7.1f} M hyper-edges  {rate / 1e6:7.1f} M/s  "
                    f"QR {reference / 1e6:5.2f} M/s  ratio {rate / reference:6.0f}",
                    flush=True,
                )
    if options.json:
        print(json.dumps({"threads": numba.get_num_threads(), "rows": rows}))


if __name__ == "__main__":
    main()
