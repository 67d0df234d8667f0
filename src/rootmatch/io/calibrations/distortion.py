"""The lens among the entries of a calibration: its coefficients by their usual names, and none of it left unread.

A lens that is dropped without a word makes every pose wrong by a little. So an entry that is not read and may be one is
refused: by its name, or as a list as long as OpenCV's shortest.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

from rootmatch.errors import InputError, quote_value
from rootmatch.io.calibrations.values import read_numbers

COEFFICIENTS = frozenset(
    {"d", "dist", "distortion"} | {
        lens + word for lens in ("dist", "distortion") for word in
        ("coef", "coefs", "coeff", "coeffs", "coefficient", "coefficients")
    }
)  # fmt: skip
"""Names, as `spelled`, of a list k1, k2, p1, p2[, k3, …] in OpenCV's order."""
ONE_BY_ONE = frozenset(("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"))
MODEL_NAMES = frozenset(("distortionmodel", "distortiontype"))
"""Entries that say what the coefficients are."""
MODEL_HINTS = MODEL_NAMES | {"lensmodel", "lenstype", "cameramodel", "model", "projection"}
"""Entries that may say so, but may as well name a product."""
FISHEYES = frozenset(("equidistant", "fisheye", "kannalabrandt", "kannalabrandt4", "opencvfisheye"))
BROWNS = frozenset((
    "", "none", "plumbbob", "radtan", "radialtangential", "brown", "brownconrady", "rational", "rationalpolynomial",
    "opencv", "fullopencv", "pinhole", "perspective", "standard",
))  # fmt: skip
LENS_WORDS = re.compile(r"dist(?!an|rib)|lens|coef|radial|tangential|prism|^kc\d*$")
"""Words of a lens in a spelled name; distances and distributions are none."""
ABOUT = frozenset((
    "std", "stddev", "deviation", "deviations", "error", "errors", "covariance", "cov", "uncertainty", "removed",
    "undistorted", "undistort",
))  # fmt: skip
"""Words of names that say something about a lens, and do not give it."""
SCALARS = frozenset(("mm", "focal", "length", "aperture", "diameter", "position", "focus"))
"""Words of names of a number that belongs to a lens, and is no coefficient."""
METADATA = ABOUT | frozenset((
    "q", "r", "t", "date", "time", "timestamp", "stamp", "size", "width", "height", "resolution", "shape", "rms",
    "reprojection", "residual", "residuals", "count", "number", "num", "id", "ids", "index", "indices", "serial",
    "version", "frame", "frames", "view", "views", "image", "images", "point", "points", "corner", "corners", "board",
    "grid", "pattern", "square", "marker", "markers", "roi", "bbox", "rotation", "translation", "rvec", "rvecs",
    "tvec", "tvecs", "extrinsic", "extrinsics", "pose", "poses", "position", "orientation", "quaternion", "transform",
    "homography", "rectification", "projection", "intrinsic", "intrinsics", "matrix", "mtx", "essential",
    "fundamental", "disparity", "flag", "flags", "header", "overlap", "overlaps", "binning", "vertical", "axis",
    "center", "centre", "focal",
))  # fmt: skip
"""Words of names of lists that are no lens, whatever their length."""
MATRICES = frozenset(("e", "f", "h", "k", "m", "p"))
"""Names of matrices (OpenCV, ROS), which a short list of coefficients may have, too."""
SIZES = (9, 12, 16)
"""Numbers of a matrix that is written as one list."""
MINIMUM = 4
"""Length of OpenCV's shortest list of coefficients."""
REMEDY = (
    'this may be a lens, but is not read; if it is k1, k2, p1, p2[, k3, …] in OpenCV\'s order, name it "dist"; '
    "otherwise convert it to that, or remove it"
)


def normalise_name(name: object) -> str:
    """A name without capitals, underscores, hyphens and spaces: ``dist_coeffs`` is ``distCoeffs``."""
    return re.sub(r"[\s_-]", "", str(name)).lower()


