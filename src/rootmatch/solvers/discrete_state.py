"""The state of a discrete assignment X: gains and pair weights, kept up to date by a `SubsetIndex`.

The objective is f(X) = Σ_{e⊂X} h_e + Σ_{a∈X} u_a − penalty · C(|X|, d). Kept for the current X:

* gains, G_a = Σ of h over the hyper-edges made of a and d−1 members of X: what a adds, or a member would take away;
* pairs, P_ab = Σ of h over the hyper-edges inside X that contain both members a and b.

When a correspondence enters or leaves X, only the C(|X|, d−2) subsets of d−1 that contain it are looked up.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rootmatch.solvers.subset_index import SubsetIndex


class State(NamedTuple):
    """An assignment and what it implies; changed in place."""

    image: NDArray[np.int64]  # (n,) target or −1
    owner: NDArray[np.int64]  # (n',) source or −1
    members: NDArray[np.int64]  # (n,) flat indices, the first size[0] of them
    size: NDArray[np.int64]  # (1,)
    gains: NDArray[np.float64]  # (n n',)
    pairs: NDArray[np.float64]  # (n, n) by source point
    total: NDArray[np.float64]  # (1,) hyper-edge and unary weights inside
    pick: NDArray[np.int64]  # (d,) scratch
    subset: NDArray[np.int64]  # (d,) scratch


@njit(cache=True)
def new_state(index: SubsetIndex) -> State:
    """The empty assignment."""
    order = index.indices.shape[1]
    return State(
        np.full(index.n, -1, np.int64),
        np.full(index.n_target, -1, np.int64),
        np.empty(index.n, np.int64),
        np.zeros(1, np.int64),
        np.zeros(index.n * index.n_target),
        np.zeros((index.n, index.n)),
        np.zeros(1),
        np.empty(order, np.int64),
        np.empty(order, np.int64),
    )


@njit(cache=True)
def copy_state(state: State) -> State:
    """A copy that can change by itself."""
    return State(
        state.image.copy(),
        state.owner.copy(),
        state.members.copy(),
        state.size.copy(),
        state.gains.copy(),
        state.pairs.copy(),
        state.total.copy(),
        state.pick.copy(),
        state.subset.copy(),
    )


@njit(cache=True)
def bucket_of(index, key):  # type: ignore[no-untyped-def]
    """First and last entry of the bucket of a subset's hash, and the tag of its entries."""
    bucket = np.int64(key >> np.uint64(index.bucket_shift))
    mask = np.uint64((1 << (index.bucket_shift - index.tag_shift)) - 1)
    tag = np.uint32((key >> np.uint64(index.tag_shift)) & mask)
    return np.int64(index.start[bucket]), np.int64(index.start[bucket + 1]), tag


@njit(cache=True)
def completion(index, subset, entry):  # type: ignore[no-untyped-def]
    """The correspondence that a hyper-edge has beyond the d−1 of a subset, or −1 if it does not contain these."""
    order = index.indices.shape[1]
    e = entry & np.uint32((1 << index.edge_bits) - 1)
    rest, common = -1, 0
    for p in range(order):
        b = index.indices[e, p]
        hit = False
        for q in range(order - 1):
            hit = hit or subset[q] == b
        if hit:
            common += 1
        else:
            rest = b
    return rest if common == order - 1 else -1


@njit(cache=True)
def next_pick(pick, length, count):  # type: ignore[no-untyped-def]
    """Step to the next combination of `length` out of `count` numbers; False after the last."""
    q = length - 1
    while q >= 0 and pick[q] == count - length + q:
        q -= 1
    if q < 0:
        return False
    pick[q] += 1
    for r in range(q + 1, length):
        pick[r] = pick[r - 1] + 1
    return True


@njit(cache=True)
def _touch(index, state, a, sign):  # type: ignore[no-untyped-def]
    """Add (sign 1) or take away (−1) what the subsets of a with d−2 members give; a is not in `members` meanwhile."""
    order = index.indices.shape[1]
    members, count, pick, subset = state.members, state.size[0], state.pick, state.subset
    gains, pairs, image, n_target = state.gains, state.pairs, state.image, index.n_target
    free = order - 2
    if count < free:
        return
    edge_bits = np.uint32(index.edge_bits)
    for q in range(free):
        pick[q] = q
    subset[free] = a
    row = a // n_target
    more = True
    while more:
        key = index.keys[a]
        for q in range(free):
            subset[q] = members[pick[q]]
            key += index.keys[subset[q]]
        first, last, tag = bucket_of(index, key)
        for t in range(first, last):
            entry = index.entries[t]
            if entry >> edge_bits != tag:
                continue
            c = completion(index, subset, entry)
            if c < 0:
                continue
            h = sign * index.weights[entry & np.uint32((1 << index.edge_bits) - 1)]
            gains[c] += h
            i = c // n_target
            if image[i] == c - i * n_target:
                # The hyper-edge is inside: seen once for each of its other members c, it serves the pairs of c.
                pairs[row, i] += h
                for q in range(order - 1):
                    pairs[i, subset[q] // n_target] += h
        more = next_pick(pick, free, count)


@njit(cache=True)
def enter(index: SubsetIndex, state: State, a: int) -> None:
    """Add correspondence a, whose points are free."""
    i = a // index.n_target
    k = a - i * index.n_target
    state.total[0] += state.gains[a] + index.unary[a]
    _touch(index, state, a, 1.0)
    state.image[i], state.owner[k] = k, i
    state.members[state.size[0]] = a
    state.size[0] += 1


@njit(cache=True)
def leave(index: SubsetIndex, state: State, a: int) -> None:
    """Remove correspondence a."""
    i = a // index.n_target
    k = a - i * index.n_target
    place = 0
    while state.members[place] != a:
        place += 1
    state.size[0] -= 1
    state.members[place] = state.members[state.size[0]]
    state.image[i], state.owner[k] = -1, -1
    _touch(index, state, a, -1.0)
    # What rounding leaves over must not look like evidence.
    state.pairs[i, :] = 0.0
    state.pairs[:, i] = 0.0
    state.total[0] -= state.gains[a] + index.unary[a]


@njit(cache=True)
def put(index: SubsetIndex, state: State, a: int) -> None:
    """Add correspondence a; those that share a point with it go."""
    i = a // index.n_target
    k = a - i * index.n_target
    if state.image[i] == k:
        return
    if state.image[i] >= 0:
        leave(index, state, i * index.n_target + state.image[i])
    if state.owner[k] >= 0:
        leave(index, state, state.owner[k] * index.n_target + k)
    enter(index, state, a)


@njit(cache=True)
def state_of(index: SubsetIndex, image: NDArray[Any]) -> State:
    """The state of an assignment (n,)."""
    state = new_state(index)
    for i in range(index.n):
        if image[i] >= 0:
            enter(index, state, i * index.n_target + image[i])
    return state


@njit(cache=True)
def binomial(m, r):  # type: ignore[no-untyped-def]
    """Number of ways to choose r of m, as a float; 0 when m < r."""
    value = 1.0
    for q in range(r):
        value *= (m - q) / (q + 1.0)
    return value if m >= r else 0.0


@njit(cache=True)
def objective(index: SubsetIndex, state: State, penalty: float) -> float:
    """f(X)."""
    return float(state.total[0] - penalty * binomial(state.size[0], index.indices.shape[1]))
