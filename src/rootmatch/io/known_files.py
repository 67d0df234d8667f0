"""CSV files of what is known of poses before their images are seen: by an inertial sensor, or by another tracker."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from rootmatch.errors import InputError
from rootmatch.io.csv_tables import number, positive, read_table, refuse_repeats
from rootmatch.problems.pose_fit.pose_checks import rotation_of_quaternion
from rootmatch.problems.pose_fit.pose_prior import PosePrior

ROTATION = ("qx", "qy", "qz", "qw", "q_sigma")
POSITION = ("tx", "ty", "tz", "t_sigma")
VERTICAL = ("vx", "vy", "vz", "wx", "wy", "wz", "v_sigma")
GROUPS = {"rotation": ROTATION, "position": POSITION, "vertical": VERTICAL}

Key = tuple[tuple[str, float] | None, str | None]
"""``("frame", number)`` or ``("time", seconds)``, and the label of a body; None where a file has no such column."""


def read_known(path: Path) -> dict[Key, PosePrior]:
    """Read what is known of poses, a row for each frame and body.

    Columns, all of a group or none: ``qx,qy,qz,qw,q_sigma``, a rotation and its σ in degrees; ``tx,ty,tz,t_sigma``, a
    position in the unit of the model; ``vx,vy,vz,wx,wy,wz,v_sigma``, a direction in the frame of the camera, the same
    in that of the model, and its σ in degrees. Empty cells of a group: not known in this row. ``frame`` or ``time``,
    and ``body``, say of what.

    Raises
    ------
    InputError
        If the file cannot be used; the text names the file, the row and the remedy.
    """
    every = [name for group in GROUPS.values() for name in group]
    rows = read_table(path, (), ("frame", "time", "body", *every))
    columns = rows[0][1]
    for group in GROUPS.values():
        missing = [name for name in group if name not in columns]
        if 0 < len(missing) < len(group):
            raise InputError(f"{path}: the column {missing[0]} is missing; give {','.join(group)} or none of them")
    if "frame" in columns and "time" in columns:
        raise InputError(f"{path}: columns frame and time; give one of them")
    known: dict[Key, PosePrior] = {}
    keys = []
    for row, cells in rows:
        given = {name: _group(path, row, cells, group) for name, group in GROUPS.items()}
        when = [(name, number(path, row, name, cells[name])) for name in ("frame", "time") if name in cells]
        key: Key = (when[0] if when else None, cells.get("body"))
        keys.append((row, key))
        try:
            values = {name: _value(name, group) for name, group in given.items() if group is not None}
            if values:
                known[key] = PosePrior(**values)  # type: ignore[arg-type]
        except InputError as error:
            raise InputError(f"{path}, row {row}: {error}") from None
    refuse_repeats(path, keys, "frame and body")
    return known


def prior_of_frame(known: dict[Key, PosePrior], frame: int | None = None, time: float | None = None) -> Any:
    """The `PosePrior` of one frame, or a dict of them by label if there are labels; None if nothing is known."""
    here = (None, ("frame", frame), ("time", time))
    own = {body: one for (when, body), one in known.items() if when in here}
    if None in own:
        return own[None]
    return {body: one for body, one in own.items() if body is not None} or None


def _group(path: Path, row: int, cells: dict[str, str], group: tuple[str, ...]) -> list[float] | None:
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
