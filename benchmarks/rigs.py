"""Rigs: twenty points amidst four cameras, of which each sees five others, with clutter.

    python benchmarks/rigs.py [SCENES]

Seeds from 20000 on; the scenes are those of tests/test_rigs.py.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import rootmatch as rm
from test_rigs import four_about


def main(scenes: int) -> None:
    print("| clutter a camera | scenes | matched | all right | matched and wrong | seconds, median |")
    print("|---|---|---|---|---|---|")
    for clutter in (0, 2, 5):
        status: Counter[str] = Counter()
        right = wrong = 0
        seconds = []
        for seed in range(20000, 20000 + scenes):
            points, rows, rig, truth, _ = four_about(clutter=clutter, seed=seed)
            started = time.process_time()
            found = rm.match(points, rows, rm.P3P(rig), noise=0.5)
            seconds.append(time.process_time() - started)
            status[found.status.name] += 1
            right += np.array_equal(found.sightings.assignment, truth)
            # a point that is left out is no error; one at another detection is
            matched = found.sightings.assignment >= 0
            wrong += bool(found.status) and not np.array_equal(found.sightings.assignment[matched], truth[matched])
        print(
            f"| {clutter} | {scenes} | {status['MATCHED']} | {right} | {wrong} | {np.median(seconds):.2f} |", flush=True
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
