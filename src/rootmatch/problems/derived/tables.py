"""Tables and dispatch of derived problems: one type for all, told apart by a tag that is part of the type.

The drivers find a kernel by the types of their arguments, and their compiled form on disk by the same types. A class
made anew for every derived problem could not be found again in the next process. So all derived problems share
`DerivedTables`, whose last field is an array of one record; the record's only field bears the name of the problem's
generated code (a digest of it). The name is part of the array's type: another problem is another type, and the same
problem is the same type in any process.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats
from rootmatch.problems.kernels import ProblemKernels


class DerivedTables(NamedTuple):
    """Quantities of one and of two points, and their derivatives in unit noise."""

    source: Floats
    """(quantities, n)."""
    source_pair: Floats
    """(quantities, n, n)."""
    target: Floats
    """(quantities, n')."""
    target_pair: Floats
    """(quantities, n', n')."""
    source_noise: Floats
    """(quantities · D, n), D the noise dimensions of a source point."""
    source_pair_noise: Floats
    """(quantities · 2 · D, n, n): of each quantity D derivatives in the first point's noise, then D in the second's."""
    target_noise: Floats
    """(quantities · D, n'), D the noise dimensions of a target point."""
    target_pair_noise: Floats
    """(quantities · 2 · D, n', n'), in the order of `source_pair_noise`."""
    tag: Any
    """(1,) record array whose field's name tells the problem."""

    @staticmethod
    def kernels_of(tables: Any) -> ProblemKernels:
        """The record of the kernels of the problem that some tables, or their Numba type, belong to."""
        tag = tables.types[DerivedTables._fields.index("tag")] if hasattr(tables, "types") else tables.tag
        (name,) = tag.dtype.fields
        return REGISTERED[name]


REGISTERED: dict[str, ProblemKernels] = {}
"""The kernels of the problems met in this process, by their tags."""


def make_tag(name: str) -> NDArray[Any]:
    """The tag of generated code of that name."""
    return np.zeros(1, dtype=np.dtype([(name, np.float64)]))
