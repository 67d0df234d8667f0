"""What ``rootmatch track`` writes of each frame: rows of poses and matches, or a line of JSON."""

from __future__ import annotations

import csv
import json
import sys
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING, Any, Self

from rootmatch.cli.frame_outputs import (
    MATCH_COLUMNS,
    TRAJECTORY,
    frame_record,
    match_rows,
    pose_columns,
    pose_rows,
    trajectory_rows,
)
from rootmatch.io.appended_table import AppendedTable

if TYPE_CHECKING:
    from types import TracebackType

    from rootmatch.cli.frames import FrameOutputs
    from rootmatch.io import PointSet
    from rootmatch.problems.base import Problem
    from rootmatch.result import Match
    from rootmatch.tracking.tracker import Tracker


class FrameWriter:
    """Files and standard output, each with the rows of a frame as soon as the frame is matched.

    Poses without a file go to standard output, below a header that waits for the first frame.
    """

    def __init__(self, outputs: FrameOutputs, source: PointSet, problem: Problem) -> None:
        self.outputs, self.source = outputs, source
        self.header: tuple[str, ...] = TRAJECTORY if outputs.trajectory else (*pose_columns(problem), "time")
        delimiter = " " if outputs.trajectory else ","
        self._files = ExitStack()
        self._matches = self._poses = None
        if outputs.output is not None:
            self._matches = self._files.enter_context(closing(AppendedTable(outputs.output, MATCH_COLUMNS)))
        if outputs.poses is not None:
            self._poses = self._files.enter_context(
                closing(AppendedTable(outputs.poses, self.header, delimiter=delimiter))
            )
        self._printed = csv.writer(sys.stdout, delimiter=delimiter, lineterminator="\n")
        self._headed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._files.close()

    def write(self, number: int, time: float, found: Match, tracker: Tracker) -> list[str]:
        """Write a frame; the status of each of its bodies."""
        each = pose_rows(number, found)
        rows: list[list[Any]] = trajectory_rows(time, found) if self.outputs.trajectory else [[*r, time] for r in each]
        if self.outputs.as_json:
            print(json.dumps(frame_record(number, time, found, tracker.states), allow_nan=False), flush=True)
        if self._poses is not None:
            self._poses.write(rows)
        elif not self.outputs.as_json:
            if not self._headed:
                self._printed.writerow(self.header)
                self._headed = True
            self._printed.writerows(rows)
            sys.stdout.flush()
        if self._matches is not None:
            self._matches.write(match_rows(number, found, self.source))
        return [row[2] for row in each]
