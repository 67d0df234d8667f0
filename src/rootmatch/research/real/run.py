"""Run methods on all scenes; what is there already is not run again."""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from rootmatch._version import __version__
from rootmatch.backends.strongest import Progress
from rootmatch.errors import InputError, quote_value
from rootmatch.research.output_files import make_folder
from rootmatch.research.real.leaderboard import append_row, read_rows, rows_file, write_leaderboard
from rootmatch.research.real.program import Program
from rootmatch.research.real.scenes import RealScene, all_scenes

START_UP = 120.0
"""Seconds that the first reply may take at least: compiling included."""
MAX_SECONDS = 1e6

MAX_OF_ERROR = 200
"""Characters of a method's own words that are kept."""
LARGEST_SECONDS = 1e9
FULL = 0.9
"""Share of the visible points that a full match finds, with none wrong."""
MIN_OF_INSTANCE = 12
"""Right pairs of an instance from which it is found: four times what a pose takes."""


def run_real(
    data: Path,
    output: Path,
    methods: list[str],
    *,
    only: list[str] | None = None,
    timeout: float = 60.0,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Measure methods on measured targets.

    Parameters
    ----------
    data : path
        Folder of the .npz files.
    output : path
        Folder for rows and leaderboard, made where it is absent. Rows that are there are kept: a run resumes.
    methods : list of str
        "rootmatch", "rootmatch-paper", or command lines of programs that answer a line of JSON by a line of JSON (see
        `rootmatch.research.real.methods`).
    only : list of str, optional
        Names of protocols.
    timeout : float
        Seconds a reply may take; later counts as none. The first reply to each protocol may take two minutes where
        that is longer, and its scene is asked again, so that compiling is not timed.
    progress : callable, optional
        Called with (done, total).

    Returns
    -------
    list of dict
        The leaderboard, one entry a method and protocol.

    Raises
    ------
    InputError
        If data, folder or methods cannot be used.
    """
    if not 0.0 < timeout <= MAX_SECONDS:
        raise InputError(f"timeout: {timeout:g} given; give a number of seconds above 0, a finite one")
    programs = {method: Program(method, max(START_UP, timeout)) for method in methods}  # refuses what is no command
    scenes = list(all_scenes(data, only))
    make_folder(output)
    done, total = 0, len(scenes) * len(programs)
    for method, to_run in programs.items():
        path = rows_file(output, method)
        there = {row["scene"] for row in read_rows(path)}
        done += sum(scene.name in there for scene in scenes)
        with closing(to_run) as program:
            warm: set[str] = set()
            for scene in scenes:
                if scene.name in there:
                    continue
                if scene.protocol not in warm:
                    program.ask(scene.request, program.start_up)  # compiles what this kind of scene needs
                    warm.add(scene.protocol)
                told = judge_reply(scene, program.ask(scene.request, timeout))
                made = {"method": method, "version": __version__, "measured": time.strftime("%Y-%m-%d")}
                append_row(path, made | told)
                done += 1
                if progress is not None:
                    progress(done, total)
    return write_leaderboard(output)


def judge_reply(scene: RealScene, reply: dict[str, Any]) -> dict[str, Any]:
    """Figures of a reply, as JSON can hold them."""
    error = None
    if reply.get("error") is not None:
        error = str(reply["error"])[:MAX_OF_ERROR] or "an error without words"
    seconds = _seconds(reply.get("seconds", reply["wall"]))
    if error is None and seconds is None:
        error = f"seconds: {quote_value(reply['seconds'])}, which is no time"
    found = _assignment(scene, reply.get("assignment")) if error is None else None
    if found is None:
        error = error or "assignment: of another length, or an index out of range or used twice"
        found = np.full(len(scene.request["source"]), -1, np.int64)
    right, wrong, visible = _counts(scene, found)
    return {
        "scene": scene.name,
        "protocol": scene.protocol,
        "right": right,
        "wrong": wrong,
        "visible": visible,
        "full": wrong == 0 and right >= FULL * visible,
        "claimed": bool(reply.get("matched", found.max(initial=-1) >= 0)) and not error,
        "misled": wrong > (1.0 - FULL) * (right + wrong),
        "seconds": float(reply["wall"]) if seconds is None else seconds,
        "wall": float(reply["wall"]),
        "error": error,
    }


def _seconds(given: Any) -> float | None:
    """The time that a method says it took, or None if it is none."""
    if isinstance(given, bool) or not isinstance(given, int | float) or not 0.0 <= given <= LARGEST_SECONDS:
        return None
    return float(given)


def _assignment(scene: RealScene, given: Any) -> Any:
    """The assignment as an array, or None if it is none."""
    try:
        found = np.array(given, dtype=np.int64)
    except (TypeError, ValueError, OverflowError):
        return None
    n, n_target = len(scene.request["source"]), len(scene.request["target"])
    if found.shape != (n,) or found.min(initial=0) < -1 or found.max(initial=-1) >= n_target:
        return None
    used = found[found >= 0]
    return found if len(np.unique(used)) == len(used) else None


def _counts(scene: RealScene, found: Any) -> tuple[int, int, int]:
    """Right, wrong and visible: of points, or of instances where these are what is looked for."""
    if scene.truth is not None:
        truth = scene.truth
        right = int(((found == truth) & (truth >= 0)).sum())
        return right, int(((found >= 0) & (found != truth)).sum()), int((truth >= 0).sum())
    pairs = np.array(scene.request["candidates"])
    chosen = found[pairs[:, 0]] == pairs[:, 1]
    instances = scene.instances or []
    seen = sum(int((chosen & instance).sum()) >= MIN_OF_INSTANCE for instance in instances)
    stray = int((chosen & ~np.any(instances, axis=0)).sum())
    return seen, int(stray > (1.0 - FULL) * chosen.sum()), len(instances)
