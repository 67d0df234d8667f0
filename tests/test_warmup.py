"""After `rootmatch.warmup` no frame of any flight waits for a compiler."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rig_scenes import VIEW, controllers, headset
from rootmatch.precompile import ahead_of_time
from rootmatch.precompile.ahead_of_time import _View, load_tracker
from rootmatch.samplers.guided.detection_grid import grid_of

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
        if k in (10, 11):
            pixels += rng.normal(0.0, 3.0, pixels.shape) * (np.arange(len(pixels)) % 2)[:, None]  # which is alike
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


@pytest.mark.parametrize("wide", [False, True])
def test_a_warm_up_of_a_wide_lens_has_detections_all_around(wide: bool) -> None:
    """Its grid of detections is of another type: a rig's flight had to load the search's kernel for it."""
    matrix = np.array([[330.0, 0.0, 640.0], [0.0, 330.0, 480.0], [0.0, 0.0, 1.0]])
    camera = rm.Camera.from_opencv_fisheye(matrix, [0.08, -0.02, 0.004, -0.0008]) if wide else rm.Camera(900, 900, 0, 0)
    view = _View(rm.P3P(camera), np.random.default_rng(0).normal(size=(7, 3)))
    for anywhere in (False, True):
        rays = camera.bearings(view.frame(0, 7, 60, wide=anywhere)).T
        assert bool(grid_of(np.ascontiguousarray(rays), np.full(rays.shape[1], 1e-3), narrow=False).whole) == (
            wide and anywhere
        )


TRACKED = """
import sys
from numba.core.dispatcher import Dispatcher
from rootmatch.cli import main
from rootmatch.tracking.tracker import Tracker

loaded, frames = [], []
before, update = Dispatcher.add_overload, Tracker.update

def counted(self, result):
    loaded.append(self.py_func.__qualname__)
    before(self, result)

def updated(self, target, **options):
    loaded.clear()
    found = update(self, target, **options)
    frames.append((options.get("time"), *loaded))
    return found

Dispatcher.add_overload, Tracker.update = counted, updated
sys.argv = ["rootmatch", "track", *sys.argv[1:]]
try:
    main()
finally:
    print(*(" ".join(map(str, one)) for one in frames if one[0] is not None), sep="\\n", file=sys.stderr)
"""


@pytest.mark.parametrize("problem", ["p3p", "rigid"])
def test_the_command_loads_what_it_needs_before_the_first_frame(tmp_path: Path, problem: str) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.2, 0.2, (9, 3))
    np.savetxt(tmp_path / "model.csv", points, delimiter=",", header="x,y,z", comments="")
    rows = []
    for k in range(4):
        seen = points @ Rotation.from_rotvec([0.3, 0.02 * k, 0.0]).as_matrix().T + (0.0, 0.0, 1.0)
        if problem == "p3p":
            seen = 800.0 * seen[:, :2] / seen[:, 2:] + (320.0, 240.0)
        rows += [[k, *row] for row in (seen + rng.normal(0.0, 1e-4, seen.shape)).tolist()]
    header = "frame,x,y" if problem == "p3p" else "frame,x,y,z"
    np.savetxt(tmp_path / "frames.csv", rows, delimiter=",", header=header, comments="", fmt="%.9g")
    options = ["--problem", problem, "--noise", "0.3" if problem == "p3p" else "0.0003"]
    options += ["--camera", "800,800,320,240"] if problem == "p3p" else []
    files = [str(tmp_path / "model.csv"), str(tmp_path / "frames.csv")]
    done = subprocess.run(
        [sys.executable, "-c", TRACKED, *files, *options], capture_output=True, text=True, check=False, timeout=900
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "4 matched" in done.stderr
    assert [line.split()[1:] for line in done.stderr.splitlines()[-4:]] == [[]] * 4


def test_what_is_loaded_before_the_first_frame_is_found_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Points that face away were shown as well: no pose fitted, and each start of the command took half a minute."""
    points, normals, names = controllers()
    monkeypatch.setattr(ahead_of_time, "LONGEST", 100.0)  # kernels may have to be compiled
    found: list[rm.Match] = []
    update = rm.Tracker.update
    monkeypatch.setattr(rm.Tracker, "update", lambda *own, **more: found.append(update(*own, **more)) or found[-1])
    load_tracker(rm.P3P(headset()), points, normals=normals, bodies=names, view_angle=np.radians(VIEW))
    assert [match.status for match in found] == [rm.Status.MATCHED] * 3


def test_what_a_warm_up_refuses() -> None:
    with pytest.raises(rm.InputError, match="warmup: normals, view_angle and bodies describe source points"):
        rm.warmup(rm.P3P(rm.Camera(800.0, 780.0, 320.0, 240.0)), bodies=[0, 1])
    with pytest.raises(rm.InputError, match="problem"):
        rm.warmup("p3p")  # type: ignore[arg-type]
