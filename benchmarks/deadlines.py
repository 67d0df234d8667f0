"""How far matches with `max_seconds` overrun it: random tasks of every problem and feature, up to 3,000 points.

    python benchmarks/deadlines.py run rows.jsonl --tasks 228
    python benchmarks/deadlines.py run rows.jsonl --only 17 40
    python benchmarks/deadlines.py report rows.jsonl
    python benchmarks/deadlines.py stacks --only 17    # what ran after the deadline
    python benchmarks/deadlines.py signals --tasks 200  # how long a signal waits, without a limit

A task follows from its number and the seed. A row is written when it is measured, and a run goes on where the last one
ended. Tasks run in a process of their own, which is killed when a match takes `PATIENCE` seconds more than it may; that
row says "at least". A run during which Numba compiled or loaded a kernel does not count and is repeated. One that
overruns is repeated too, up to `TURNS` times in all, and the shortest counts: another process may have had the
processor. The bound is a tenth and 5 ms. On a busy machine nothing is to be learnt from the clock on the wall: with
``--clock processor`` limits and times are seconds of processor time, on one thread.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
import traceback
import types
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from shared import head, parser, row

import rootmatch as rm
from rootmatch.problems import PROBLEMS
from rootmatch.samplers.completion import Completion
from rootmatch.solvers import SOLVERS

SEED = 28
PATIENCE = 20.0
"""Seconds after its limit at which a match is given up."""
TURNS = 3
"""Times that a match which overruns is run."""
COMPILED = 120.0
"""Seconds that a kernel may take to compile."""
LONGER = 1.0
"""Seconds of the match that comes first, in which most of what is needed is compiled."""
COMPILING = 6
"""Times that a match which compiles is run again, beyond that."""
LIMITS = (0.05, 0.1, 0.3, 1.0)
"""Seconds allowed."""
MAX_POINTS = 3000
SAMPLER, GUIDED = "sampler", {"sampler": "guided"}
CAMERA = rm.Camera(1000.0, 1000.0, 320.0, 240.0)
NOISE = 0.5
Scene = dict[str, Any]
Feature = Callable[[np.random.Generator, Scene], dict[str, Any]]


# -- Scenes -----------------------------------------------------------------------------------------------------------


def points_in_a_ball(rng: np.random.Generator, n: int) -> np.ndarray:
    """Points within 2 of the origin."""
    points = rng.normal(size=(n, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True) * 2.0 * rng.uniform(size=(n, 1)) ** (1.0 / 3.0)


def shown_among_clutter(
    rng: np.random.Generator, seen: np.ndarray, n_target: int, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """As many detections: up to nine in ten of the points, and clutter in a box."""
    count = min(len(seen), int(rng.uniform(0.5, 0.9) * n_target) + 1, n_target)
    shown = seen[rng.permutation(len(seen))[:count]]
    rest = rng.uniform(low, high, (n_target - count, seen.shape[1]))
    return np.concatenate([shown, rest])[rng.permutation(n_target)]


def scene(rng: np.random.Generator, name: str, n: int, n_target: int) -> Scene:
    """Points, their images and the problem; ``R`` and ``t`` of the camera where that is all that is unknown."""
    corners = np.array([0.0, 0.0]), np.array([640.0, 480.0])
    if name in ("similarity", "rigid"):
        d = int(rng.integers(2, 4))
        points = rng.uniform(-1.0, 1.0, (n, d))
        turn = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-3.0, 3.0)]) if d == 2 else Rotation.random(random_state=rng)
        moved = points @ turn.as_matrix()[:d, :d].T * (1.7 if name == "similarity" else 1.0) + rng.normal(size=d)
        moved += 0.005 * rng.normal(size=moved.shape)
        problem = {"similarity": rm.Similarity, "rigid": rm.Rigid}[name](d)
        target = shown_among_clutter(rng, moved, n_target, moved.min(axis=0), moved.max(axis=0))
        return {"source": points, "target": target, "problem": problem, "noise": 0.005}
    if name in ("3p1", "planar"):
        points = rng.uniform((-3.0, -2.0, 6.0), (3.0, 2.0, 14.0), (n, 3))
        turn = Rotation.from_rotvec([0.0, rng.uniform(-0.3, 0.3), 0.0]).as_matrix()
        move = rng.normal(size=3) * (1.0, 0.0 if name == "planar" else 1.0, 1.0)
        second = CAMERA.project(points @ turn.T + move / np.linalg.norm(move)) + NOISE * rng.normal(size=(n, 2))
        first = CAMERA.project(points) + NOISE * rng.normal(size=(n, 2))
        problem = (
            rm.PlanarMotion(CAMERA, axis=(0, 1, 0))
            if name == "planar"
            else rm.ThreePlusOne(CAMERA, axis=(0, 1, 0), axis2=(0, 1, 0))
        )
        target = shown_among_clutter(rng, second, n_target, *corners)
        return {"source": first, "target": target, "problem": problem, "noise": NOISE}
    points = points_in_a_ball(rng, n)
    turn = Rotation.random(random_state=rng) if name == "p3p" else Rotation.from_rotvec([0.0, rng.uniform(-3, 3), 0.0])
    R, t = turn.as_matrix(), np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(9.0, 12.0)])
    pixels = CAMERA.project(points @ R.T + t) + NOISE * rng.normal(size=(n, 2))
    problem = {
        "p3p": lambda: rm.P3P(CAMERA),
        "up2p": lambda: rm.UP2P(CAMERA, (0, 1, 0), (0, 1, 0)),
        "up2pf": lambda: rm.UP2PF((320, 240), (0, 1, 0), (0, 1, 0)),
    }
    target = shown_among_clutter(rng, pixels, n_target, *corners)
    return {"source": points, "target": target, "problem": problem[name](), "noise": NOISE, "R": R, "t": t}


# -- Features ---------------------------------------------------------------------------------------------------------


def normals(rng: np.random.Generator, made: Scene) -> dict[str, Any]:
    """Outward ones."""
    points = made["source"]
    return {"normals": points / np.linalg.norm(points, axis=1, keepdims=True)}


def candidates(rng: np.random.Generator, made: Scene) -> dict[str, Any]:
    """A mask, of few or of many pairs."""
    return {"candidates": rng.random((len(made["source"]), len(made["target"]))) < rng.choice([0.02, 0.1, 0.5, 0.9])}


def weights(rng: np.random.Generator, made: Scene) -> dict[str, Any]:
    """Prior weights of all pairs."""
    return {"candidates": rng.random((len(made["source"]), len(made["target"])))}


def bodies(rng: np.random.Generator, made: Scene) -> dict[str, Any]:
    """Two or three bodies of as many points."""
    count = min(int(rng.integers(2, 4)), len(made["source"]) // 4)
    return {"bodies": np.arange(len(made["source"])) % max(count, 1)}


def prior(rng: np.random.Generator, made: Scene) -> dict[str, Any]:
    """A prediction, as good as it says or a metre off."""
    spread = float(rng.choice([0.003, 0.03, 0.3]))
    off = float(rng.choice([1.0, 30.0]))
    error = off * spread * rng.normal(size=6) / np.sqrt(6.0)
    if isinstance(made["problem"], rm.UP2P):
        error[[0, 2]] = 0.0
    R = Rotation.from_rotvec(error[:3]).as_matrix() @ made["R"]
    return {"prior": rm.Pose(R, made["t"] + error[3:], spread**2 * np.eye(6))}


def rig(rng: np.random.Generator, made: Scene) -> dict[str, Any]:
    """Two cameras side by side; which of them shows a detection is drawn."""
    views = [(CAMERA, np.eye(3), np.zeros(3)), (CAMERA, np.eye(3), np.array([0.3, 0.0, 0.0]))]
    index = np.arange(len(made["target"])) % 2
    kind = type(made["problem"])
    return {"problem": kind(rm.Rig(views)), "target": (made["target"], index)}


def option(**options: Any) -> Feature:
    """Options that do not depend on the scene."""
    return lambda rng, made: options


PLAIN: dict[str, Feature] = {
    "": option(),
    "exhaustive": option(**{SAMPLER: "exhaustive"}),
    "random": option(**{SAMPLER: "random"}, samples=2_000_000),
    "candidates": candidates,
    "weights": weights,
    "motions 2": option(motions=2),
    "paper": option(preset="paper"),
    "solver": lambda rng, made: {"solver": str(rng.choice(sorted(SOLVERS)))},
    "normalised": option(residual="normalised"),
    "noises": lambda rng, made: {"noise": made["noise"] * rng.uniform(0.5, 2.0, len(made["target"]))},
}
"""Of every problem."""
SEARCHED: dict[str, Feature] = {"guided": option(**GUIDED)}
ABSOLUTE: dict[str, Feature] = {
    **SEARCHED,
    "motions auto": option(motions="auto"),
    "noise auto": option(noise="auto"),
    "completion": option(**{SAMPLER: Completion()}, motions=2),
    "normals": normals,
    "normals guided": lambda rng, made: normals(rng, made) | GUIDED,
    "normals bodies": lambda rng, made: normals(rng, made) | bodies(rng, made),
    "normals candidates": lambda rng, made: normals(rng, made) | candidates(rng, made),
    "detection": lambda rng, made: normals(rng, made) | {"view_angle": np.radians(70.0)},
    "prior": prior,
    "prior normals": lambda rng, made: prior(rng, made) | normals(rng, made),
    "bodies": bodies,
}
RIGS: dict[str, Feature] = {
    "rig": rig,
    "rig normals": lambda rng, made: rig(rng, made) | normals(rng, made),
    "rig prior": lambda rng, made: rig(rng, made) | prior(rng, made),
}
FEATURES: dict[str, dict[str, Feature]] = {
    "p3p": PLAIN | ABSOLUTE | RIGS,
    "up2p": PLAIN | ABSOLUTE,
    "3p1": PLAIN | SEARCHED | {"noise auto": option(noise="auto"), "bodies": bodies},
    "planar": PLAIN | SEARCHED,
    "up2pf": PLAIN | {"noise auto": option(noise="auto")},
    "similarity": PLAIN | SEARCHED | {"bodies": bodies},
    "rigid": PLAIN | SEARCHED | {"noise auto": option(noise="auto")},
}
COMBINATIONS = [(name, feature) for name in PROBLEMS for feature in FEATURES[name]]


def task(number: int) -> tuple[str, tuple[int, int], float, dict[str, Any]]:
    """What is done, points, seconds allowed, and the arguments of `rootmatch.match`."""
    rng = np.random.default_rng([SEED, number])
    name, feature = COMBINATIONS[number % len(COMBINATIONS)]
    n, n_target = np.exp(rng.uniform(np.log(6.0), np.log(MAX_POINTS), 2)).round().astype(int).tolist()
    seconds = float(rng.choice(LIMITS))
    made = scene(rng, name, n, n_target)
    arguments = {key: made[key] for key in ("source", "target", "problem", "noise")}
    return f"{name} {feature}".strip(), (n, n_target), seconds, arguments | FEATURES[name][feature](rng, made)


# -- Measuring --------------------------------------------------------------------------------------------------------


def bound(seconds: float) -> float:
    """Seconds that a match with this limit may take."""
    return 1.1 * seconds + 0.005


def use_processor_time() -> None:
    """Let deadlines, and this, go by the processor time of the process."""
    from rootmatch.deadline import Deadline

    matching: Any = import_module("rootmatch.api")
    matching.Deadline = lambda seconds, started: Deadline(seconds, clock=time.process_time)
    time.perf_counter = time.process_time


def worker() -> None:
    """A process that measures the tasks whose numbers it is given, a line each."""
    from numba.core import event
    from numba.core.dispatcher import Dispatcher

    count, before = [0], Dispatcher.add_overload

    class Compiling(event.Listener):
        """Tells that a kernel is being compiled, which takes its time."""

        def on_start(self, event: Any) -> None:
            print(json.dumps({"waiting": COMPILED}), flush=True)

        def on_end(self, event: Any) -> None:
            print(json.dumps({"waiting": PATIENCE}), flush=True)

    def counted(self: Any, result: Any) -> None:
        count[0] += 1
        print(json.dumps({"waiting": PATIENCE}), flush=True)
        before(self, result)

    event.register("numba:compile", Compiling())
    Dispatcher.add_overload = counted
    for line in sys.stdin:
        what, shape, seconds, arguments = task(int(line))
        row: dict[str, Any] = {"number": int(line), "what": what, "shape": shape, "seconds": seconds}
        print(json.dumps({"preparing": row}), flush=True)
        taken: list[float] = []
        compiled = 0
        try:
            # where a deadline cuts differs, and with it what is loaded: most of it is in a longer match
            print(json.dumps({"waiting": LONGER + PATIENCE}), flush=True)
            rm.match(**arguments, max_seconds=LONGER)
            while not taken or (min(taken) > bound(seconds) and len(taken) < TURNS):
                known, started = count[0], time.perf_counter()
                print(json.dumps({"waiting": seconds + PATIENCE}), flush=True)
                found = rm.match(**arguments, max_seconds=seconds)
                spent = time.perf_counter() - started
                if count[0] > known and compiled < COMPILING:
                    compiled += 1
                    continue
                taken.append(spent)
            row |= {"status": found.status.name, "stopped_early": found.stopped_early}
        except rm.RootmatchError as error:
            row["refused"] = str(error)
            for _ in range(2):  # the first time something may be imported
                started = time.perf_counter()
                with suppress(rm.RootmatchError):
                    rm.match(**arguments, max_seconds=seconds)
                taken.append(time.perf_counter() - started)
        print(json.dumps({"row": {**row, "taken": min(taken), "turns": len(taken)}}), flush=True)


def stacks(number: int) -> None:
    """What the main thread of a match does after its deadline, sampled each millisecond."""
    what, shape, seconds, arguments = task(number)
    for _ in range(2):  # all is compiled in the second turn
        seen: Counter[str] = Counter()
        ends, over = time.perf_counter() + seconds, threading.Event()
        thread = threading.Thread(target=_watched, args=(threading.get_ident(), ends, over, seen))
        thread.start()
        began = time.perf_counter()
        try:
            rm.match(**arguments, max_seconds=seconds)
        except rm.RootmatchError as error:
            print(error)
        taken = time.perf_counter() - began
        over.set()
        thread.join()
    print(f"{number} {what} {shape}: {taken:.3f} s of {seconds:g}")
    for place, count in seen.most_common(12):
        print(f"{count:6} {place}")


def signals(number: int, longest: float = 20.0) -> tuple[float, str]:
    """Longest time for which a match without a limit sees no signal, and where; in seconds of the processor.

    A timer interrupts each hundredth of a second, and ends the match after ``longest``. What Numba compiles or loads
    meanwhile does not count. Threads would hide it, so there is one.
    """
    import numba
    from numba.core.dispatcher import Dispatcher

    numba.set_num_threads(1)
    what, shape, _, arguments = task(number)
    ends = float("inf")
    seen, worst, compiled, before = [0.0], [(0.0, "")], [False], Dispatcher.add_overload

    def look(_signal: int, frame: types.FrameType | None) -> None:
        nonlocal ends
        now = time.process_time()
        gap, seen[0] = now - seen[0], now
        if compiled[0]:
            compiled[0] = False
        elif gap > worst[0][0]:
            inside = [one for one in traceback.extract_stack(frame) if "rootmatch" in one.filename]
            worst[0] = gap, " > ".join(f"{Path(one.filename).stem}.{one.name}:{one.lineno}" for one in inside[-6:])
        if now > ends:
            ends = float("inf")
            raise KeyboardInterrupt

    def loaded(self: Any, result: Any) -> None:
        compiled[0] = True
        before(self, result)

    Dispatcher.add_overload = loaded
    signal.signal(signal.SIGPROF, look)
    for _ in range(2):  # what is compiled first hides what it takes
        worst[0], seen[0] = (0.0, ""), time.process_time()
        ends = seen[0] + longest
        signal.setitimer(signal.ITIMER_PROF, 0.01, 0.01)
        with suppress(rm.RootmatchError, KeyboardInterrupt):
            rm.match(**arguments)
            ends = float("inf")
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    print(f"| {number} | {what} | {shape[0]} against {shape[1]} | {worst[0][0]:.3f} | {worst[0][1]} |", flush=True)
    return worst[0]


def _watched(thread: int, ends: float, over: threading.Event, seen: Counter[str]) -> None:
    """Count the stacks of a thread from some time on."""
    while not over.wait(0.001):
        if time.perf_counter() > ends and (frame := sys._current_frames().get(thread)) is not None:
            places = [
                f"{Path(one.filename).stem}.{one.name}:{one.lineno}" for one in traceback.extract_stack(frame)
                if "rootmatch" in one.filename
            ]  # fmt: skip
            seen[" > ".join(places[-7:])] += 1


def started(clock: str) -> subprocess.Popen[bytes]:
    """A process that measures."""
    command = [sys.executable, __file__, "work", "--clock", clock]
    environment = {**os.environ, "NUMBA_NUM_THREADS": "1"} if clock == "processor" else None
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, env=environment)


def answer(process: subprocess.Popen[bytes], patience: float, clock: str) -> bytes | None:
    """The next line of a process, empty at its end; None if it says nothing within so many seconds.

    Seconds of its own where other work has the processor too. Standard output has no buffer here: what lay in one would
    not be seen by `select`.
    """
    assert process.stdout is not None

    def now() -> float:
        return time.monotonic() if clock == "wall" else worked(process.pid)

    ends = now() + patience
    while not select.select([process.stdout], [], [], 0.2)[0]:
        if now() > ends:
            return None
    return process.stdout.readline()


def worked(pid: int) -> float:
    """Seconds of the processor that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measured(process: subprocess.Popen[bytes], number: int, clock: str) -> dict[str, Any]:
    """The row of a task; the process is killed where it does not answer."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(f"{number}\n".encode())
    row: dict[str, Any] = {}
    patience = COMPILED
    while True:
        line = answer(process, patience, clock)
        if line is None:
            process.kill()
            process.wait()
            return {**row, "taken": patience, "at_least": True}
        if not line:
            return {**row, "taken": -1.0, "died": process.wait()}
        told = json.loads(line)
        if "row" in told:
            found: dict[str, Any] = told["row"]
            return found
        patience = told.get("waiting", patience)
        row = told.get("preparing", row)


def run(path: Path, numbers: list[int], clock: str) -> None:
    """Measure what has no row yet."""
    known = {row["number"] for row in rows_of(path)}
    process = started(clock)
    try:
        for number in numbers:
            if number in known:
                continue
            if process.poll() is not None:
                process = started(clock)
            row = measured(process, number, clock)
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
            print(*cells_of(row), sep=" | ", file=sys.stderr, flush=True)
    finally:
        process.kill()
        process.wait()


# -- Report -----------------------------------------------------------------------------------------------------------


def rows_of(path: Path) -> list[dict[str, Any]]:
    """The last row of each task."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return list({row["number"]: row for row in map(json.loads, lines)}.values())


