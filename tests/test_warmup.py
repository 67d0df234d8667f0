"""After `rootmatch.warmup` no frame of any flight waits for a compiler."""

from __future__ import annotations

import subprocess
import sys

import pytest

import rootmatch as rm

FLIGHTS = """
import sys
import numpy as np
from numba.core.dispatcher import Dispatcher

names = []
before = Dispatcher.add_overload

def counted(self, result):  # of what is compiled, and of what is loaded: where nothing is kept it would be compiled
    names.append(f"{self.py_func.__module__}.{self.py_func.__qualname__}")
    before(self, result)

Dispatcher.add_overload = counted
import rootmatch as rm
from scipy.spatial.transform import Rotation

camera = rm.Camera(800.0, 780.0, 320.0, 240.0)
down = (0.0, 1.0, 0.0)
problem = rm.P3P(camera) if sys.argv[1] == "p3p" else rm.UP2P(camera, down, down)
told = []
rm.warmup(problem, progress=lambda done, total: told.append((done, total)))
assert told[0][0] == 0 and told[-1][0] == told[-1][1] == len(told) - 1, told
assert len(names) > 5, "what is counted is not there"
names.clear()

def flight(body, normals=None):
    rng = np.random.default_rng(4)
    tracker = rm.Tracker(body, problem, noise=0.3, normals=normals)
    for k in range(26):
        turn = Rotation.from_rotvec([0.0, 0.02 * k, 0.0]).as_matrix()
        R = turn if problem.name == "up2p" else turn @ Rotation.from_rotvec([0.4, 0.3, 0.2]).as_matrix()
        t = np.array([0.002 * k, 0.1, 3.0 if k < 16 else 4.0]) - R @ body.mean(axis=0)  # a jump: a wrong prediction
        places = body @ R.T + t
        faces = np.ones(len(body), bool) if normals is None else ((normals @ R.T) * places).sum(axis=1) < 0.0
        shown = np.flatnonzero(faces)
        if 4 <= k < 6:
            shown = shown[:0]  # occluded
        elif 8 <= k < 10:
            shown = shown[:3]
        elif 12 <= k < 14:
            shown = shown[:4]
        elif k >= 20:
            shown = shown[::2]
        clutter = 25 if k in (14, 22) else 4 if k >= 20 else 2
        pixels = camera.project(places[shown]) + rng.normal(0.0, 0.3, (len(shown), 2))
        target = np.concatenate([pixels, rng.uniform((0.0, 0.0), (640.0, 480.0), (clutter, 2))])
        found = tracker.update(target[rng.permutation(len(target))])
        _ = found.score, found.confidence, found.pose, found.alternatives
        if k == 18:
            tracker.reset()

rng = np.random.default_rng(4)
ball = rng.normal(size=(22, 3))
ball /= np.linalg.norm(ball, axis=1, keepdims=True)
six = rng.uniform((0.1, -0.3, -0.3), (0.7, 0.3, 0.3), (6, 3))
flight(0.3 * rng.uniform(-1.0, 1.0, (7, 3)))
flight(np.concatenate([six, six * [-1.0, -1.0, 1.0]]))  # a clone: it looks the same after half a turn
flight(0.5 * ball, ball)
print(*sorted(set(names)))
"""


def kernels_met(problem: str) -> list[str]:
    """Names of the kernels that flights had to compile or to load, in a process of their own."""
    done = subprocess.run(
        [sys.executable, "-c", FLIGHTS, problem], capture_output=True, text=True, check=False, timeout=900
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.split()


@pytest.mark.parametrize("problem", ["p3p", "up2p"])
def test_flights_compile_nothing_after_a_warm_up(problem: str) -> None:
    assert kernels_met(problem) == []


def test_what_a_warm_up_refuses() -> None:
    with pytest.raises(rm.InputError, match="warmup: normals, view_angle and bodies describe source points"):
        rm.warmup(rm.P3P(rm.Camera(800.0, 780.0, 320.0, 240.0)), bodies=[0, 1])
    with pytest.raises(rm.InputError, match="problem"):
        rm.warmup("p3p")  # type: ignore[arg-type]


def test_the_function_is_not_its_package() -> None:
    code = "import rootmatch.precompile.steps, rootmatch; assert type(rootmatch.warmup).__name__ == 'function'"
    subprocess.run([sys.executable, "-c", code], check=True)
