"""Layouts of pairs in tensors of other libraries: how a correspondence (i, i') became one index there."""

from __future__ import annotations

import warnings
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rootmatch.errors import InputError, InputWarning
from rootmatch.hypergraph.rows import are_one_to_one

Layout = Literal["row", "column"]
"""Row: i·n' + i', as in `AffinityTensor`; column: i'·n + i, as in pygmtools and MATLAB."""


def to_row_major(flat: NDArray[np.int64], shape: tuple[int, int], layout: Layout | None) -> NDArray[np.int64]:
    """Indices (E, d) of entries as this package has them, i·n' + i'.

    In the other layout the same numbers are another problem. Where the layout is not given it is taken as ``"row"``,
    with a warning unless the entries fit that alone: with conflicts in both, as a full matrix has, they tell nothing.
    """
    n, n_target = shape
    other = flat % n * n_target + flat // n
    if layout == "column":
        return other
    if layout not in ("row", None):
        raise InputError(f'layout: {layout!r} given; give "row" for i·n\' + i\', or "column" for i\'·n + i')
    several = (np.diff(np.sort(flat, axis=1), axis=1) > 0).all(axis=1)  # weights of single pairs fit any layout
    rows, columns = flat[several], other[several]
    if layout is None and not np.array_equal(rows, columns):
        fits_rows, fits_columns = (bool(are_one_to_one(one, n_target).all()) for one in (rows, columns))
        if fits_columns and not fits_rows:
            raise InputError(
                'layout: the entries fit layout="column", i\'·n + i as in pygmtools and MATLAB, and not "row", the '
                "default; give the layout"
            )
        if fits_rows == fits_columns:
            warnings.warn(
                f'layout: not given, and the entries fit {"both" if fits_rows else "neither"}; taken as "row", '
                "i·n' + i', while pygmtools and MATLAB have \"column\"; say which",
                InputWarning,
                stacklevel=4,
            )
    return flat
