"""What is known of poses before their images are seen, by an inertial sensor or another tracker, in CSV files.

It is a file of its own, or columns of the file of detections.
"""

from __future__ import annotations

import math
import warnings
from bisect import bisect_left
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from rootmatch.errors import InputError, InputWarning, quote_value
from rootmatch.io.calibrations.values import prefix_errors
from rootmatch.io.csv_tables import parse_nonnegative, parse_number, read_table, refuse_repeats
from rootmatch.problems.pose_fit.pose_checks import quaternion_to_rotation
from rootmatch.problems.pose_fit.pose_prior import WIDEST, PosePrior

ROTATION = ("qx", "qy", "qz", "qw", "q_sigma")
POSITION = ("tx", "ty", "tz", "t_sigma")
VERTICAL = ("vx", "vy", "vz", "wx", "wy", "wz", "v_sigma")
GROUPS = {"rotation": ROTATION, "position": POSITION, "vertical": VERTICAL}
COLUMNS = (*ROTATION, *POSITION, *VERTICAL)

NEAR = 1e-3
"""Seconds that the time of a row may be from that of its frame: files are rounded, clocks read twice; in a millisecond
a hand turns a head by less than the σ of an IMU."""
GAP = 0.05
"""Seconds between two rows up to which what is known is interpolated: a quickly turned head (30 rad/s²) is then at most
half a degree from there. A round value."""
BEYOND = 0.5
"""How far beyond both rows, in parts of the time between them. A round value."""


@dataclass(frozen=True)
class KnownRow:
    """What a row tells, and of which frame; ``when`` is NaN where it is of every frame."""

    when: float
    row: int
    prior: PosePrior


class KnownPoses:
    """What a file tells of poses.

    Parameters
    ----------
    path : path
    column : str or None
        ``"frame"`` or ``"time"``, which tells the rows of one frame from those of another; None: they are of every one.
    rows : mapping of str or None to list of KnownRow
        By the label of the body; None where the file has no column ``body``.
    empty : bool
        Whether there are rows that tell nothing beside these.
    """

    def __init__(
        self, path: Path, column: str | None, rows: Mapping[str | None, list[KnownRow]], empty: bool = False
    ) -> None:
        self.path, self.column, self.empty = path, column, empty
        self.rows = {body: sorted(mine, key=attrgetter("when")) for body, mine in rows.items()}
        self._used, self._asked = set[int](), list[float]()
        self._between = self._untold = 0

    def of(self, frame: int | None = None, time: float | None = None) -> Any:
        """The `PosePrior` of a frame, or a dict of them by label if the file has labels; None if nothing is known.

        A time is that of the nearest row, at most `NEAR` from it; otherwise two rows about it, at most `GAP` apart, are
        interpolated, or continued by half of the time between them.
        """
        asked = {"frame": frame, "time": time, None: math.nan}[self.column]
        if asked is None:
            raise InputError(
                f"{self.path}: it has a column {self.column}, but the image file has none; add it there, or leave it "
                "out here"
            )
        self._asked.append(asked)
        given = {body: told for body, mine in self.rows.items() if (told := self._knowledge(mine, asked)) is not None}
        self._used.update(row for rows, _ in given.values() for row in rows)
        self._between += any(len(rows) > 1 for rows, _ in given.values())
        self._untold += not given
        found = {body: prior for body, (_, prior) in given.items()}
        return found.get(None, found or None)

    def _knowledge(self, rows: list[KnownRow], asked: float) -> tuple[tuple[int, ...], PosePrior] | None:
        """The rows that tell of a frame, and what."""
        if self.column is None:
            return (rows[0].row,), rows[0].prior
        after = bisect_left(rows, asked, key=attrgetter("when"))
        nearest = min(rows[max(after - 1, 0) : after + 1], key=lambda one: abs(one.when - asked))
        if abs(nearest.when - asked) <= (NEAR if self.column == "time" else 0.0):
            return (nearest.row,), nearest.prior
        if self.column == "frame":
            return None
        for k in (after - 1, after - 2, after):  # between two rows, or beyond the last of a run or before the first
            if not 0 <= k < len(rows) - 1:
                continue
            first, second = rows[k : k + 2]
            gap, since = second.when - first.when, asked - first.when
            if gap > GAP or not -BEYOND * gap <= since <= (1.0 + BEYOND) * gap:
                continue
            if (prior := first.prior.towards(second.prior, since / gap)) is not None:
                return (first.row, second.row), prior
        return None

    @property
    def interpolation_note(self) -> str | None:
        """A sentence on the frames that are between rows; None if there are none."""
        if not self._between:
            return None
        return f"{self.path}: interpolated at the times of {self._between} of {len(self._asked)} frames"

    @property
    def mismatch_note(self) -> str | None:
        """A sentence on rows and frames that do not meet; None if the file is merely longer than they."""
        if not self._asked or self.column is None:
            return None
        every = sorted((one for mine in self.rows.values() for one in mine), key=attrgetter("row"))
        first, last = min(self._asked), max(self._asked)
        if not self._used:
            whens = [one.when for one in every]
            return (
                f"{self.path}: no row matches a frame: its {self.column} runs from {min(whens):.9g} to "
                f"{max(whens):.9g}, that of the frames from {first:.9g} to {last:.9g}"
            )
        if self.column == "time":
            if not self._untold or self.empty:
                return None
            return (
                f"{self.path}: {self._untold} of {len(self._asked)} frames have no row within {1e3 * NEAR:g} ms, nor "
                f"two rows around them that are {1e3 * GAP:g} ms apart or less"
            )
        rest = [one for one in every if one.row not in self._used and first <= one.when <= last]
        if not rest:
            return None
        where = f"row {rest[0].row} with {self.column} {rest[0].when:.9g}"
        return f"{self.path}: {len(rest)} of {len(every)} rows match no frame, the first is {where}"


