"""Poses and matches of many frames, written as they come and continued where a run stopped."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from rootmatch.errors import InputError

if TYPE_CHECKING:
    from rootmatch.io.point_files import PointSet
    from rootmatch.problems.pose_fit.pose import Pose
    from rootmatch.result import Match

POSE_COLUMNS = ("frame", "body", "status", "probability", "matched", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
AXES = ("rx", "ry", "rz", "tx", "ty", "tz")
COVARIANCES = tuple(f"cov_{AXES[a]}_{AXES[b]}" for a in range(6) for b in range(a, 6))
MATCH_COLUMNS = ("frame", "source", "target", "weight", "motion")


def pose_rows(frame: int, match: Match) -> list[list[Any]]:
    """A row for each body of a frame: its status, and its pose where it is known."""
    each: list[tuple[Any, Match]] = [("", match)] if match.bodies is None else list(match.bodies.items())
    rows = []
    for label, one in each:
        pose = _pose(one)
        cells = ["" for _ in range(7 + len(COVARIANCES))] if pose is None else _cells(pose)
        probability = "" if one.finding.probability is None else float(one.finding.probability)
        rows.append([frame, label, one.status.name.lower(), probability, int((one.assignment >= 0).sum()), *cells])
    return rows


def match_rows(frame: int, match: Match, source: PointSet) -> list[list[Any]]:
    """A row for each match of a frame, ``target`` counting its detections from 0; one without any, where none is."""
    weights = match.soft_assignment[np.arange(len(match.assignment)), match.assignment]
    found = [
        [frame, source.names[i], j, float(weights[i]), int(match.motion_labels[i])]
        for i, j in enumerate(match.assignment.tolist())
        if j >= 0
    ]
    return found or [[frame, "", "", "", ""]]


class Appended:
    """A CSV file that is written as results come; what an earlier run wrote is kept.

    Parameters
    ----------
    path : path
    header : sequence of str
    resume : bool
        Whether to continue a file that is there; refuse it otherwise.
    """

    def __init__(self, path: Path, header: Sequence[str], resume: bool) -> None:
        self.path, self.header = path, list(header)
        self.done: set[int] = set()
        old = path.exists() and path.stat().st_size > 0
        if old and not resume:
            raise InputError(f"{path}: it is there already; remove it, or add --resume to continue it")
        if old:
            self._keep_whole()
        self.stream: TextIO = path.open("a", encoding="utf-8", newline="")
        self.writer = csv.writer(self.stream, lineterminator="\n")
        if not old:
            self.writer.writerow(self.header)

    def _keep_whole(self) -> None:
        """Keep the frames that were written as a whole: all but a last line that was cut short."""
        text = self.path.read_text(encoding="utf-8")
        lines = text.splitlines()
        if not lines or lines[0] != ",".join(self.header):
            raise InputError(f"{self.path}: its header is not {','.join(self.header[:4])}…; give another file")
        if not text.endswith("\n"):
            cut = lines.pop().partition(",")[0]
            lines = [line for line in lines if line.partition(",")[0] != cut]
        self.done = {int(line.partition(",")[0]) for line in lines[1:]}
        self.path.write_text("\n".join(lines) + "\n", encoding="utf-8")

    def write(self, rows: Iterable[Sequence[Any]]) -> None:
        """Append the rows of one frame; they are in the file when this returns."""
        self.writer.writerows(rows)
        self.stream.flush()

    def close(self) -> None:
        """Close the file."""
        self.stream.close()


def _pose(match: Match) -> Pose | None:
    if match.fused_pose is not None:
        return match.fused_pose
    if match.status.name == "UNTRUSTED" or not match.problem.least_for_pose:
        return None
    return match.poses[0] if match.poses else None


def _cells(pose: Pose) -> list[Any]:
    spread = pose.covariance
    covariance = ["" for _ in COVARIANCES]
    if spread is not None and spread.shape == (6, 6):
        covariance = [float(spread[a, b]) for a in range(6) for b in range(a, 6)]  # type: ignore[misc]
    if len(pose.R) != 3:
        return ["" for _ in range(7 + len(COVARIANCES))]
    return [*pose.t.tolist(), *pose.quaternion.tolist(), *covariance]
