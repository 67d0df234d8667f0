"""How often `Match.diagnose` names the mistake that was made, and any where nothing is to be found.

    python benchmarks/diagnosis.py --seeds 10 --first-seed 1000

Scenes are those of tests/test_diagnosis.py: eight points and two stray detections, one mistake each. Others are made
here: a left-handed model; a closed body of 24 points whose normals were negated; a model in millimetres before two
cameras in metres; and thirty points, detected to .02 px with a principal point that is off by half a pixel, which is
asked for also where a pose absorbs it. Unrelated: ten points and twelve detections that have nothing in common.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
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
    "the model is left-handed",
    "the normals point inwards",
    "the model is in millimetres, the rig in metres",
    "the principal point is off by half a pixel",
)
NAMED = {"the model is left-handed": MISTAKES[0]}
"""What a mistake is called where no pose tells it from another one."""


def scene_of(mistake: str, seed: int) -> dict[str, Any]:
    """A scene with one mistake, as `rootmatch.match` takes it."""
    if mistake not in MISTAKES[6:]:
        return mistaken(mistake, seed)
    rng, R = np.random.default_rng([seed, 29]), Rotation.random(random_state=seed).as_matrix()
    place = np.array([*rng.uniform(-0.15, 0.15, 2), rng.uniform(1.2, 1.8)])
    normals, count, noise = None, 12, 0.3
    if "half a pixel" in mistake:
        count, noise = 30, 0.02
    if "normals" in mistake:
        height, turned = np.linspace(-0.95, 0.95, 24), 2.4 * np.arange(24)  # a golden spiral: some face every camera
        across = np.sqrt(1.0 - height**2)
        normals = np.column_stack([across * np.cos(turned), across * np.sin(turned), height])
        points = 0.25 * normals + rng.normal(0.0, 0.01, normals.shape)
    else:
        points = rng.uniform(-0.3, 0.3, (count, 3))
    seen = points @ R.T + place
    if normals is not None:
        seen = seen[-((normals @ R.T) * seen).sum(axis=1) > 0.3 * np.linalg.norm(seen, axis=1)]
        normals = -normals

    def detected(camera: rm.Camera, moved: Any) -> Any:
        pixels = rng.permutation(camera.project(moved))
        return pixels + rng.normal(0.0, noise, pixels.shape)

    problem: Any = rm.P3P(CAMERA)
    if "rig" in mistake:
        side = Rotation.from_euler("y", 10.0, degrees=True).as_matrix()
        views = [(CAMERA, np.eye(3), np.zeros(3)), (CAMERA, side, np.array([-0.3, 0.0, 0.02]))]
        target: Any = [detected(CAMERA, seen @ turn.T + t) for _, turn, t in views]
        points, problem = 1000.0 * points, rm.P3P(rm.Rig(views, sizes=[(1280, 960)] * 2))
    else:
        off = 0.5 if "half a pixel" in mistake else 0.0
        target = detected(rm.Camera(900.0, 900.0, 640.0 + off, 480.0 + off), seen)
    if "left-handed" in mistake:
        points = points * (1.0, 1.0, -1.0)
    return {"source": points, "target": target, "problem": problem, "noise": noise, "normals": normals}


def main() -> None:
    """Print a row for each mistake."""
    asked = parser(__doc__, seeds=10, first_seed=1000).parse_args()
    seeds = range(asked.first_seed, asked.first_seed + asked.seeds)
    head("mistake", "matched, not asked", "named first", "named after another", "not named", "seconds", "longest")
    for mistake in MISTAKES:
        count, took = [0, 0, 0, 0], []
        for seed in seeds:
            match = rm.match(**scene_of(mistake, seed))
            if match and "half a pixel" not in mistake:
                count[0] += 1
                continue
            diagnosis, seconds = timed(match.diagnose)
            named = [one.mistake for one in diagnosis.fits]
            took.append(seconds)
            name = NAMED.get(mistake, mistake)
            count[1 if named[:1] == [name] else 2 if name in named else 3] += 1
        row(mistake, *count, f"{np.median(took or [0.0]):.1f}", f"{max(took, default=0.0):.1f}")
    alarms, of = 0, 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        match = rm.match(rng.uniform(-0.3, 0.3, (10, 3)), rng.uniform(0, 900, (12, 2)), rm.P3P(CAMERA), noise=0.3)
        alarms, of = alarms + bool(match.diagnose().fits), of + 1
    print(f"unrelated: a mistake named in {alarms} of {of}")


if __name__ == "__main__":
    main()