def read_known(path: Path, labels: Collection[str] | None = None) -> KnownPoses:
    """Read what is known of poses, a row for each frame and body.

    Columns, all of a group or none: ``qx,qy,qz,qw,q_sigma``, a rotation and its σ in degrees; ``tx,ty,tz,t_sigma``, a
    position in the unit of the model; ``vx,vy,vz,wx,wy,wz,v_sigma``, a direction in the frame of the camera, the same
    in that of the model, and its σ in degrees. Empty cells of a group: not known in this row. ``frame`` or ``time``
    (seconds), and ``body``, say of what.

    Parameters
    ----------
    path : path
    labels : collection of str, optional
        Those of the bodies of the model, where it has a column ``body``.
    """
    rows = read_table(path, (), ("frame", "time", "body", *COLUMNS))
    columns = rows[0][1]
    has_known_columns(path, columns)
    if "frame" in columns and "time" in columns:
        raise InputError(f"{path}: it has columns frame and time; give one of them")
    column = next((name for name in ("frame", "time") if name in columns), None)
    known: dict[str | None, list[KnownRow]] = {}
    keys, empty = [], False
    for row, cells in rows:
        when = math.nan if column is None else parse_number(path, row, column, cells[column])
        body = cells.get("body")
        if body is not None:
            _check_label(f"{path}, row {row}", body, labels)
        keys.append((row, (body, None if column is None else when)))
        told = parse_known_row(path, row, cells)
        empty |= told is None
        if told is not None:
            known.setdefault(body, []).append(KnownRow(when, row, told))
    if column is None:
        refuse_repeats(path, keys, "body", "add a column frame or time, which says to which image each row belongs")
    refuse_repeats(path, keys, f"{column} and body")
    return KnownPoses(path, column, known, empty)


def _check_label(where: str, body: str, labels: Collection[str] | None) -> None:
    if labels is None:
        raise InputError(
            f"{where}: body is {quote_value(body)}, but the model has no column body; leave the column out"
        )
    if body not in labels:
        raise InputError(
            f"{where}: body is {quote_value(body)}; the bodies of the model are {', '.join(sorted(set(labels)))}"
        )


def has_known_columns(path: Path, columns: Collection[str]) -> bool:
    """Whether a file has columns of what is known."""
    for group in GROUPS.values():
        missing = [name for name in group if name not in columns]
        if 0 < len(missing) < len(group):
            raise InputError(f"{path}: the column {missing[0]} is missing; give {','.join(group)} or none of them")
    return any(name in columns for name in COLUMNS)


def parse_known_row(path: Path, row: int, cells: Mapping[str, str]) -> PosePrior | None:
    """What a row tells of a pose; None if all of its cells are empty."""
    given = {name: _parse_group(path, row, cells, group) for name, group in GROUPS.items()}
    with prefix_errors(f"{path}, row {row}"), warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)  # of degrees for radians: these are degrees
        values = {name: _prior_argument(name, group) for name, group in given.items() if group is not None}
        return PosePrior(**values) if values else None  # type: ignore[arg-type]


class KnownInImage:
    """What the rows of one image tell of its pose: a cell may be empty where another row of the image has the value."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._cells: dict[str, str] = {}
        self._row = 0

    def take(self, row: int, cells: Mapping[str, str]) -> None:
        """Add a row."""
        for name in COLUMNS:
            value = cells.get(name, "")
            if value and (before := self._cells.setdefault(name, value)) != value:
                raise InputError(
                    f"{self.path}, row {row}: {name} is {quote_value(value)}, but {quote_value(before)} in an "
                    "earlier row of the same image; give one value for each image, in one of its rows or in all"
                )
            self._row = self._row or (row if value else 0)

    def end(self) -> PosePrior | None:
        """What is known of the image; the next one begins."""
        cells, row = dict.fromkeys(COLUMNS, "") | self._cells, self._row
        self._cells, self._row = {}, 0
        return parse_known_row(self.path, row, cells)


def prior_of_frame(
    known: KnownPoses | None, frame: int | None = None, time: float | None = None, here: PosePrior | None = None
) -> Any:
    """What is known of a frame: by a file of its own (`KnownPoses.of`), or ``here``, by that of the detections."""
    if known is None:
        return here
    if here is not None:
        raise InputError("--known: the image file has columns of what is known as well; leave one of them out")
    return known.of(frame, time)


def _parse_group(path: Path, row: int, cells: Mapping[str, str], group: tuple[str, ...]) -> list[float] | None:
    """The numbers of a group; None if all of its cells are empty."""
    if not any(cells.get(name) for name in group):
        return None
    *values, name = group
    sigma = parse_nonnegative(path, row, name, cells[name])
    if name != "t_sigma" and sigma > math.degrees(WIDEST):
        raise InputError(f"{path}, row {row}: {name} is {sigma:g}; give degrees up to {math.degrees(WIDEST):.0f}")
    return [*(parse_number(path, row, one, cells[one]) for one in values), sigma]


def _prior_argument(name: str, cells: list[float]) -> tuple[object, ...]:
    """An argument of `PosePrior`."""
    *values, sigma = cells
    if name == "rotation":
        return quaternion_to_rotation(values, "xyzw"), math.radians(sigma)
    if name == "position":
        return np.array(values), sigma
    return np.array(values[3:]), np.array(values[:3]), math.radians(sigma)
