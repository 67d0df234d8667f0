"""A camera matrix alone, as `numpy.savetxt` and `numpy.save` write it."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import InputError
from rootmatch.io.calibrations.values import prefix_errors, run_parser

EXPECTED = "give a camera matrix (3, 3) of numbers"


def parse_matrix_rows(text: str) -> list[list[float]] | None:
    """Three rows of three numbers, with spaces or commas between them; None of any other text."""
    rows = [line.split("#")[0].replace(",", " ").split() for line in text.splitlines()]
    rows = [row for row in rows if row]
    try:
        return [list(map(float, row)) for row in rows] if list(map(len, rows)) == [3, 3, 3] else None
    except ValueError:
        return None


def read_matrix(path: Path, rows: Any) -> dict[str, Camera]:
    """The camera of a matrix, by the name of a camera that is alone in its file."""
    with prefix_errors(path):
        return {"camera": Camera.from_matrix(rows)}


def read_npy(path: Path, data: bytes) -> dict[str, Camera]:
    """The camera of an array that `numpy.save` wrote; no other array is loaded."""

    def load() -> Any:
        stream = io.BytesIO(data)
        newer = np.lib.format.read_magic(stream) != (1, 0)
        header = np.lib.format.read_array_header_2_0 if newer else np.lib.format.read_array_header_1_0
        shape, _, dtype = header(stream)
        if shape != (3, 3) or dtype.kind not in "fiu":
            raise InputError(f"{path}: an array of shape {shape} and type {dtype.name[:40]}; {EXPECTED}")
        return np.load(io.BytesIO(data), allow_pickle=False)

    return read_matrix(path, run_parser(path, "an array of NumPy", load))
