"""How long the start takes: help, a bad file, an import, a first match and the next, each in a process of its own.

    python benchmarks/start.py                                                  # this interpreter's installation
    python benchmarks/start.py wheel=.venv-wheel/bin/python clone=.venv/bin/python --runs 10

Every round begins with ``python -c "import numba"``, and figures are ratios to it in the same round, by processor time
(user and system, of children too) and by the clock: a machine's load moves both alike. Medians over the rounds. A first
match has an empty kernel cache; one that compiles, which takes more than ten seconds, is run once.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

IMPORTED = {
    "import numba": "import numba",
    "import numba, rootmatch": "import numba, rootmatch",
    "... and all that match() needs": "import numba, rootmatch.api",
}
COMPILES = 10.0
"""Seconds of processor time beyond which a first match is taken to compile."""


class Place:
    """An interpreter that has rootmatch, and a folder for its files."""

    def __init__(self, python: str, folder: Path) -> None:
        self.python, self.folder = str(Path(python).absolute()), folder
        folder.mkdir()
        self.times = 0
        self.run("-m", "rootmatch", *self.simulating("scene"))
        scene = str(folder / "scene")
        self.match = ["-m", "rootmatch", "match", f"{scene}/model.csv", f"{scene}/image.csv", "--problem", "p3p"]
        self.match += ["--camera", f"{scene}/camera.json", "--noise", "0.5"]

    def simulating(self, name: str) -> list[str]:
        """Arguments of a simulation."""
        return ["simulate", "p3p", "--points", "10", "--noise", "0.5", "--force", "--output", str(self.folder / name)]

    def run(self, *arguments: str, cache: str = "full", expected: int = 0) -> tuple[float, float]:
        """Processor time and clock of one process."""
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(self.folder / cache)}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        done = subprocess.run([self.python, *arguments], env=environment, capture_output=True, text=True, check=False)
        clock, after = time.perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode != expected:
            sys.exit(done.stderr)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, clock

    def first(self) -> tuple[float, float]:
        """A first match."""
        self.times += 1
        return self.run(*self.match, cache=f"empty-{self.times}")

    def cases(self) -> dict[str, Callable[[], tuple[float, float]]]:
        """What is timed, the measure first."""
        found: dict[str, Callable[[], tuple[float, float]]] = {
            name: lambda code=code: self.run("-c", code)  # type: ignore[misc]
            for name, code in IMPORTED.items()
        }
        found["rootmatch --help"] = lambda: self.run("-m", "rootmatch", "--help")
        found["rootmatch match --help"] = lambda: self.run("-m", "rootmatch", "match", "--help")
        found["rootmatch simulate"] = lambda: self.run("-m", "rootmatch", *self.simulating("other"))
        absent = [word.replace("image.csv", "absent.csv") for word in self.match]
        found["rootmatch match, no such file"] = lambda: self.run(*absent, expected=2)
        found["rootmatch match, ten points, empty cache"] = self.first
        found["rootmatch match, ten points, next"] = lambda: self.run(*self.match)
        return found


def measured(place: Place, runs: int) -> dict[str, list[tuple[float, float]]]:
    """Processor time and clock of each case in each round."""
    place.run(*place.match)  # fills the cache, where it takes one
    found: dict[str, list[tuple[float, float]]] = {}
    for _ in range(runs):
        for name, timed in place.cases().items():
            earlier = found.setdefault(name, [])
            compiles = timed == place.first and earlier and earlier[0][0] > COMPILES
            earlier.append(earlier[0] if compiles else timed())
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="*", default=[f"here={sys.executable}"], metavar="NAME=PYTHON")
    parser.add_argument("--runs", type=int, default=10)
    given = parser.parse_args()
    print(f"{given.runs} rounds, load {os.getloadavg()[0]:.1f}, {os.cpu_count()} cores")
    for place in given.places:
        name, _, python = place.partition("=")
        with tempfile.TemporaryDirectory() as folder:
            rows = measured(Place(python, Path(folder) / "start"), given.runs)
        unit = rows["import numba"]
        print(f"\n{name:40} {'ratio':>7} {'s':>7}   {'clock':>7} {'s':>7}")
        for what, times in rows.items():
            cells = []
            for side in (0, 1):
                ratio = statistics.median(one[side] / base[side] for one, base in zip(times, unit, strict=True))
                cells.append(f"{ratio:7.2f} {statistics.median(one[side] for one in times):7.2f}")
            print(f"{what:40} {'   '.join(cells)}")


if __name__ == "__main__":
    main()
