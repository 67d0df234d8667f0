"""Kernels of the completion: every image of a minimal set with each detection that it predicts for another point."""

from __future__ import annotations

from typing import Any

import numpy as np

from rootmatch.algebra.vector import tangent_basis
from rootmatch.arrays import Bools, Integers
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, scalar
from rootmatch.jit.dispatch import dispatch_to_kernel
from rootmatch.problems.kernels import STRIDE, CompletionKernels, kernel_record
from rootmatch.problems.padding import pad_tables


def completion_kernels(tables: Any) -> CompletionKernels:
    """The kernels of some tables, or of their Numba type, which must have them."""
    kernels = kernel_record(tables).completion
    if kernels is None:
        raise TypeError(f"{tables}: no kernels for completion; ask can_complete() first")
    return kernels


def can_complete(tables: Any) -> bool:
    """Whether some tables have the kernels for the completion of minimal sets."""
    return kernel_record(tables).completion is not None


predict_block = dispatch_to_kernel(completion_kernels, "predict")
"""Prediction of some points at one root; see `CompletionKernels`."""

FIRST_ROOM = 4096
"""Completions of one minimal set that there is room for at first; it grows as needed."""


class Completions:
    """Completions of the minimal sets of one problem instance; one for each thread.

    Parameters
    ----------
    tables
    images : (P, m) int64 array
        Images of a minimal set, all that are tried.
    gate2 : float
        χ² of a detection about a prediction, two degrees of freedom, within which it completes the set.
    allowed : (n, n') bool array, or (0, 0) for all
    """

    def __init__(self, tables: Any, images: Integers, gate2: float, allowed: Bools) -> None:
        self.tables, self.images, self.gate2, self.allowed = tables, images, gate2, allowed
        self.wide = pad_tables(tables, tables.rays.shape[1])
        kernels = completion_kernels(tables)
        self.solutions, fields = kernels.solutions, kernels.fields
        self.rows = np.concatenate([getattr(tables, name) for name in fields])
        self.flat, self.out = np.zeros((len(self.rows), STRIDE)), np.zeros(7 * STRIDE)
        self.found = np.empty((FIRST_ROOM, images.shape[1] + 2), np.int64)

    def of(self, base: Integers, others: Integers) -> tuple[Integers, int]:
        """Hyper-edges of one minimal set (m,) of source points and one of some other points (K,).

        Returns
        -------
        targets : (E, 1 + m + 1) int64 array
            The other source point, the images of the set in its order, and the image of the other.
        evaluated : int
            Minimal sets solved and points predicted.
        """
        step = STRIDE - len(base)
        parts = [self._complete_some(base, others[first : first + step]) for first in range(0, len(others), step)]
        return np.concatenate([found for found, _ in parts]), sum(evaluated for _, evaluated in parts)

    def _complete_some(self, base: Integers, others: Integers) -> tuple[Integers, int]:
        points = np.concatenate([base, others])
        self.flat[:, : len(points)] = self.rows[:, points]
        allowed = self.allowed[points] if self.allowed.size else self.allowed
        while True:
            count, evaluated = _complete(
                self.wide, self.flat.reshape(-1), len(points), self.solutions, self.tables.rays.shape[1],
                self.images, self.gate2, allowed, self.out, self.found,
            )  # fmt: skip
            if count <= len(self.found):
                found = self.found[:count].copy()
                found[:, 0] = points[found[:, 0]]
                return found, int(evaluated)
            self.found = np.empty((2 * count, self.found.shape[1]), np.int64)


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def _complete(tables, flat, points, solutions, n_target, images, gate2, allowed, out, found):  # type: ignore[no-untyped-def]
    """Fill ``found`` with the completions of the set of the first m points; their number, and that of evaluations."""
    tables, flat, images, allowed, out, found = borrow((tables, flat, images, allowed, out, found))
    m = images.shape[1]
    masked = allowed.shape[0] > 0
    rays, variance = tables.rays, tables.variance
    count, evaluated = 0, 0
    for arrangement in range(images.shape[0]):
        j = images[arrangement]
        possible = True
        for p in range(m):
            possible = possible and (not masked or allowed[p, j[p]])
        if not possible:
            continue
        evaluated += 1
        for root in range(solutions):
            if not predict_block(tables, flat, points, j, root, out):
                continue
            evaluated += points - m
            for d in range(m, points):
                if out[6 * STRIDE + d] == 0.0:
                    continue
                x, y, z = out[d], out[STRIDE + d], out[2 * STRIDE + d]
                s11, s12, s22 = out[3 * STRIDE + d], out[4 * STRIDE + d], out[5 * STRIDE + d]
                (e0, e1, e2), (f0, f1, f2) = tangent_basis(x, y, z)
                near = 0
                for k in range(rays.shape[1]):
                    near += (
                        1 if _agrees(rays, variance, k, x, y, z, e0, e1, e2, f0, f1, f2, s11, s12, s22, gate2) else 0
                    )
                if near == 0:
                    continue
                for k in range(n_target):
                    if masked and not allowed[d, k]:
                        continue
                    if not _agrees(rays, variance, k, x, y, z, e0, e1, e2, f0, f1, f2, s11, s12, s22, gate2):
                        continue
                    taken = False
                    for p in range(m):
                        taken = taken or j[p] == k
                    if not taken:
                        if count < found.shape[0]:
                            found[count, 0] = d
                            for p in range(m):
                                found[count, 1 + p] = j[p]
                            found[count, 1 + m] = k
                        count += 1
    return count, evaluated


@scalar
def _agrees(rays, variance, k, x, y, z, e0, e1, e2, f0, f1, f2, s11, s12, s22, gate2):  # type: ignore[no-untyped-def]
    """Whether a detection is within the gate of a prediction (x, y, z), and not behind the camera."""
    u, v, w = rays[0, k], rays[1, k], rays[2, k]
    e, f = e0 * u + e1 * v + e2 * w, f0 * u + f1 * v + f2 * w
    a, b = s11 + variance[k], s22 + variance[k]
    close = e * e * b - 2.0 * e * f * s12 + f * f * a <= gate2 * (a * b - s12 * s12)
    return close & (x * u + y * v + z * w > 0.0)
