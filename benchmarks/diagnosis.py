"""How often `Match.diagnose` names the mistake that was made, and any where nothing is to be found.

    python benchmarks/diagnosis.py --seeds 10 --first-seed 1000

Scenes are those of tests/test_diagnosis.py: ten points and two stray detections, one mistake each; and as many points
and detections that have nothing to do with each other.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from shared import head, parser, row, timed

import rootmatch as rm

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from test_diagnosis import CAMERA, mistaken

MISTAKES = (
    "y is measured upwards in the image, or the model is left-handed",
    "x and y of the image are swapped",
    "the camera was calibrated at half the size of the image",
    "the camera was calibrated at twice the size of the image",
    "the lens coefficients are those of a fisheye",
    "the noise is 10 times as large",
)


def main() -> None:
    """Print a row for each mistake."""
    asked = parser(__doc__, seeds=10, first_seed=1000).parse_args()
    seeds = range(asked.first_seed, asked.first_seed + asked.seeds)
    head("mistake", "matched all the same", "named first", "named after another", "not named", "seconds")
    for mistake in MISTAKES:
        count, took = [0, 0, 0, 0], []
        for seed in seeds:
            match = rm.match(**mistaken(mistake, seed))
            if match:
                count[0] += 1
                continue
            diagnosis, seconds = timed(match.diagnose)
            named = [one.mistake for one in diagnosis.fits]
            took.append(seconds)
            count[1 if named[:1] == [mistake] else 2 if mistake in named else 3] += 1
        row(mistake, *count, f"{np.median(took or [0.0]):.1f}")
    alarms, of = 0, 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        match = rm.match(rng.uniform(-0.3, 0.3, (10, 3)), rng.uniform(0, 900, (12, 2)), rm.P3P(CAMERA), noise=0.3)
        alarms, of = alarms + bool(match.diagnose().fits), of + 1
    print(f"unrelated: a mistake named in {alarms} of {of}")


if __name__ == "__main__":
    main()
