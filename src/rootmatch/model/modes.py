"""Modes of a posterior: poses of one body, each with its assignment."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Floats, Integers


class Modes(NamedTuple):
    """M poses of one body, each with its assignment, the most probable first.

    Attributes
    ----------
    assignments : (M, n) int64
    rotation, position : (M, 3, 3) and (M, 3) float64
        Of the body and its centre in the camera frame.
    covariance : (M, 6, 6) float64
    log_odds : (M,) float64
        Log-odds of each assignment with its pose against clutter alone.
    log_mass : (M,) float64
        Log-odds summed over all changes that leave the pose unchanged.
    local : (M, n) float64
        Probability, given the mode, that a point's match is right or, if it is unmatched, that it has none.
    freedom : (M,) float64
        Of the fit, see `Evidence`.
    visible : (M, n) float64
    detected : (M,) float64
        Part of `log_odds`, see `Evidence`.
    unmatched : (M, n) float64
        Probability that a point has no detection, given the mode.
    summed : (M,) bool
        Whether changes of the assignment were summed; otherwise its matches count as certain, given the mode.
    near : (M,) object
        Changes of each assignment that were weighed, as (C, n) int64, (C,) and (C, 6) float64 arrays: the changed
        assignments, their log-odds, and the steps from the mode's pose to theirs.
    """

    assignments: Integers
    rotation: Floats
    position: Floats
    covariance: Floats
    log_odds: Floats
    log_mass: Floats
    local: Floats
    freedom: Floats
    visible: Floats
    detected: Floats
    unmatched: Floats
    summed: Bools
    near: NDArray[np.object_]

    def uses(self, count: int) -> Bools:
        """Which of so many detections (M, n') each mode takes."""
        return used_mask(self.assignments, count)

    def take(self, which: Integers | slice) -> Modes:
        """A subset of the modes."""
        return Modes._make([one[which] for one in self])

    def first(self, maximum: int) -> Modes:
        """The most probable modes; these themselves if there are no more."""
        return self if len(self.log_odds) <= maximum else self.take(slice(maximum))

    def places(self, count: int, maximum: int) -> Modes:
        """So many modes, the first ones, and the best one in each other place; ``count`` of detections."""
        if len(self.log_odds) <= maximum:
            return self
        return self.take(best_of_places(self.uses(count), self.log_mass, maximum))

    def and_(self, others: Modes) -> Modes:
        """These modes, followed by others."""
        return Modes._make(np.concatenate(pair) for pair in zip(self, others, strict=True))


def used_mask(assignments: Integers, count: int) -> Bools:
    """Which of so many detections or targets each assignment (K, n) takes, (K, count)."""
    out = np.zeros((len(assignments), count + 1), np.bool_)
    out[np.arange(len(out))[:, None], assignments] = True  # −1 is the last place
    return out[:, :count]


def is_same_place(uses: Bools, others: Bools | None = None) -> Bools:
    """Which modes (M, L) are of the same thing, by their detections (M, n'): most of those of the smaller one.

    ``others``: those (L, n') of other modes; the same by default.
    """
    others = uses if others is None else others
    shared = uses.astype(float) @ others.T
    return np.asarray(shared > 0.5 * np.minimum(uses.sum(axis=1)[:, None], others.sum(axis=1)))


def best_of_places(uses: Bools, log_odds: Floats, maximum: int) -> Integers:
    """Numbers of the ``maximum`` best of some modes (M,), and of the best in each other place that is beyond clutter.

    A body that is nearly symmetric has more modes in one place than any limit, and a copy of it may be in another.
    """
    order = np.argsort(-log_odds, kind="stable")
    best, left = order[:maximum], order[maximum:]
    left = left[log_odds[left] > 0.0]
    left = left[~is_same_place(uses[left], uses[best]).any(axis=1)]
    others = list[int]()
    while left.size:
        others.append(int(left[0]))
        left = left[1:][~is_same_place(uses[left[1:]], uses[left[:1]])[:, 0]]
    return np.append(best, np.array(others, np.int64))


@lru_cache(maxsize=64)
def empty_modes(n: int) -> Modes:
    """Empty modes of a body with ``n`` points."""
    none = np.empty(0)
    return Modes(
        assignments=np.empty((0, n), np.int64),
        rotation=np.empty((0, 3, 3)),
        position=np.empty((0, 3)),
        covariance=np.empty((0, 6, 6)),
        log_odds=none,
        log_mass=none,
        local=np.empty((0, n)),
        freedom=none,
        visible=np.empty((0, n)),
        detected=none,
        unmatched=np.empty((0, n)),
        summed=np.empty(0, np.bool_),
        near=np.empty(0, object),
    )


@lru_cache(maxsize=64)
def empty_changes(n: int) -> tuple[Integers, Floats, Floats]:
    """What `Modes.near` holds of a mode without weighed changes."""
    return np.empty((0, n), np.int64), np.empty(0), np.empty((0, 6))


def empty_changes_each(count: int, n: int) -> NDArray[np.object_]:
    """`Modes.near` for modes without weighed changes."""
    return object_array([empty_changes(n)] * count)


def object_array(some: Sequence[Any]) -> NDArray[np.object_]:
    """An object array with one element for each item."""
    out = np.empty(len(some), object)
    for k, one in enumerate(some):
        out[k] = one
    return out