def late(row: dict[str, Any]) -> bool:
    """Whether a row is beyond the bound."""
    return "died" in row or row["taken"] > bound(row["seconds"])


def cells_of(row: dict[str, Any]) -> tuple[Any, ...]:
    """A row as the cells of a table."""
    n, n_target = row["shape"]
    much = "died" if "died" in row else ("≥ " if row.get("at_least") else "") + f"{row['taken']:.3f}"
    end = "refused" if "refused" in row else row.get("status", "")
    mark = "late" if late(row) else ""
    points = f"{n} against {n_target}"
    return row["number"], row["what"], points, f"{row['seconds']:g}", much, end, mark


def report(path: Path, worst: int) -> None:
    """The worst overruns."""
    rows = rows_of(path)
    print(f"{len(rows)} tasks, {sum(map(late, rows))} beyond the bound of a tenth and 5 ms\n")
    head("task", "problem, feature", "points", "limit (s)", "took (s)", "status", "")
    for one in sorted(rows, key=lambda one: -(one["taken"] - bound(one["seconds"])))[:worst]:
        row(*cells_of(one))


def main() -> None:
    ask = parser(__doc__, tasks=228, first=0, worst=30)
    ask.add_argument("command", choices=["run", "report", "stacks", "signals", "work"])
    ask.add_argument("rows", type=Path, nargs="?", help="where rows are kept")
    ask.add_argument("--only", type=int, nargs="*", help="numbers of tasks")
    ask.add_argument("--clock", choices=["wall", "processor"], default="wall")
    given = ask.parse_args()
    if given.clock == "processor" and given.command != "run":
        use_processor_time()
    if given.command == "work":
        worker()
    elif given.command == "stacks":
        for number in given.replace_points or []:
            stacks(number)
    elif given.command == "signals":
        for number in given.replace_points or range(given.first, given.first + given.tasks):
            signals(number)
    elif given.rows is None:
        ask.error("give the file of rows")
    elif given.command == "run":
        run(given.rows, given.replace_points or list(range(given.first, given.first + given.tasks)), given.clock)
    else:
        report(given.rows, given.worst)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
