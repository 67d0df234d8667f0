"""Sorting in jitted code: `numpy.sort` there takes longer to compile than all else of most kernels that call it."""

from __future__ import annotations

from rootmatch.jit.internal import internal_function


@internal_function()
def shell_sort(values, first, last):  # type: ignore[no-untyped-def]
    """Bring values[first:last] into ascending order, in place, by Shell's steps (Knuth's gaps 1, 4, 13, …)."""
    gap = 1
    while 9 * gap < last - first:
        gap = 3 * gap + 1
    while gap > 0:
        for t in range(first + gap, last):
            value = values[t]
            s = t
            while s - gap >= first and values[s - gap] > value:
                values[s] = values[s - gap]
                s -= gap
            values[s] = value
        gap //= 3
