"""How often `Match.diagnose` names the mistake that was made, and any where nothing is to be found.

    python benchmarks/diagnosis.py --seeds 10 --first-seed 1000

Scenes are those of tests/test_diagnosis.py: ten points and two stray detections, one mistake each; and as many points
and detections that have nothing to do with each other.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

import rootmatch as rm

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from test_diagnosis import CAMERA, mistaken

MISTAKES = (
    "y is measured upwards in the image, or the model is left-handed",
    "x and y of the image are exchanged",
    "the camera was calibrated at half the size of the image",
    "the camera was calibrated at twice the size of the image",
    "the lens' coefficients are those of a fisheye",
    "the noise is 10 times as large",
)


def main() -> None:
    """Print a row for each mistake."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--seeds", type=int, default=10)
    ask.add_argument("--first-seed", type=int, default=1000)
    asked = ask.parse_args()
    seeds = range(asked.first_seed, asked.first_seed + asked.seeds)
    print("| mistake | matched all the same | named first | named after another | not named | seconds |")
    print("|---|---|---|---|---|---|")
    for mistake in MISTAKES:
        count, took = [0, 0, 0, 0], []
        for seed in seeds:
            match = rm.match(**mistaken(mistake, seed))
            if match:
                count[0] += 1
                continue
            started = time.process_time()
            named = [one.mistake for one in match.diagnose().fits]
            took.append(time.process_time() - started)
            count[1 if named[:1] == [mistake] else 2 if mistake in named else 3] += 1
        print(f"| {mistake} | {' | '.join(map(str, count))} | {np.median(took or [0.0]):.1f} |", flush=True)
    alarms, of = 0, 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        match = rm.match(rng.uniform(-0.3, 0.3, (10, 3)), rng.uniform(0, 900, (12, 2)), rm.P3P(CAMERA), noise=0.3)
        alarms, of = alarms + bool(match.diagnose().fits), of + 1
    print(f"unrelated: a mistake named in {alarms} of {of}")


if __name__ == "__main__":
    main()
