"""What each use of Numba's insides is worth, in turns with and without.

    python benchmarks/insides.py borrowed --turns 5    # sweeps, whose drivers count no references
    python benchmarks/insides.py internal --turns 3    # a first match; jitted functions have no entries for Python
    python benchmarks/insides.py calls --turns 3       # ... kernels are called without a function in between

    python benchmarks/insides.py native --turns 5      # kernels for this very processor, not those of a wheel

Each turn is a process of its own. "Without" is what `rootmatch.jit` does where Numba lacks the inside. Times of sweeps
are nanoseconds for each hyper-edge on one thread; those of first matches are seconds of processor time (user and
system, of children too) and by the clock. Medians, and the median of the turns' ratios without / with.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from rootmatch.jit.prebuilt import GENERIC, architecture

GONE = {
    "borrowed": ("numba.core", "datamodel"),
    "internal": ("numba.core.registry", "CPUDispatcher"),
    "calls": ("numba.core.typing.templates", "AbstractTemplate"),
}
"""What is imported from where by the part of `rootmatch.jit` of that name, and by no other."""

SWEPT = ("borrowed", "native")
"""What is measured by sweeps, not by a first match."""


def hide(module: str, name: str) -> None:
    """Let rootmatch, but not Numba itself, find that name no more."""
    import builtins
    import warnings

    original = builtins.__import__

    def importing(target: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0) -> Any:
        asks = str((globals or {}).get("__name__"))
        if target == module and name in (fromlist or ()) and asks.startswith("rootmatch."):
            raise ImportError(f"{module}.{name} is hidden")
        return original(target, globals, locals, fromlist, level)

    builtins.__import__ = importing
    warnings.simplefilter("ignore", RuntimeWarning)


def sweeps() -> dict[str, float]:
    """Processor nanoseconds for each hyper-edge of a sweep, the least of fifteen."""
    from rootmatch.backends import cpu
    from rootmatch.backends.strongest import Enumeration
    from rootmatch.hypergraph.affinity import KINDS
    from rootmatch.simulation import p3p_scene, three_plus_one_scene, up2p_scene

    scenes = {
        "P3P": p3p_scene(10, 4, 1.0, 1),
        "up2p": up2p_scene(20, 4, 1.0, 1),
        "3P1": three_plus_one_scene(10, 0, 1.0, 1),
    }
    found = {}
    for problem, kind in (("P3P", "joint"), ("up2p", "joint"), ("P3P", "qr"), ("3P1", "qr")):
        scene = scenes[problem]
        tables = scene.problem.prepare(scene.source, scene.target, 1.0)
        shape = len(scene.source), len(scene.target)
        work = Enumeration.of(tables, KINDS[kind](), shape, scene.problem.order, None)
        slabs = min(work.ranks, max(64, 3_000_000 // work.per_slab))
        times = []
        for _ in range(16):
            started = time.process_time()
            cpu.strongest(work, 0, slabs, 3.5, 10**7)
            times.append(time.process_time() - started)
        found[f"{problem} {kind}"] = 1e9 * min(times[1:]) / (slabs * work.per_slab)
    return found


def searches() -> dict[str, float]:
    """Processor nanoseconds of guided matches, the least of fifteen."""
    import rootmatch as rm
    from rootmatch.simulation import p3p_scene, up2p_scene

    found = {}
    for name, scene in (("P3P", p3p_scene(20, 20, 1.0, 1)), ("up2p", up2p_scene(40, 40, 1.0, 1))):
        times = []
        for _ in range(16):
            started = time.process_time()
            rm.match(scene.source, scene.target, scene.problem, noise=1.0, sampler="guided")
            times.append(time.process_time() - started)
        found[f"{name} guided match"] = 1e9 * min(times[1:])
    return found


def child(what: str, without: bool) -> None:
    """The work of one process."""
    if without and what in GONE:
        hide(*GONE[what])
    if what in SWEPT:
        print(json.dumps({**sweeps(), **(searches() if what == "native" else {})}))
        return
    import rootmatch as rm
    from rootmatch.simulation import p3p_scene

    scene = p3p_scene(10, 5, 1.0, 1)
    rm.match(scene.source, scene.target, scene.problem, noise=1.0)


def measured(what: str, without: bool, folder: Path) -> dict[str, float]:
    """One process: seconds by what was done."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    program = [sys.executable, __file__, what, "--child", *(["--without"] if without else [])]
    if what in SWEPT:
        environment["NUMBA_NUM_THREADS"] = "1"
    if what == "native" and without:
        environment |= {"NUMBA_CPU_NAME": GENERIC[architecture()][0], "NUMBA_CPU_FEATURES": ""}
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(done.stderr)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if what in SWEPT:
        found: dict[str, float] = json.loads(done.stdout)
        return found
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"processor time": spent, "clock": time.perf_counter() - started}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=[*GONE, "native"])
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--without", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        child(given.what, given.without)
        return
    rows: dict[str, list[tuple[float, float]]] = {}
    with tempfile.TemporaryDirectory() as base:
        for turn in range(given.turns):
            both = []
            for without in (False, True):
                # sweeps are timed when all is compiled; a first match begins with nothing
                folder = Path(base, str(without), "" if given.what in SWEPT else str(turn))
                folder.mkdir(parents=True, exist_ok=True)
                both.append(measured(given.what, without, folder))
            for name in both[0]:
                rows.setdefault(name, []).append((both[0][name], both[1][name]))
            print(turn, {name: [round(x, 4) for x in pairs[-1]] for name, pairs in rows.items()}, file=sys.stderr)
    for name, pairs in rows.items():
        here, there = (statistics.median(side) for side in zip(*pairs, strict=True))
        ratio = statistics.median(b / a for a, b in pairs)
        unit = "ns" if given.what in SWEPT else "s"
        load = os.getloadavg()[0]
        print(f"{name}: {here:.3g} {unit} with, {there:.3g} {unit} without, {ratio:.2f} times; load {load:.1f}")


if __name__ == "__main__":
    main()
