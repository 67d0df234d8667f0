"""The strongest hyper-edges out of a stream, and an enumeration of all hyper-edges to draw them from."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from rootmatch.deadline import NEVER, Deadline, OutOfTime, Pace
from rootmatch.hypergraph import enumeration

Progress = Callable[[int, int], None]
Block = tuple[NDArray[np.int32], NDArray[np.int32]]
"""Source and target indices (B, d) of hyper-edges."""


class Found(NamedTuple):
    """Hyper-edges below a gate."""

    codes: NDArray[np.int64]
    """(E,) their numbers in the enumeration, ascending."""
    residuals: NDArray[np.float64]
    """(E,)"""
    evaluated: int
    """Number of hyper-edges that were evaluated."""


@dataclass(frozen=True, eq=False)
class Enumeration:
    """All hyper-edges of two point sets in a fixed order.

    A slab, a minimal set of source points with an arrangement of as many targets, has a rank; the last point and its
    target follow within it. The number of a hyper-edge is ((rank · n) + last source) · n' + last target.
    """

    tables: Any
    """Of `Problem.prepare`."""
    kind: Any
    bases: NDArray[np.int64]
    """(B, d − 1) minimal sets of source points, increasing; the last point runs from the last of them + 1 on."""
    arrangements: NDArray[np.int32]
    """(P, d − 1) all arrangements of d − 1 targets."""
    allowed: NDArray[np.bool_]
    """(n, n'), or (0, 0) for all: candidate correspondences."""
    shape: tuple[int, int]
    """(n, n')."""

    @classmethod
    def of(
        cls, tables: Any, kind: Any, shape: tuple[int, int], order: int, candidates: NDArray[np.bool_] | None
    ) -> Enumeration:
        """The hyper-edges of order d of n and n' points, those among the candidates."""
        allowed = np.empty((0, 0), np.bool_) if candidates is None else np.ascontiguousarray(candidates, np.bool_)
        points, targets = (None if candidates is None else np.asarray(allowed.any(axis=axis)) for axis in (1, 0))
        return cls(
            tables=tables,
            kind=kind,
            bases=enumeration.source_bases(shape[0], order, points),
            arrangements=enumeration.target_arrangements(shape[1], order - 1, targets),
            allowed=allowed,
            shape=shape,
        )

    @property
    def order(self) -> int:
        """Number of correspondences in a hyper-edge, d."""
        return int(self.bases.shape[1]) + 1

    @property
    def ranks(self) -> int:
        """Number of slabs that the enumeration is cut into."""
        return len(self.bases) * len(self.arrangements)

    @property
    def per_slab(self) -> int:
        """Average number of hyper-edges in a slab, at least 1."""
        return max(1, enumeration.exhaustive_count(*self.shape, self.order) // max(self.ranks, 1))


class Strongest:
    """Keeps the ``limit`` hyper-edges of least residual out of a stream, and the gate below which more can enter.

    Of equal residuals those of lesser number are kept, so that what is kept depends neither on the order of the stream
    nor on the blocks it comes in. In place, with room for an eighth more than are kept: at most 27 bytes each while the
    least are chosen.
    """

    def __init__(self, limit: int, gate: float) -> None:
        self.limit = limit
        self.gate = gate
        self.codes, self.residuals = np.empty(0, np.int64), np.empty(0)
        self.held = 0

    def add(self, codes: NDArray[np.int64], residuals: NDArray[np.float64]) -> None:
        """Add hyper-edges, one part of the stream."""
        maximum = self.limit + max(self.limit // 8, 1)
        first = 0
        while first < len(codes):
            last = first + maximum - self.held
            below = residuals[first:last] <= self.gate
            held = self.held + int(np.count_nonzero(below))
            if held > len(self.codes):
                # by half again and again, so that what is held is seldom moved
                self._resize(min(maximum, max(held, len(self.codes) + len(self.codes) // 2)))
            self.codes[self.held : held] = codes[first:last][below]
            self.residuals[self.held : held] = residuals[first:last][below]
            self.held, first = held, last
            if held == maximum:
                self._choose()

    def _resize(self, room: int) -> None:
        self.codes.resize(room, refcheck=False)
        self.residuals.resize(room, refcheck=False)

    def _choose(self) -> None:
        """Drop all hyper-edges but the ``limit`` of least residual."""
        if self.held <= self.limit:
            return
        residuals = self.residuals[: self.held]
        worst = np.partition(residuals, self.limit - 1)[self.limit - 1]
        keep = residuals < worst
        ties = np.flatnonzero(residuals == worst)
        keep[ties[np.argsort(self.codes[ties])[: self.limit - np.count_nonzero(keep)]]] = True
        # the last of those that stay move to the places of the first that go
        free, moved = np.flatnonzero(~keep[: self.limit]), self.limit + np.flatnonzero(keep[self.limit :])
        self.codes[free], self.residuals[free] = self.codes[moved], self.residuals[moved]
        self.held = self.limit
        self.gate = min(self.gate, float(worst))

    def settle(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the hyper-edges that are kept, in ascending order of their numbers."""
        self._choose()
        self._resize(self.held)
        if np.any(self.codes[1:] < self.codes[:-1]):
            order = np.argsort(self.codes)
            self.codes, self.residuals = self.codes[order], self.residuals[order]
        return self.codes, self.residuals


Sweep = Callable[[int, int, Strongest], int]
"""Adds what is below the gate in a range of ranks, and counts evaluations."""


def make_strongest(sweep_of: Callable[[Enumeration], Sweep], block: int, first_block: int) -> Callable[..., Found]:
    """`Backend.strongest` by sweeps of an enumeration.

    ``first_block`` hyper-edges are swept at first and twice as many each time, up to ``block``, between two looks at
    the time. Each sweep lowers the gate of the next, so that of a large block few pass: to copy and to choose among
    them takes longer than the sweep.
    """

    def strongest(
        work: Enumeration,
        first: int,
        last: int,
        gate: float,
        limit: int,
        progress: Progress | None = None,
        deadline: Deadline = NEVER,
    ) -> Found:
        sweep, kept = sweep_of(work), Strongest(limit, gate)
        maximum, step = (max(1, size // work.per_slab) for size in (block, first_block))
        total, rank = 0, first
        pace = Pace(deadline, step)
        while rank < last and (slabs := pace.block(step)):
            end = min(rank + slabs, last)
            try:
                total += sweep(rank, end, kept)
            except OutOfTime:
                break
            rank, step = end, min(2 * step, maximum)
            if progress is not None:
                progress(rank - first, last - first)
        return Found(*kept.settle(), total)

    return strongest


class Backend(Protocol):
    """An evaluator of hyper-edges: a module of this package, or several machines together."""

    def strongest(
        self,
        work: Enumeration,
        first: int,
        last: int,
        gate: float,
        limit: int,
        progress: Progress | None = None,
        deadline: Deadline = NEVER,
    ) -> Found:
        """The ``limit`` strongest hyper-edges below the gate among the slabs of ranks ``first … last − 1``.

        ``progress`` is called with (slabs done, slabs in all). At the deadline the slabs that are left are left out.
        """

    def evaluated(self, tables: Any, kind: Any, blocks: Iterable[Block]) -> Iterator[tuple[Block, NDArray[np.float64]]]:
        """The blocks in their order, with the residuals (B,) of each."""
