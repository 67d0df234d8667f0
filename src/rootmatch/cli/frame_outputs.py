"""Poses and matches of many frames as rows of CSV files."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING, Any

from rootmatch.cli.error_messages import rephrase_advice
from rootmatch.io.appended_table import AppendedTable
from rootmatch.io.csv_tables import csv_text
from rootmatch.io.exports import trajectory_row
from rootmatch.io.pose_files import IN_SPACE, covariance_columns, finite_or_none, upper_triangle
from rootmatch.report.json_record import body_record, told_pose
from rootmatch.report.text import match_weights

if TYPE_CHECKING:
    from rootmatch.cli.frames import FrameOutputs
    from rootmatch.io.point_files import PointSet
    from rootmatch.problems.base import Problem
    from rootmatch.problems.pose_fit.pose import Pose
    from rootmatch.result import Match
    from rootmatch.tracking.tracker import Tracker, TrackingState

POSE_COLUMNS = ("frame", "body", "status", "probability", "matched", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
TRAJECTORY = ("#", "time", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
"""The first line of TUM's trajectories: a comment."""
MATCH_COLUMNS = ("frame", "source", "target", "weight", "motion")


def count_statuses(statuses: Counter[str]) -> str:
    """How many results have each status, in words."""
    return ", ".join(f"{statuses[status]} {status}" for status in ("matched", "ambiguous", "untrusted"))


def brief_advice(match: Match) -> str:
    """The advice about a frame in terms of the command line.

    It is told by what the match knows, without the trials and fits of `rootmatch.Match.advice`.
    """
    from rootmatch.explain.status_advice import advice

    confidence = None if match.finding.all_confidence is None else match.confidence
    return rephrase_advice(advice(match.shown, confidence, match.stopped_early))


def pose_columns(problem: Problem) -> tuple[str, ...]:
    """The columns of `pose_rows`: with the scale and its covariances where that is unknown."""
    names = (*IN_SPACE, "scale")[: problem.predicted_rows]
    return *POSE_COLUMNS, *names[len(IN_SPACE) :], *covariance_columns(names)


def pose_rows(frame: int, match: Match) -> list[list[Any]]:
    """A row for each body of a frame: its status, and its pose where it is known."""
    each: list[tuple[Any, Match]] = [("", match)] if match.bodies is None else list(match.bodies.items())
    rows = []
    for label, one in each:
        probability = finite_or_none(one.finding.probability)
        told = [frame, label, one.status.name.lower(), probability, int((one.assignment >= 0).sum())]
        rows.append([*told, *_cells(told_pose(one), match.problem.predicted_rows)])
    return rows


def trajectory_rows(time: float, match: Match) -> list[list[float]]:
    """The row of a frame in a trajectory of TUM; none where its pose is not sure."""
    pose = told_pose(match) if match else None
    return [] if pose is None else [trajectory_row(time, pose)]


def frame_record(frame: int, time: float, match: Match, states: Mapping[Any, TrackingState]) -> dict[str, Any]:
    """A tracked frame as numbers, lists and strings that JSON can hold.

    Keys: ``frame``, ``time`` (s), ``status``, ``state`` (``"tracking"``, ``"coasting"`` or ``"lost"``),
    ``advice`` (a sentence), ``prior_holds`` (null without one, or if nothing is trusted), ``stopped_early``,
    ``probability`` (null if it was not needed), ``pairs`` (source point, detection), ``pose`` (see
    `rootmatch.io.pose_record`; null if it is not known). Of several bodies ``bodies`` has all but the first three.
    """
    if match.bodies is None:
        return {"frame": frame, "time": time, **_body_record(match, states[None])}
    bodies = {str(label): _body_record(one, states[label]) for label, one in match.bodies.items()}
    return {"frame": frame, "time": time, "status": match.status.name.lower(), "bodies": bodies}


def _body_record(match: Match, state: TrackingState) -> dict[str, Any]:
    told = body_record(match, brief_advice(match), match.finding.probability)
    return {"status": told.pop("status"), "state": state.name.lower(), **told}


def match_rows(frame: int, match: Match, source: PointSet) -> list[list[Any]]:
    """A row for each match of a frame, ``target`` counting its detections from 0; one without any, where none is."""
    weights = match_weights(match)
    found = [
        [frame, source.names[i], j, float(weights[i]), int(match.motion_labels[i])]
        for i, j in enumerate(match.assignment.tolist())
        if j >= 0
    ]
    return found or [[frame, "", "", "", ""]]


def _cells(pose: Pose | None, rows: int) -> list[Any]:
    """The cells of a pose in space with its covariance (rows, rows); empty for what is absent."""
    pairs, with_scale = upper_triangle(rows), rows > len(IN_SPACE)
    if pose is None or len(pose.R) != 3:
        return [""] * (7 + with_scale + len(pairs))
    spread = pose.covariance
    known = spread is not None and len(spread) == rows
    covariance = [float(spread[a, b]) for a, b in pairs] if known else [""] * len(pairs)  # type: ignore[index]
    return [*pose.t.tolist(), *pose.quaternion.tolist(), *[pose.scale][:with_scale], *covariance]


class FrameWriter(ExitStack):
    """Files and standard output, each with the rows of a frame as soon as the frame is matched.

    Poses without a file go to standard output, below a header that waits for the first frame.
    """

    def __init__(self, outputs: FrameOutputs, source: PointSet, problem: Problem) -> None:
        super().__init__()
        self.outputs, self.source = outputs, source
        self.header: tuple[str, ...] = TRAJECTORY if outputs.trajectory else (*pose_columns(problem), "time")
        self.delimiter = " " if outputs.trajectory else ","
        self._matches = self._poses = None
        if outputs.output is not None:
            self._matches = self.enter_context(closing(AppendedTable(outputs.output, MATCH_COLUMNS)))
        if outputs.poses is not None:
            self._poses = self.enter_context(
                closing(AppendedTable(outputs.poses, self.header, delimiter=self.delimiter))
            )
        self._headed = False

    def write(self, number: int, time: float, found: Match, tracker: Tracker) -> list[str]:
        """Write a frame; the status of each of its bodies."""
        each = pose_rows(number, found)
        rows: list[list[Any]] = trajectory_rows(time, found) if self.outputs.trajectory else [[*r, time] for r in each]
        if self.outputs.as_json:
            print(json.dumps(frame_record(number, time, found, tracker.states), allow_nan=False), flush=True)
        if self._poses is not None:
            self._poses.write(rows)
        elif not self.outputs.as_json:
            print(csv_text(rows if self._headed else [self.header, *rows], self.delimiter), end="", flush=True)
            self._headed = True
        if self._matches is not None:
            self._matches.write(match_rows(number, found, self.source))
        return [row[2] for row in each]
