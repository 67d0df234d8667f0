"""The sparse affinity tensor of any order: each hyper-edge once, with its weight."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import permutations
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.errors import InputError, quote_value
from rootmatch.hypergraph import contraction
from rootmatch.hypergraph.assignment import check_assignment, one_hot
from rootmatch.hypergraph.layouts import Layout, to_row_major
from rootmatch.hypergraph.rows import are_one_to_one, unique_rows

_FAULTS = {
    contraction.OUT_OF_RANGE: "a correspondence is outside 0 … n·n'−1; flat indices are a = i·n' + i'",
    contraction.SHARED_SOURCE: "two correspondences share a source point; drop this hyper-edge",
    contraction.SHARED_TARGET: "two correspondences share a target point; drop this hyper-edge",
    contraction.BAD_WEIGHT: "the weight must be finite and not negative; convert residuals to weights first",
}


@dataclass(frozen=True, eq=False)
class AffinityTensor:
    """Symmetric tensor H of affinities among d correspondences, mixed with optional weights of single ones.

    A correspondence (i, i') of n source and n' target points has the flat index a = i·n' + i'. The objective of an
    assignment X is the sum of the weights of the hyper-edges inside it plus its unary weights: with x ∈ {0, 1}^{n n'},
    S(x) = Σ_e h_e Π_{a∈e} x_a + Σ_a u_a x_a, which is Σ H x⊗…⊗x / d! of the full symmetric tensor.

    Memory: 4 d + 8 bytes a hyper-edge (24 at order 4).

    Parameters
    ----------
    indices : (E, d) int32
        Flat indices of each hyper-edge, in any order; d ≥ 2. The same set of correspondences may come twice: it then
        counts twice, see `merged`.
    weights : (E,) float64
        Finite, not negative.
    shape : (int, int)
        n and n'.
    unary : (n, n') float64, optional
        Weights of single correspondences (a prior), finite, not negative.

    Raises
    ------
    InputError
        For an index out of range, two correspondences of a hyper-edge that share a point, bad weights or shapes.
    """

    indices: NDArray[np.int32]
    weights: NDArray[np.float64]
    shape: tuple[int, int]
    unary: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        n, n_target = self._check_shape()
        given = np.asarray(self.indices)
        if given.ndim != 2 or given.shape[1] < 2 or not (np.issubdtype(given.dtype, np.integer) or given.size == 0):
            raise InputError(
                f"indices: got {given.dtype} of shape {given.shape}; expected integers (hyper-edges, order), order ≥ 2"
            )
        # Before the cast to 32 bits, which would wrap around.
        if given.size and (int(given.max()) >= n * n_target or int(given.min()) < 0):
            raise InputError(
                f"indices: got {given.min()} … {given.max()}; expected flat indices i·n' + i' in 0 … {n * n_target - 1}"
            )
        indices = np.require(given, np.int32, ["C", "W", "A"])
        weights = _float_array("weights", self.weights)
        if weights.shape != (indices.shape[0],):
            turned = f"; indices {indices.shape} look transposed" if weights.shape == indices.shape[1:] else ""
            raise InputError(
                f"weights: got shape {weights.shape}; expected ({indices.shape[0]},), one a hyper-edge{turned}"
            )
        fault, edge = contraction.first_fault(indices, weights, n, n_target)
        if fault != contraction.VALID:
            pairs = [divmod(int(a), n_target) for a in indices[edge]]
            raise InputError(f"hyper-edge {edge}, (i, i') = {pairs}, weight {weights[edge]:g}: {_FAULTS[fault]}")
        self._set(indices, weights, (n, n_target), self._check_unary(n, n_target))

    def _set(self, *values: Any) -> None:
        for name, value in zip(("indices", "weights", "shape", "unary"), values, strict=True):
            object.__setattr__(self, name, value)

    def _check_shape(self) -> tuple[int, int]:
        try:
            n, n_target = (int(m) for m in self.shape)
        except (TypeError, ValueError):
            raise InputError(f"shape: got {self.shape!r}; expected two numbers of points (n, n')") from None
        if n < 1 or n_target < 1 or n * n_target >= 2**31:
            raise InputError(f"shape: got {(n, n_target)}; expected n, n' ≥ 1 and n·n' < 2³¹")
        return n, n_target

    def _check_unary(self, n: int, n_target: int) -> NDArray[np.float64] | None:
        if self.unary is None:
            return None
        unary = _float_array("unary", self.unary)
        if unary.shape != (n, n_target):
            raise InputError(f"unary: got shape {unary.shape}; expected (n, n') = {(n, n_target)}")
        if not np.all((unary >= 0) & np.isfinite(unary)):
            raise InputError("unary: every weight must be finite and not negative")
        return unary

    @classmethod
    def unchecked(
        cls,
        indices: NDArray[np.int32],
        weights: NDArray[np.float64],
        shape: tuple[int, int],
        unary: NDArray[np.float64] | None = None,
    ) -> AffinityTensor:
        """Tensor from arrays known to be valid, contiguous and of these types; for callers that build millions."""
        tensor = object.__new__(cls)
        tensor._set(indices, weights, shape, unary)
        return tensor

    def __repr__(self) -> str:
        n, n_target = self.shape
        prior = "" if self.unary is None else ", unary weights"
        return f"AffinityTensor({self.size} hyper-edges of order {self.order}, {n} × {n_target}{prior})"

    @property
    def order(self) -> int:
        """Number of correspondences in a hyper-edge, d."""
        return int(self.indices.shape[1])

    @property
    def size(self) -> int:
        """Number of hyper-edges, E."""
        return int(self.weights.size)

    def contract(self, x: ArrayLike) -> NDArray[np.float64]:
        """Gradient of the objective: v_a = Σ_{e∋a} h_e Π_{b∈e, b≠a} x_b + u_a, for x and v of shape (n, n').

        For a binary x this is what each correspondence adds, or would add, to the score. The result does not depend on
        the number of threads. Tensors above 64 k hyper-edges use `numba.get_num_threads()` threads.
        """
        soft = self._check_soft(x)
        v = contraction.contract(self.indices, self.weights, soft.ravel()).reshape(self.shape)
        return v if self.unary is None else v + self.unary

    def _check_soft(self, x: ArrayLike) -> NDArray[np.float64]:
        soft = _float_array("x", x)
        if soft.shape != self.shape:
            raise InputError(f"x: got shape {soft.shape}; expected (n, n') = {self.shape}")
        return soft

    def marginals(self) -> NDArray[np.float64]:
        """Total weight of the hyper-edges that contain each correspondence, (n, n'); unary weights are not in it."""
        v = self.contract(np.ones(self.shape))
        return v if self.unary is None else v - self.unary

    def score(self, assignment: ArrayLike) -> float:
        """Objective of an assignment (n,): the target of each source point, each once at most; −1 where unmatched."""
        chosen = self._indicator(assignment)
        edges = contraction.find_inside(self.indices, chosen.ravel())
        score = float(self.weights[edges].sum())
        return score if self.unary is None else score + float(self.unary[chosen].sum())

    def inside(self, assignment: ArrayLike) -> AffinityTensor:
        """The hyper-edges inside an assignment, which make up its score, as a small tensor."""
        chosen = self._indicator(assignment)
        edges = contraction.find_inside(self.indices, chosen.ravel())
        unary = None if self.unary is None else np.where(chosen, self.unary, 0.0)
        return AffinityTensor.unchecked(self.indices[edges], self.weights[edges], self.shape, unary)

    def _indicator(self, assignment: ArrayLike) -> NDArray[np.bool_]:
        return one_hot(check_assignment(assignment, self.shape), self.shape[1]) > 0.0

    def support(self) -> NDArray[np.float64]:
        """Weights of the other hyper-edges that share d−1 correspondences with each, summed, (E,).

        Exact, by sorting: about 60 d bytes a hyper-edge for the while. (`MultiStartAscent` has a faster, lossy one.)
        """
        if self.size == 0:
            return np.zeros(0)
        rows = np.sort(self.indices, axis=1)
        columns = np.arange(self.order)
        subsets = np.concatenate([rows[:, columns != p] for p in columns])
        _, group = unique_rows(subsets, math.prod(self.shape))
        totals = np.bincount(group, np.tile(self.weights, self.order))
        shared: NDArray[np.float64] = totals[group].reshape(self.order, -1).sum(axis=0)
        # Rounding must not make a lonely hyper-edge's support negative.
        return np.maximum(shared - self.order * self.weights, 0.0)

    def merged(self, how: Literal["max", "sum"] = "max") -> AffinityTensor:
        """Tensor with each set of correspondences once, correspondences ascending and hyper-edges sorted.

        A hyper-edge that random sampling draws twice is one and the same entry of the tensor, so one is kept ("max":
        the two weights may differ by rounding). "sum" adds them up.
        """
        if how not in ("max", "sum"):
            raise InputError(f"how: got {how!r}; expected 'max' or 'sum'")
        if self.size == 0:
            return self
        rows = np.sort(self.indices, axis=1)
        first, group = unique_rows(rows, math.prod(self.shape))
        weights = np.zeros(first.size)
        (np.add if how == "sum" else np.maximum).at(weights, group, self.weights)
        return AffinityTensor.unchecked(np.ascontiguousarray(rows[first]), weights, self.shape, self.unary)

    @classmethod
    def from_coo(
        cls,
        coordinates: ArrayLike,
        values: ArrayLike,
        shape: tuple[int, int],
        *,
        layout: Layout | None = None,
        conflicts: Literal["error", "drop"] = "error",
    ) -> AffinityTensor:
        """Tensor from coordinates (d, nnz) and values (nnz,) of nonzero entries, as in `scipy.sparse.coo_array`.

        An entry may be given once, or in several orders of its indices with equal values (a full symmetric tensor).
        At order 2 the diagonal becomes the unary weights. Entries whose correspondences share a point can never count
        in a one-to-one assignment: an error, or dropped with ``conflicts="drop"``.

        ``layout``: how a pair (i, i') became one index: ``"row"``, i·n' + i' as in this class, or ``"column"``,
        i'·n + i as in pygmtools and MATLAB. Say which: in the other layout the same numbers are another problem. Left
        out it is ``"row"``, with a warning where the entries fit both layouts or, as those of a full matrix, neither,
        and an error where they fit only ``"column"``.
        """
        return cls._from_entries(coordinates, values, shape, layout=layout, conflicts=conflicts)

    @classmethod
    def _from_entries(
        cls, coordinates: Any, values: Any, shape: tuple[int, int], *, layout: Any = None, conflicts: str = "error"
    ) -> AffinityTensor:
        """As `from_coo`, for all constructors, so that a warning of the layout names the line of their caller."""
        n, n_target = (int(m) for m in shape)
        flat = np.atleast_2d(np.asarray(coordinates)).T
        if flat.size and flat.dtype.kind not in "iu":
            raise InputError(f"coordinates: got {flat.dtype}; expected integers, as those of `indices`")
        value = _float_array("values", values)
        if value.shape != (flat.shape[0],):
            raise InputError(f"values: got shape {value.shape}; expected ({len(flat)},), one a column of coordinates")
        if flat.size and (flat.min() < 0 or flat.max() >= n * n_target):
            raise InputError(f"coordinates: got {flat.min()} … {flat.max()}; expected 0 … {n * n_target - 1}")
        flat, value = flat[value != 0].astype(np.int64), value[value != 0]
        flat = to_row_major(flat, (n, n_target), layout)
        unary = None
        if flat.shape[1] == 2:
            diagonal = flat[:, 0] == flat[:, 1]
            if diagonal.any():
                unary = np.zeros((n, n_target))
                np.add.at(unary.ravel(), flat[diagonal, 0], value[diagonal])
                flat, value = flat[~diagonal], value[~diagonal]
        if conflicts == "drop":
            ok = are_one_to_one(flat, n_target)
            flat, value = flat[ok], value[ok]
        given = cls(flat.astype(np.int32), value, (n, n_target), unary)
        merged = given.merged("max")
        _, group = unique_rows(np.sort(given.indices, axis=1), n * n_target)
        if np.any(merged.weights[group] - given.weights > 1e-9 * merged.weights[group]):
            raise InputError("values: an entry differs between two orders of its indices; symmetrise first")
        return merged

    def to_coo(
        self, *, symmetric: bool = True, layout: Layout = "row"
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Coordinates (d, nnz) and values (nnz,): all d! orders of a hyper-edge, or one; unary at order 2 only."""
        tensor, n, n_target = self.merged("sum"), *self.shape
        flat = tensor.indices.astype(np.int64)
        if layout == "column":
            flat = flat % n_target * n + flat // n_target
        orders = list(permutations(range(self.order))) if symmetric else [tuple(range(self.order))]
        coordinates = np.concatenate([flat[:, list(p)].T for p in orders], axis=1)
        values = np.tile(tensor.weights, len(orders))
        if self.order == 2 and self.unary is not None:
            diagonal = (self.unary if layout == "row" else self.unary.T).ravel()
            where = np.flatnonzero(diagonal)
            coordinates = np.concatenate([coordinates, np.stack([where, where])], axis=1)
            values = np.concatenate([values, diagonal[where]])
        return coordinates, values

    @classmethod
    def from_dense(
        cls,
        dense: ArrayLike,
        shape: tuple[int, int],
        *,
        layout: Layout | None = None,
        conflicts: Literal["error", "drop"] = "error",
    ) -> AffinityTensor:
        """Tensor from a full symmetric array (n n',)·d; see `from_coo` for the options."""
        array = _float_array("dense", dense)
        side = math.prod(int(m) for m in shape)
        if array.ndim < 2 or set(array.shape) != {side}:
            raise InputError(f"dense: got shape {array.shape}; expected n·n' = {side} along each of d ≥ 2 axes")
        if not np.all(np.isfinite(array)):
            raise InputError(f"dense: NaN or infinity in {np.count_nonzero(~np.isfinite(array))} entries; put numbers")
        if not all(np.allclose(array, np.swapaxes(array, p, p + 1), rtol=1e-9, atol=0) for p in range(array.ndim - 1)):
            raise InputError("dense: the array is not symmetric; average it over all orders of its axes first")
        where = np.nonzero(array)
        return cls._from_entries(np.stack(where), array[where], shape, layout=layout, conflicts=conflicts)

    def to_dense(self, *, layout: Layout = "row", max_bytes: float = 1e9) -> NDArray[np.float64]:
        """Full symmetric array (n n',)·d, the unary weights on the diagonal at order 2 (lost at higher orders)."""
        side = math.prod(self.shape)
        if (needed := 8.0 * float(side) ** self.order) > max_bytes:
            raise InputError(
                f"the dense tensor of {side}^{self.order} entries takes {needed:.3g} bytes, above max_bytes = "
                f"{max_bytes:.3g}: use to_coo(), or raise max_bytes"
            )
        dense = np.zeros((side,) * self.order)
        coordinates, values = self.to_coo(layout=layout)
        dense[tuple(coordinates)] = values
        return dense

    @classmethod
    def from_scipy(cls, matrix: Any, shape: tuple[int, int], **options: Any) -> AffinityTensor:
        """Tensor of order 2 from a symmetric `scipy.sparse` matrix (n n', n n'); options as in `from_coo`."""
        entries = matrix.tocoo()
        return cls._from_entries(np.stack([entries.row, entries.col]), entries.data, shape, **options)

    def to_scipy(self, *, layout: Layout = "row") -> Any:
        """Symmetric `scipy.sparse.csr_array` (n n', n n') of a tensor of order 2."""
        if self.order != 2:
            raise InputError(f"a sparse matrix holds order 2 only; this tensor has order {self.order}: use to_coo()")
        from scipy.sparse import csr_array

        coordinates, values = self.to_coo(layout=layout)
        return csr_array((values, tuple(coordinates)), shape=(math.prod(self.shape),) * 2)


def _float_array(name: str, value: ArrayLike) -> NDArray[np.float64]:
    try:
        given = np.asarray(value)
        if given.dtype.kind == "c":
            raise TypeError
        return np.require(given, np.float64, ["C", "W", "A"])
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected an array of real numbers, got {quote_value(value)}") from None


def strongest_assignments(tensor: AffinityTensor, shape: tuple[int, int], maximum: int) -> NDArray[np.int64]:
    """Assignments (K, n) of the hyper-edges with the largest weights, each alone; ``shape``: (n, n')."""
    order = np.argsort(-np.asarray(tensor.weights), kind="stable")[:maximum]
    i, j = np.divmod(tensor.indices[order].astype(np.int64), shape[1])
    rows = np.full((len(order), shape[0]), -1, np.int64)
    np.put_along_axis(rows, i, j, axis=1)
    return rows
