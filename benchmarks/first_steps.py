"""The first steps of a newcomer, timed on a machine that has Python, make and git: from a clone, and from a wheel.

    python3 benchmarks/first_steps.py /path/of/a/clone --folder NEW --csv benchmarks/results/first_steps.csv

Clones the repository, runs ``make demo``, matches points and a calibration file that the script writes as a user would
have them, builds a wheel, and installs it into a new environment. Needs the standard library alone, and the network for
pip. A step that fails, or a wrong match, ends it with the output of that step. Processor time is of all cores together.
"""

from __future__ import annotations

import argparse
import csv
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

MODEL = """id,x,y,z
top,0,0,0
left,120,10,0
right,20,90,30
low,100,80,-40
back,50,-70,50
rim,-40,60,20
"""
"""LEDs in millimetres, as a drawing has them."""
IMAGE = """x,y
383.34,165.26
120.00,80.50
336.31,246.68
276.35,302.55
441.15,354.89
501.20,402.90
458.27,267.95
331.85,333.18
"""
TRUTH = {"back": "0", "top": "2", "rim": "3", "low": "4", "left": "6", "right": "7"}
"""What a detector found: the LEDs in no order, projected by OpenCV with noise of 0.25 pixels, and two reflections."""
CALIBRATION = """%YAML:1.0
---
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 812., 0., 330., 0., 810., 245., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.21, 0.05, 0., 0., 0. ]
"""
"""As `cv2.FileStorage` writes what `cv2.calibrateCamera` returns."""
MATCH = "match leds.csv dots.csv --problem p3p --camera left.yaml --noise 0.3 --output matches.csv --poses poses.csv"


def processor_time() -> float:
    """Seconds that all processes ended so far have used."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def figure(seconds: float) -> str:
    """A time to two digits."""
    return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"


class Steps:
    """Runs commands as a user with an empty home would, and keeps their times."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.rows = folder, list[tuple[str, float, float]]()
        kept = ("PATH", "LANG", "PIP_CERT", "PIP_FIND_LINKS", "PIP_EXTRA_INDEX_URL")
        self.environment = {name: os.environ[name] for name in kept if name in os.environ}
        self.environment |= {"HOME": str(folder / "home"), "PIP_NO_CACHE_DIR": "1"}
        (folder / "home").mkdir(parents=True)

    def run(self, what: str, command: str, where: str = ".") -> str:
        """Run and time a command; returns what it printed."""
        started, before = time.perf_counter(), processor_time()
        done = subprocess.run(
            command, shell=True, cwd=self.folder / where, env=self.environment, text=True, check=False,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        seconds, used = time.perf_counter() - started, processor_time() - before
        print(f"{seconds:7.1f} s, {used:7.1f} s of processor time  {what}", flush=True)
        if done.returncode:
            sys.exit(f"{command}\n{done.stdout}")
        self.rows.append((what, seconds, used))
        return done.stdout

    def matched(self, what: str, rootmatch: str) -> None:
        """Match the user's own files and compare with what is known of them."""
        self.run(what, f"{rootmatch} {MATCH}", "own")
        with (self.folder / "own" / "matches.csv").open(newline="", encoding="utf-8") as file:
            found = {row["source"]: row["target"] for row in csv.DictReader(file)}
        if found != TRUTH:
            sys.exit(f"wrong: {found}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("repository", help="what git clones")
    parser.add_argument("--folder", type=Path, required=True, help="a new folder for everything")
    parser.add_argument("--csv", type=Path, help="file for the times")
    options = parser.parse_args()
    folder = options.folder.resolve()
    steps = Steps(folder)
    own = folder / "own"
    own.mkdir()
    for name, text in (("leds.csv", MODEL), ("dots.csv", IMAGE), ("left.yaml", CALIBRATION)):
        (own / name).write_text(text, encoding="utf-8")

    steps.run("clone", f"git clone -q {options.repository} rootmatch")
    shown = steps.run("`make demo`: environment, kernels, match, picture", "make demo", "rootmatch")
    if "14 of 14 right" not in shown:
        sys.exit(shown)
    clone = folder / "rootmatch" / ".venv" / "bin"
    steps.environment["NUMBA_CACHE_DIR"] = str(clone.parent / "numba-cache")
    steps.matched("own CSV files and OpenCV calibration", str(clone / "rootmatch"))
    steps.environment["ROOTMATCH_PREBUILD"] = "1"
    del steps.environment["NUMBA_CACHE_DIR"]
    steps.run("build a wheel, kernels included", f"{clone}/python -m pip wheel -q --no-deps -w ../dist .", "rootmatch")
    steps.run("a new environment", f"{sys.executable} -m venv fresh")
    steps.run("`pip install` of the wheel", "fresh/bin/python -m pip install -q dist/*.whl")
    steps.matched("the same files, first match", str(folder / "fresh/bin/rootmatch"))
    steps.matched("the same files, next match", str(folder / "fresh/bin/rootmatch"))
    if options.csv:
        with options.csv.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["step", "wall-clock time", "processor time"])
            writer.writerows([what, figure(seconds), figure(used)] for what, seconds, used in steps.rows)


if __name__ == "__main__":
    main()