def coefficients(path: Path, content: Mapping[str, Any], index: str = "") -> tuple[str | None, list[float]]:
    """The coefficients of a camera, and the name that they have; none, and no name, if no entry has such a name.

    Parameters
    ----------
    path : path
    content : mapping
        Entries of the file.
    index : str
        The camera's number, which follows the name: ``distCoeffs1``.
    """
    names = {name + index for name in COEFFICIENTS}
    given = [name for name, value in content.items() if value is not None and normalise_name(name) in names]
    values = {name: read_numbers(path, quote_value(name)[1:-1], content[name]) for name in given}
    for name in given[1:]:
        if values[name] != values[given[0]]:
            raise InputError(f"{path}: {given[0]} and {name} differ; a camera has one lens: leave one of them out")
    return (given[0], values[given[0]]) if given else (None, [])


def is_fisheye(path: Path, content: Mapping[str, Any]) -> bool:
    """Whether the entries say that the coefficients are those of a fisheye."""
    said = {normalise_name(name): normalise_name(value) for name, value in content.items() if isinstance(value, str)}
    if any(said.get(name) in FISHEYES for name in MODEL_HINTS):
        return True
    for name, value in content.items():
        if normalise_name(name) in MODEL_NAMES and isinstance(value, str) and normalise_name(value) not in BROWNS:
            raise InputError(
                f"{path}: {quote_value(name)[1:-1]} is {quote_value(value)}; "
                "give coefficients of plumb_bob or equidistant"
            )
    return False


def refuse_unread(where: object, content: Mapping[str, Any], known: Collection[str] = COEFFICIENTS) -> None:
    """Refuse an entry that may be a lens and is not all zeros; ``known``: names of others, written or `spelled`."""
    for name, value in content.items():
        if name in known or normalise_name(name) in known:
            continue
        if normalise_name(name) in ONE_BY_ONE and _parse_scalar(value):
            raise InputError(
                f'{where}: {name} is given on its own; give all coefficients as a list, "dist": [k1, k2, p1, p2, k3]'
            )
        if _is_suspected_lens(str(name), value):
            raise InputError(f"{where}: {quote_value(name)} is {quote_value(value)}; {REMEDY}")


def _is_suspected_lens(name: str, value: Any) -> bool:
    words = {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}
    if LENS_WORDS.search(normalise_name(name)):
        if isinstance(value, list | dict):
            return not words & ABOUT and any(_iterate_numbers(value))
        return bool(_parse_scalar(value)) and not words & (METADATA | SCALARS)
    return not words & METADATA and _is_long_list(value, matrices=bool(words) and words <= MATRICES)


def _is_long_list(value: Any, *, matrices: bool) -> bool:
    """Whether it is a row or a column of enough numbers, not all of them zero, and no matrix if those are likely."""
    if isinstance(value, dict) and "data" in value:
        if all((_parse_scalar(value.get(side)) or 1.0) > 1.0 for side in ("rows", "cols")):
            return False
        value = value["data"]
    if not isinstance(value, list) or not value:
        return False
    if all(isinstance(row, list) for row in value):
        if len(value) > 1 and max(map(len, value)) > 1:
            return False
        value = [entry for row in value for entry in row]
    found = [_parse_scalar(entry) for entry in value]
    if matrices and len(found) in SIZES:
        return False
    return len(found) >= MINIMUM and None not in found and any(found)


def _iterate_numbers(value: Any) -> Iterator[float]:
    """All numbers that lists and mappings hold, at any depth."""
    left = [value]
    while left:
        entry = left.pop()
        if isinstance(entry, list | dict):
            left += entry.values() if isinstance(entry, dict) and "data" not in entry else _flatten_entry(entry)
        elif (number := _parse_scalar(entry)) is not None:
            yield number


def _flatten_entry(entry: Any) -> list[Any]:
    """What a list, or a matrix as OpenCV writes it, holds."""
    data = entry["data"] if isinstance(entry, dict) else entry
    return data if isinstance(data, list) else [data]


def _parse_scalar(value: Any) -> float | None:
    """A number, or text that is one, which YAML makes of 1e5; None for all else."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        return float(value)
    except ValueError:
        return None
    except OverflowError:
        return math.inf
