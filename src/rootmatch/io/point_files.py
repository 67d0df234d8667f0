"""CSV files of points, matches, ground truth and candidates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.errors import InputError, quote_value
from rootmatch.io.csv_tables import parse_header, parse_number, read_table, read_text, refuse_repeats, write_table
from rootmatch.io.known_files import COLUMNS, KnownInImage, has_known_columns
from rootmatch.io.noise_columns import (
    COVARIANCE,
    DEVIATIONS,
    find_noise_columns,
    has_all_columns,
    noise_array,
    parse_row_noise,
    tabulate_noise,
)
from rootmatch.problems.pose_fit.pose_prior import PosePrior

MATCHES = ("source", "target", "weight", "motion", "residual", "confidence")
"""Columns of a file of matches."""
COORDINATES = ("x", "y", "z")
NORMALS = ("nx", "ny", "nz")


@dataclass(frozen=True)
class PointSet:
    """Points of one file."""

    points: Floats
    """(m, 3) or (m, 2). Coordinates: any unit in space, pixels (x right, y down) in an image."""
    ids: tuple[str, ...] | None = None
    """Names of the points, where the file has a column ``id``."""
    normals: Floats | None = None
    """(m, 3) outward normals, zero where unknown, if the file has columns ``nx,ny,nz``."""
    bodies: tuple[str, ...] | None = None
    """Labels of the rigid bodies, where the file has a column ``body``."""
    sigma: Floats | None = None
    """(m,), (m, 3) or (m, 2, 2). Standard deviation of each point's coordinates, where the file has a column ``sigma``,
    or of each on each axis, where it has ``sx,sy,sz``; covariances of detections, where it has ``sxx,sxy,syy``."""
    known: PosePrior | None = None
    """What is known of the pose of an image, where its file has such columns (`rootmatch.io.known_files`)."""

    @property
    def names(self) -> tuple[str, ...]:
        """The ids, or zero-based row numbers if there are none."""
        return self.ids if self.ids is not None else tuple(str(row) for row in range(len(self.points)))


def point_dimension(path: Path) -> int:
    """3 if the header of a file of points has a column ``z``, one that may be meant so, or three numbers; else 2."""
    header = next((line for line in read_text(path).splitlines() if line.strip(" ,\t")), "")
    names = parse_header(header.split(","))
    is_meant = any(name[:1] in ("z", "Z") for name in names)
    return 3 if is_meant or (len(names) == 3 and not any(map(str.isidentifier, names))) else 2


def read_points(
    path: Path, dimension: int, minimum: int = 1, *, of_rig: bool = False, of_image: bool = False
) -> PointSet:
    """Read points of a CSV file with columns ``x,y[,z]``, optional ``id,sigma`` and, in space, also others.

    Those are ``nx,ny,nz``, ``body``, and ``sx,sy,sz`` in the place of ``sigma``; of detections it is ``sxx,sxy,syy``.

    Parameters
    ----------
    path : path
        The file.
    dimension : int
        3 for points in space, 2 for an image.
    minimum : int
        Least number of points.
    of_rig : bool
        Whether they are detections of several cameras: ``x,y,camera``, with the camera's index from 0.
    of_image : bool
        Whether they are detections: columns of `rootmatch.io.known_files.COLUMNS` then say what is known of the pose.
    """
    needed = (*COORDINATES[:2], "camera") if of_rig else COORDINATES[:dimension]
    known = ("id", *needed, "sigma", *((*NORMALS, "body", *DEVIATIONS) if dimension == 3 and not of_rig else ()))
    rows = read_table(path, needed, (*known, *((*COVARIANCE, *COLUMNS) if of_image else ())))
    told, columns = KnownInImage(path), rows[0][1]
    if of_image and has_known_columns(path, columns):
        for row, cells in rows:
            told.take(row, cells)
    with_normals, noisy = has_all_columns(path, columns, NORMALS), find_noise_columns(path, columns)
    points = np.array([[parse_number(path, row, name, cells[name]) for name in needed] for row, cells in rows])
    bodies = _read_labels(path, rows, "body", "label") if "body" in columns else None
    if dimension == 3 or not of_image:  # a detection may be reported twice: both stay unmatched
        owners = bodies or ("",) * len(rows)
        each = zip(rows, points.tolist(), owners, strict=True)
        refuse_repeats(path, [(row, (owner, *point)) for (row, _), point, owner in each], "point")
    normals = np.array([_parse_normal(path, row, cells) for row, cells in rows]) if with_normals else None
    ids = _read_labels(path, rows, "id", "name") if "id" in columns else None
    if ids is not None:
        refuse_repeats(path, [(row, cells["id"]) for row, cells in rows], "id")
    sigma = noise_array(noisy, [parse_row_noise(path, row, noisy, cells) for row, cells in rows])
    if len(points) < minimum:
        raise InputError(f"{path}: too few points, {len(points)} given and at least {minimum} needed; add points")
    return PointSet(points, ids, normals, bodies, sigma=sigma, known=told.end())


def _parse_normal(path: Path, row: int, cells: dict[str, str]) -> list[float]:
    """The normal in a row: three zeros, or three empty cells, where it is not known."""
    empty = [name for name in NORMALS if not cells[name]]
    if len(empty) == len(NORMALS):
        return [0.0, 0.0, 0.0]
    if empty:
        raise InputError(f"{path}, row {row}: {empty[0]} is empty; give it, or leave all of nx,ny,nz empty")
    return [parse_number(path, row, name, cells[name]) for name in NORMALS]


def _read_labels(path: Path, rows: list[tuple[int, dict[str, str]]], column: str, verb: str) -> tuple[str, ...]:
    """Names of the points from a column, as they are printed and drawn."""
    for row, cells in rows:
        if not cells[column]:
            raise InputError(f"{path}, row {row}: the {column} is empty; {verb} every point, or leave the column out")
        if not cells[column].isprintable():
            raise InputError(
                f"{path}, row {row}: the {column} {quote_value(cells[column])} has a line break or control character; "
                "remove it"
            )
    return tuple(cells[column] for _, cells in rows)


def read_truth(path: Path, source: PointSet, target: PointSet) -> Integers:
    """Read the true assignment from a CSV file with columns ``source,target`` (ids, or zero-based row numbers).

    Returns (n,): index into the target, −1 for source points that the file does not name or whose target is empty.
    """
    truth = np.full(len(source.points), -1, dtype=np.int64)
    rows = read_table(path, ("source", "target"), MATCHES)
    refuse_repeats(path, [(row, cells["source"]) for row, cells in rows], "source")
    visible = [(row, cells) for row, cells in rows if cells["target"]]
    refuse_repeats(path, [(row, cells["target"]) for row, cells in visible], "target")
    for i, j in _find_indices(path, visible, source, target):
        truth[i] = j
    return truth


def read_candidates(path: Path, source: PointSet, target: PointSet) -> Bools | Floats:
    """Read the possible correspondences, one per row: columns ``source,target`` and optionally ``weight``.

    Returns (n, n'): bool without weights; with them the weights, 0 for correspondences that the file does not name.
    """
    rows = read_table(path, ("source", "target"), ("source", "target", "weight"))
    refuse_repeats(path, [(row, (cells["source"], cells["target"])) for row, cells in rows], "correspondence")
    weighted = "weight" in rows[0][1]
    weights = np.zeros((len(source.points), len(target.points)))
    for (i, j), (row, cells) in zip(_find_indices(path, rows, source, target), rows, strict=True):
        weights[i, j] = parse_number(path, row, "weight", cells["weight"]) if weighted else 1.0
        if weights[i, j] < 0.0:
            given = quote_value(cells["weight"])
            raise InputError(f"{path}, row {row}: weight is {given}; give a positive number, or 0 to forbid")
    return weights if weighted else weights > 0.0


def _find_indices(
    path: Path, rows: Sequence[tuple[int, dict[str, str]]], source: PointSet, target: PointSet
) -> list[tuple[int, int]]:
    """Indices of the source and target points that each row names."""
    sides = {
        "source": {name: i for i, name in enumerate(source.names)},
        "target": {name: j for j, name in enumerate(target.names)},
    }
    for row, cells in rows:
        for side, indices in sides.items():
            if cells[side] not in indices:
                given = quote_value(cells[side])
                raise InputError(f"{path}, row {row}: no {side} point is named {given}; give its id or number")
    return [(sides["source"][cells["source"]], sides["target"][cells["target"]]) for _, cells in rows]


def write_points(path: Path, points: PointSet) -> None:
    """Write points that `read_points` reads back bit for bit."""
    header = [*(() if points.ids is None else ("id",)), *COORDINATES[: points.points.shape[1]]]
    columns: list[Sequence[Any]] = [] if points.ids is None else [points.ids]
    columns += points.points.T.tolist()
    if points.normals is not None:
        header += NORMALS
        columns += points.normals.T.tolist()
    if points.bodies is not None:
        header.append("body")
        columns.append(points.bodies)
    if points.sigma is not None:
        names, numbers = tabulate_noise(points.sigma)
        header += names
        columns += numbers.T.tolist()
    write_table(path, header, zip(*columns, strict=True))


def write_matches(
    path: Path,
    assignment: Integers,
    weights: Floats,
    motions: Integers,
    confidence: Floats,
    source: PointSet,
    target: PointSet,
    residuals: Floats,
) -> None:
    """Write ``source,target,weight,motion,residual,confidence``, one row per matched source point.

    Parameters
    ----------
    assignment, weights, motions, confidence, residuals : (n,) arrays
        Index into the target (−1 unmatched), weight, motion label and confidence of each source point, and its distance
        from where the pose of its motion predicts it; NaN, where there is none, is written as an empty cell.
    """
    rows = []
    for i in np.flatnonzero(assignment >= 0).tolist():
        names = source.names[i], target.names[int(assignment[i])]
        rows.append((*names, float(weights[i]), int(motions[i]), _cell(residuals[i]), _cell(confidence[i])))
    write_table(path, MATCHES, rows)


def _cell(number: float) -> float | str:
    """A number as a cell, which is empty for one that is not finite."""
    return float(number) if math.isfinite(number) else ""
