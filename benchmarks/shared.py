"""What benchmarks share: options, tables, scenes and data from elsewhere, and how a match is held against the truth."""

from __future__ import annotations

import argparse
import importlib.util
import math
import os
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm

Floats, Integers = NDArray[np.float64], NDArray[np.int64]
BESIDE = Path(__file__).resolve().parents[2] / "shared"
"""Where data and scenes are looked for, if no environment variable names their folder."""
LISTED = 5
"""Alternatives among which the truth must be where the answer is ambiguous."""
WITHIN = 0.03
"""Of the mean told the share that is right is to be, or else the mean in its interval."""


def parser(text: str | None, **numbers: int) -> argparse.ArgumentParser:
    """A parser with the docstring of a script, and whole numbers with their defaults: ``seeds=20`` for ``--seeds``."""
    made = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in numbers.items():
        made.add_argument(f"--{name.replace('_', '-')}", type=int, default=default, help=f"default: {default}")
    return made


def head(*cells: str) -> None:
    """Print the head of a table in Markdown."""
    print(f"| {' | '.join(cells)} |\n|{'---|' * len(cells)}", flush=True)


def row(*cells: object) -> None:
    """Print a row of a table in Markdown."""
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


@dataclass
class Calibration:
    """What was told with some probability, whether it was so, and of which scene."""

    told: list[float] = field(default_factory=list)
    held: list[bool] = field(default_factory=list)
    scene: list[int] = field(default_factory=list)

    def add(self, told: Iterable[tuple[float, bool]]) -> None:
        """Add what was told of one scene, and whether it was so."""
        scene = self.scene[-1] + 1 if self.scene else 0
        for probability, held in told:
            self.told.append(probability)
            self.held.append(held)
            self.scene.append(scene)

    def print(self, name: str) -> None:
        """Print a table of the tenths that are not empty; none at all where nothing was told."""
        if not self.told:
            return
        print()
        head(f"{name} from", "number", "scenes", "told", "right", "95 % interval", "holds")
        told, held, scene = np.array(self.told), np.array(self.held), np.array(self.scene)
        place = np.minimum((told * 10).astype(int), 9)
        for k in np.unique(place).tolist():
            own = place == k
            mean, share = float(told[own].mean()), float(held[own].mean())
            counts = np.unique(scene[own], return_counts=True)[1]
            low, high = interval(share, effective(counts))
            holds = "yes" if abs(share - mean) <= WITHIN or low <= mean <= high else "no"
            bounds = f"{low:.3f} – {high:.3f}"
            row(f"{k / 10:.1f}", int(own.sum()), len(counts), f"{mean:.3f}", f"{share:.3f}", bounds, holds)


def interval(share: float, count: float) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927); ``count`` may be effective, see `effective`."""
    z = 1.96
    middle = (share * count + z * z / 2) / (count + z * z)
    half = z / (count + z * z) * math.sqrt(share * (1.0 - share) * count + z * z / 4)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def effective(counts: Integers) -> float:
    """As many independent points as groups of so many tell that are right or wrong together (Kish 1965)."""
    return float(counts.sum() ** 2 / (counts**2).sum())


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """Result and processor seconds of a call."""
    started = time.process_time()
    result = work()
    return result, time.process_time() - started


def module_at(path: Path) -> ModuleType:
    """The module of a file outside of this repository."""
    name = f"{path.stem}_of_{path.parent.name}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # its compiled kernels, when read from the cache, ask for it by name
    spec.loader.exec_module(module)
    return module


def scenes_of(name: str, given: str | None) -> ModuleType | None:
    """A module of scenes, which are no part of this repository, or None where there is none.

    It is looked for in the folder given, in ROOTMATCH_SCENES, and in ``scenes`` beside the measured data.
    """
    data = os.environ.get("ROOTMATCH_DATA")
    beside = Path(data).parent if data else BESIDE
    path = Path(given or os.environ.get("ROOTMATCH_SCENES") or beside / "scenes") / f"{name}.py"
    if not path.exists():
        print(f"no scenes: no file {path}; name its folder by --scenes or ROOTMATCH_SCENES", file=sys.stderr)
        return None
    return module_at(path)


def yardstick_of(folder: str | None) -> ModuleType | None:
    """The module ``ransac.py`` of a folder, else of ROOTMATCH_PEERS, or None if there is none."""
    path = Path(folder or os.environ.get("ROOTMATCH_PEERS", ""), "ransac.py")
    if not (folder or "ROOTMATCH_PEERS" in os.environ) or not path.is_file():
        print("no yardstick: name its folder by --peers or ROOTMATCH_PEERS", file=sys.stderr)
        return None
    return module_at(path)


@cache
def measured_data(name: str) -> dict[str, NDArray[Any]]:
    """Arrays of one file of measured correspondences; folder: ROOTMATCH_DATA, or shared/data next to the checkout."""
    with np.load(Path(os.environ.get("ROOTMATCH_DATA") or BESIDE / "data", f"{name}.npz"), allow_pickle=False) as file:
        return dict(file)


def judge(assignment: Integers, truth: Integers) -> tuple[int, int, bool]:
    """Right and wrong matches, and whether none is wrong and nine tenths of the visible are right."""
    claimed = assignment >= 0
    right = int((assignment[claimed] == truth[claimed]).sum())
    wrong = int(claimed.sum()) - right
    return right, wrong, wrong == 0 and right >= 0.9 * int((truth >= 0).sum()) - 1e-9


def is_listed(match: rm.Match, truth: Integers) -> bool:
    """Whether a match is right, or ambiguous with the truth among its first alternatives."""
    others = [other for other, _ in match.alternatives[:LISTED]] if match.status is rm.Status.AMBIGUOUS else []
    return any(judge(one, truth)[2] for one in (match.assignment, *others))


def squared_error(pose: rm.Pose, R: Floats, t: Floats, scale: float = 1.0) -> float:
    """Squared deviation of a pose from the true one over its covariance, which has full rank (NEES)."""
    assert pose.covariance is not None
    turn = R @ pose.R.T
    angles = Rotation.from_matrix(turn).as_rotvec() if len(R) == 3 else [np.arctan2(turn[1, 0], turn[0, 0])]
    off = np.array([*angles, *(t - pose.t), scale - pose.scale])
    off = off[: len(pose.covariance)]
    return float(off @ np.linalg.solve(pose.covariance, off))
