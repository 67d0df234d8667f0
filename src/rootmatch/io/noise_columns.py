"""Columns of a file of points with their noise: ``sigma``, ``sx,sy,sz`` in space, ``sxx,sxy,syy`` in an image.

The last are the covariance of a detection in px², as of a blob whose image is blurred along a direction.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.errors import InputError
from rootmatch.io.csv_tables import parse_nonnegative, parse_number

DEVIATIONS = ("sx", "sy", "sz")
COVARIANCE = ("sxx", "sxy", "syy")


def find_noise_columns(path: Path, header: Collection[str]) -> tuple[str, ...]:
    """Those of a table; none if it has none of them.

    Raises
    ------
    InputError
        If it has a part of them, or two that say the same.
    """
    several = [names for names in (DEVIATIONS, COVARIANCE) if has_all_columns(path, header, names)]
    if "sigma" not in header:
        return several[0] if several else ()
    if several:
        raise InputError(f"{path}: it has columns sigma and {several[0][0]}; give only one of them")
    return ("sigma",)


def has_all_columns(path: Path, header: Collection[str], names: tuple[str, ...]) -> bool:
    """Whether a table has all of some columns; an error if it has but a part of them."""
    given = [name for name in names if name in header]
    if given and len(given) < len(names):
        missing = next(name for name in names if name not in given)
        raise InputError(
            f"{path}: the column {missing} is missing although {given[0]} is given; give {','.join(names)} or none"
        )
    return bool(given)


def parse_row_noise(path: Path, row: int, names: tuple[str, ...], cells: dict[str, str]) -> list[float]:
    """The numbers that a row has in such columns."""
    return [(parse_number if name == "sxy" else parse_nonnegative)(path, row, name, cells[name]) for name in names]


def noise_array(names: tuple[str, ...], numbers: list[list[float]]) -> Floats | None:
    """σ of each point (m,), of each on each axis (m, 3), or covariances (m, 2, 2); None without columns."""
    if not names:
        return None
    array = np.array(numbers).reshape(-1, len(names))
    if names == COVARIANCE:
        return np.asarray(array[:, [0, 1, 1, 2]].reshape(-1, 2, 2))
    return array[:, 0] if len(names) == 1 else array


def tabulate_noise(noise: Floats) -> tuple[tuple[str, ...], Floats]:
    """Names and numbers (m, c) of the columns in which `noise_array` finds a noise."""
    if noise.ndim == 3:
        return COVARIANCE, noise.reshape(-1, 4)[:, [0, 1, 3]]
    return (("sigma",), noise[:, None]) if noise.ndim == 1 else (DEVIATIONS, noise)
