"""Run methods on all scenes; what is there already is not run again."""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path
from typing import Any

from rootmatch._version import __version__
from rootmatch.backends.strongest import Progress
from rootmatch.errors import InputError
from rootmatch.research.output_files import make_folder
from rootmatch.research.real.judge import judge_reply
from rootmatch.research.real.leaderboard import append_row, read_rows, rows_file, write_leaderboard
from rootmatch.research.real.program import Program
from rootmatch.research.real.scenes import RealScene, all_scenes

START_UP = 120.0
"""Seconds that the first reply may take at least: compiling included."""
MOST_SECONDS = 1e6


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
    if not 0.0 < timeout <= MOST_SECONDS:
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
                append_row(path, _row(method, scene, program, timeout))
                done += 1
                if progress is not None:
                    progress(done, total)
    return write_leaderboard(output)


def _row(method: str, scene: RealScene, program: Program, timeout: float) -> dict[str, Any]:
    reply = program.ask(scene.request, timeout)
    return {
        "method": method,
        "version": __version__,
        "measured": time.strftime("%Y-%m-%d"),
        **judge_reply(scene, reply),
    }
