"""What is known of poses before their images are seen, by an inertial sensor or another tracker, in CSV files.

It is a file of its own, or columns of the file of detections.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rootmatch.errors import InputError, quoted
from rootmatch.io.calibrations.values import errors_at
from rootmatch.io.csv_tables import number, positive, read_table, refuse_repeats
from rootmatch.problems.pose_fit.pose_checks import rotation_of_quaternion
from rootmatch.problems.pose_fit.pose_prior import PosePrior

ROTATION = ("qx", "qy", "qz", "qw", "q_sigma")
POSITION = ("tx", "ty", "tz", "t_sigma")
VERTICAL = ("vx", "vy", "vz", "wx", "wy", "wz", "v_sigma")
GROUPS = {"rotation": ROTATION, "position": POSITION, "vertical": VERTICAL}
COLUMNS = (*ROTATION, *POSITION, *VERTICAL)

Key = tuple[tuple[str, float] | None, str | None]
"""``("frame", number)`` or ``("time", seconds)``, and the label of a body; None where a file has no such column."""


def read_known(path: Path) -> dict[Key, PosePrior]:
    """Read what is known of poses, a row for each frame and body.

    Columns, all of a group or none: ``qx,qy,qz,qw,q_sigma``, a rotation and its σ in degrees; ``tx,ty,tz,t_sigma``, a
    position in the unit of the model; ``vx,vy,vz,wx,wy,wz,v_sigma``, a direction in the frame of the camera, the same
    in that of the model, and its σ in degrees. Empty cells of a group: not known in this row. ``frame`` or ``time``,
    and ``body``, say of what.
    """
    rows = read_table(path, (), ("frame", "time", "body", *COLUMNS))
    columns = rows[0][1]
    check_groups(path, columns)
    if "frame" in columns and "time" in columns:
        raise InputError(f"{path}: columns frame and time; give one of them")
    known: dict[Key, PosePrior] = {}
    keys = []
    for row, cells in rows:
        when = [(name, number(path, row, name, cells[name])) for name in ("frame", "time") if name in cells]
        key: Key = (when[0] if when else None, cells.get("body"))
        keys.append((row, key))
        told = known_in_row(path, row, cells)
        if told is not None:
            known[key] = told
    refuse_repeats(path, keys, "frame and body")
    return known


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
    known: dict[Key, PosePrior], frame: int | None = None, time: float | None = None, here: PosePrior | None = None
) -> Any:
    """The `PosePrior` of one frame, or a dict of them by label if there are labels; None if nothing is known.

    ``here``: what the file of detections tells.
    """
    if here is not None:
        if known:
            raise InputError("--known: the image file has columns of what is known as well; leave one of them out")
        return here
    asked = (None, ("frame", frame), ("time", time))
    own = {body: one for (when, body), one in known.items() if when in asked}
    if None in own:
        return own[None]
    return {body: one for body, one in own.items() if body is not None} or None


def _group(path: Path, row: int, cells: Mapping[str, str], group: tuple[str, ...]) -> list[float] | None:
    """The numbers of a group; None if all of its cells are empty."""
    if not any(cells.get(name) for name in group):
        return None
    *values, sigma = group
    return [*(number(path, row, name, cells[name]) for name in values), positive(path, row, sigma, cells[sigma])]


def _value(name: str, cells: list[float]) -> tuple[object, ...]:
    """An argument of `PosePrior`."""
    *values, sigma = cells
    if name == "rotation":
        return rotation_of_quaternion(values, "xyzw"), math.radians(sigma)
    if name == "position":
        return np.array(values), sigma
    return np.array(values[3:]), np.array(values[:3]), math.radians(sigma)
