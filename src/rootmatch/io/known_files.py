"""What is known of poses before their images are seen, by an inertial sensor or another tracker, in CSV files.

It is a file of its own, or columns of the file of detections.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from rootmatch.errors import InputError, quoted
from rootmatch.io.calibrations.values import errors_at
from rootmatch.io.csv_tables import number, positive, read_table, refuse_repeats
from rootmatch.problems.pose_fit.pose_checks import rotation_of_quaternion
from rootmatch.problems.pose_fit.pose_prior import WIDEST, PosePrior

ROTATION = ("qx", "qy", "qz", "qw", "q_sigma")
POSITION = ("tx", "ty", "tz", "t_sigma")
VERTICAL = ("vx", "vy", "vz", "wx", "wy", "wz", "v_sigma")
GROUPS = {"rotation": ROTATION, "position": POSITION, "vertical": VERTICAL}
COLUMNS = (*ROTATION, *POSITION, *VERTICAL)

NEAR = 1e-3
"""Seconds that the time of a row may be from that of its frame: files are rounded, clocks read twice; in a millisecond
a hand turns a head by less than the σ of an IMU."""


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
    """

    def __init__(self, path: Path, column: str | None, rows: Mapping[str | None, list[KnownRow]]) -> None:
        self.path, self.column = path, column
        self.rows = {body: sorted(mine, key=attrgetter("when")) for body, mine in rows.items()}
        self._used = set[int]()

    def of(self, frame: int | None = None, time: float | None = None) -> Any:
        """The `PosePrior` of a frame, or a dict of them by label if the file has labels; None if nothing is known.

        A time is matched to the nearest row, at most `NEAR` from it.
        """
        asked = {"frame": frame, "time": time, None: math.nan}[self.column]
        if asked is None:
            raise InputError(
                f"{self.path}: a column {self.column}, and the image file has none; add it there, or leave it out here"
            )
        found = {body: one for body, mine in self.rows.items() if (one := self._nearest(mine, asked)) is not None}
        self._used.update(one.row for one in found.values())
        if None in found:
            return found[None].prior
        return {body: one.prior for body, one in found.items()} or None

    def _nearest(self, rows: list[KnownRow], asked: float) -> KnownRow | None:
        if self.column is None:
            return rows[0]
        after = bisect_left(rows, asked, key=attrgetter("when"))
        nearest = min(rows[max(after - 1, 0) : after + 1], key=lambda one: abs(one.when - asked))
        return nearest if abs(nearest.when - asked) <= (NEAR if self.column == "time" else 0.0) else None

    @property
    def unused(self) -> str | None:
        """A sentence on the rows that no frame has asked for; None if there are none."""
        rest = sorted(
            (one for mine in self.rows.values() for one in mine if one.row not in self._used), key=attrgetter("row")
        )
        if not rest:
            return None
        count = sum(map(len, self.rows.values()))
        first = f"row {rest[0].row} with {self.column} {rest[0].when:.9g}"
        near = f"; a time is matched to that of a frame within {1e3 * NEAR:g} ms" if self.column == "time" else ""
        return f"{self.path}: {len(rest)} of {count} rows match no frame, the first is {first}{near}"


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
    check_groups(path, columns)
    if "frame" in columns and "time" in columns:
        raise InputError(f"{path}: columns frame and time; give one of them")
    column = next((name for name in ("frame", "time") if name in columns), None)
    known: dict[str | None, list[KnownRow]] = {}
    keys = []
    for row, cells in rows:
        when = math.nan if column is None else number(path, row, column, cells[column])
        body = cells.get("body")
        if body is not None:
            _check_label(f"{path}, row {row}", body, labels)
        keys.append((row, (body, None if column is None else when)))
        told = known_in_row(path, row, cells)
        if told is not None:
            known.setdefault(body, []).append(KnownRow(when, row, told))
    if column is None:
        refuse_repeats(path, keys, "body", "add a column frame or time, which says of which image each row is")
    refuse_repeats(path, keys, f"{column} and body")
    return KnownPoses(path, column, known)


def _check_label(where: str, body: str, labels: Collection[str] | None) -> None:
    if labels is None:
        raise InputError(f"{where}: body is {quoted(body)}, and the model has no column body; leave the column out")
    if body not in labels:
        raise InputError(
            f"{where}: body is {quoted(body)}; the bodies of the model are {', '.join(sorted(set(labels)))}"
        )


def check_groups(path: Path, columns: Collection[str]) -> bool:
    """Whether a file has columns of what is known."""
    for group in GROUPS.values():
        missing = [name for name in group if name not in columns]
        if 0 < len(missing) < len(group):
            raise InputError(f"{path}: the column {missing[0]} is missing; give {','.join(group)} or none of them")
    return any(name in columns for name in COLUMNS)


def known_in_row(path: Path, row: int, cells: Mapping[str, str]) -> PosePrior | None:
    """What a row tells of a pose; None if all of its cells are empty."""
    given = {name: _group(path, row, cells, group) for name, group in GROUPS.items()}
    with errors_at(f"{path}, row {row}"):
        values = {name: _value(name, group) for name, group in given.items() if group is not None}
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
                    f"{self.path}, row {row}: {name} is {quoted(value)}, and {quoted(before)} in a row of the image "
                    "before; give one value for each image, in one of its rows or in all"
                )
            self._row = self._row if not value else row

    def end(self) -> PosePrior | None:
        """What is known of the image; the next one begins."""
        cells, row = dict.fromkeys(COLUMNS, "") | self._cells, self._row
        self._cells, self._row = {}, 0
        return known_in_row(self.path, row, cells)


def prior_of_frame(
    known: KnownPoses | None, frame: int | None = None, time: float | None = None, here: PosePrior | None = None
) -> Any:
    """What is known of a frame: by a file of its own (`KnownPoses.of`), or ``here``, by that of the detections."""
    if known is None:
        return here
    if here is not None:
        raise InputError("--known: the image file has columns of what is known as well; leave one of them out")
    return known.of(frame, time)


def _group(path: Path, row: int, cells: Mapping[str, str], group: tuple[str, ...]) -> list[float] | None:
    """The numbers of a group; None if all of its cells are empty."""
    if not any(cells.get(name) for name in group):
        return None
    *values, name = group
    sigma = positive(path, row, name, cells[name])
    if name != "t_sigma" and sigma > math.degrees(WIDEST):
        raise InputError(f"{path}, row {row}: {name} is {sigma:g}; give degrees up to {math.degrees(WIDEST):.0f}")
    return [*(number(path, row, one, cells[one]) for one in values), sigma]


def _value(name: str, cells: list[float]) -> tuple[object, ...]:
    """An argument of `PosePrior`."""
    *values, sigma = cells
    if name == "rotation":
        return rotation_of_quaternion(values, "xyzw"), math.radians(sigma)
    if name == "position":
        return np.array(values), sigma
    return np.array(values[3:]), np.array(values[:3]), math.radians(sigma)
