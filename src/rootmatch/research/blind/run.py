"""Runs all methods on the scenes of blind PnP; what is there already is not run again."""

from __future__ import annotations

import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from rootmatch._version import __version__
from rootmatch.backends.strongest import Progress
from rootmatch.errors import InputError
from rootmatch.io import write_table
from rootmatch.research.blind.methods import Answer, Method, methods
from rootmatch.research.blind.scenes import BlindScene, outlier_scene, real_scenes, simulated_scenes
from rootmatch.research.output_files import make_folder
from rootmatch.research.real.leaderboard import Fields, append_row, read_rows

ROTATION, TRANSLATION = 0.1, 0.1
"""A pose is right within so many radians of the true rotation, and within this share of the true distance."""
PROTOCOLS = ("outliers", "surface", "real")
COLUMNS = (
    "scenes", "method", "count", "right", "right in percent", "median rotation error in degrees", "median seconds",
    "longest seconds", "vouched for", "vouched for and wrong",
)  # fmt: skip
MAX_SECONDS = 1e6
FIELDS: Fields = {
    **dict.fromkeys(("scene", "row", "method"), str),
    **dict.fromkeys(("right", "claimed"), bool),
    **dict.fromkeys(("degrees", "seconds"), (int, float)),
}
"""What the table reads of a row."""


def run_blind(
    output: Path,
    *,
    scenes: int = 20,
    first_seed: int = 20_000,
    seconds: float = 10.0,
    data: Path | None = None,
    peer: Path | None = None,
    only: list[str] | None = None,
    only_methods: list[str] | None = None,
    tiny: bool = False,
    progress: Progress | None = None,
) -> list[tuple[str, ...]]:
    """Measure methods on the protocols of blind PnP.

    Parameters
    ----------
    output : path
        Folder of ``rows.jsonl`` and the table ``blind.csv``; a run there resumes.
    scenes, first_seed : int
        Scenes of each row, and the seed of the first.
    seconds : float
        Of processor time that a method may take for a scene, as far as it can be told.
    data : path, optional
        Folder of the measured targets; without it the real protocol is left out.
    peer : path, optional
        A Python file with a further method (`rootmatch.research.blind.methods.load_peer`).
    only : list of str, optional
        Of ``"outliers"``, ``"surface"``, ``"real"``.
    only_methods : list of str, optional
        Names of methods, as in the table; by default all that can be run here.
    tiny : bool
        One easy scene of the first row: checks that everything runs.
    progress : callable, optional
        Called with (done, total).

    Returns
    -------
    list of tuple of str
        The table, its head first.

    Raises
    ------
    InputError
        If something of this cannot be used.
    """
    chosen = tuple(only or [name for name in PROTOCOLS if name != "real" or data is not None])
    every = methods(peer)
    compared = {name: every[name] for name in only_methods or every if name in every}
    for what, known, given in (("protocol", PROTOCOLS, chosen), ("method", every, only_methods or ())):
        unknown = [name for name in given if name not in known]
        if unknown:
            raise InputError(f"{what}: {', '.join(unknown)} given; give one of {', '.join(known)}")
    if "real" in chosen and data is None:
        raise InputError("protocol: real needs --data, the folder of the measured targets")
    if scenes < 1 or first_seed < 0 or not 0.0 < seconds <= MAX_SECONDS:
        raise InputError(
            f"{scenes} scenes from seed {first_seed} with {seconds:g} s each: give at least one scene, a seed of at "
            "least 0 and a number of seconds above 0"
        )
    seeds = range(first_seed, first_seed + scenes)
    if tiny:
        to_run = [outlier_scene(0.0, 0.0, first_seed)]
    else:
        to_run = list(simulated_scenes(seeds, chosen))
        if "real" in chosen and data is not None:
            to_run += real_scenes(data, scenes)
    make_folder(output)
    path = output / "rows.jsonl"
    there = {(row["scene"], row["method"]) for row in read_rows(path, FIELDS)}
    _measure(to_run, compared, path, there=there, seconds=seconds, progress=progress)
    table = [COLUMNS, *_summary(read_rows(path, FIELDS))]
    write_table(output / "blind.csv", COLUMNS, table[1:])
    return table


def _measure(
    to_run: list[BlindScene],
    compared: dict[str, Method],
    path: Path,
    *,
    there: set[tuple[Any, Any]],
    seconds: float,
    progress: Progress | None,
) -> None:
    """Run what is missing and append its rows."""
    done, total = 0, len(to_run) * len(compared)
    for name, method in compared.items():
        warm: set[str] = set()
        for scene in to_run:
            label = f"{scene.name}/{scene.seed}"
            if (label, name) not in there:
                if scene.name not in warm:
                    method(scene, seconds)  # what is compiled or loaded once is not timed
                    warm.add(scene.name)
                started = time.process_time()
                answer = method(scene, seconds)
                took = time.process_time() - started
                append_row(
                    path, {"scene": label, "row": scene.name, "method": name, **judge_answer(scene, answer, took)}
                )
            done += 1
            if progress is not None:
                progress(done, total)


def judge_answer(scene: BlindScene, answer: Answer, seconds: float) -> dict[str, Any]:
    """The errors of an answer and whether it is right."""
    angle, shift = np.pi, np.inf
    if answer.pose is not None and all(np.isfinite(part).all() for part in answer.pose):
        R, t = answer.pose
        angle = float(np.arccos(np.clip((np.trace(R.T @ scene.R) - 1.0) / 2.0, -1.0, 1.0)))
        centre, true_centre = -R.T @ t, -scene.R.T @ scene.t
        shift = float(np.linalg.norm(centre - true_centre) / np.linalg.norm(scene.t))
    return {
        "right": bool(angle < ROTATION and shift < TRANSLATION),
        "degrees": float(np.degrees(angle)),
        "shift": shift if np.isfinite(shift) else None,
        "claimed": answer.claimed,
        "seconds": seconds,
        "version": __version__,
    }


def _summary(rows: Iterable[dict[str, Any]]) -> list[tuple[str, ...]]:
    """One line a row of the protocols and method."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["row"], row["method"]), []).append(row)
    lines: list[tuple[str, ...]] = []
    for (name, method), found in groups.items():
        right, times = sum(row["right"] for row in found), [row["seconds"] for row in found]
        claimed = [row for row in found if row["claimed"]]
        cells = (
            f"{100.0 * right / len(found):.0f}",
            f"{np.median([row['degrees'] for row in found]):.2f}",
            f"{np.median(times):.3f}",
            f"{max(times):.3f}",
            str(len(claimed)),
            str(sum(not row["right"] for row in claimed)),
        )
        lines.append((name, method, str(len(found)), str(right), *cells))
    return lines
