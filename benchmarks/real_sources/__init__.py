"""Downloaded snapshots of the source repositories to the data sets of the benchmark, a module each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from real_sources import boards, candidates, cavity, facade, film, headset, targets
from real_sources.common import Fields, opencv_errors
from rootmatch.errors import InputError
from rootmatch.io import write_atomically

SOURCES: dict[str, Callable[[Path], Fields]] = {
    "vive_hmd_lighthouse": headset.convert,
    "openptv_cavity_target": cavity.convert,
    "tears_of_steel_01": film.convert,
    "berlin_facade": facade.convert,
    "opencv_chessboard_stereo": boards.convert,
    "aicon_targets": targets.convert,
    "tless_candidates": candidates.convert,
}
"""The converter of each data set."""


def convert(name: str, snapshot: Path, output: Path) -> Path:
    """Write the data set of this name, made from a snapshot of its source; returns the file's path.

    Parameters
    ----------
    name : str
        One of `SOURCES`.
    snapshot : path
        Folder of the downloaded repository, or of the part of it that the converter's module names.
    output : path
        Folder for the .npz file, made where it is absent.

    Raises
    ------
    InputError
        If the name is unknown, or the snapshot does not hold what is read.
    """
    if name not in SOURCES:
        raise InputError(f"data set: {name!r} given; one of {', '.join(SOURCES)} expected")
    if not snapshot.is_dir():
        raise InputError(f"snapshot: {snapshot} is not a folder")
    try:
        fields = SOURCES[name](snapshot)
    except (*opencv_errors(), ValueError, IndexError, KeyError, OSError) as error:  # type: ignore[misc]
        raise InputError(f"snapshot: {snapshot} does not hold what {name} is made of ({error!r})") from None
    output.mkdir(parents=True, exist_ok=True)
    path = output / f"{name}.npz"
    with write_atomically(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **fields)  # type: ignore[arg-type]
    return path
