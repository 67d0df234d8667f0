"""The state of a discrete assignment X: gains and pair weights, kept up to date by a `SubsetIndex`.

The objective is f(X) = Σ_{e⊂X} h_e + Σ_{a∈X} u_a − penalty · C(|X|, d). Kept for the current X:

* gains, G_a = Σ of h over the hyper-edges made of a and d−1 members of X: what a adds, or a member would take away;
* pairs, P_ab = Σ of h over the hyper-edges inside X that contain both members a and b.

When a correspondence enters or leaves X, only the C(|X|, d−2) subsets of d−1 that contain it are looked up.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.jit.internal import internal_function
from rootmatch.solvers.ascent.pair_table import place_of_pair
from rootmatch.solvers.ascent.subset_index import SubsetIndex


class State(NamedTuple):
    """An assignment with its gains and pair weights; changed in place."""

    image: Integers  # (n,) target or −1
    owner: Integers  # (n',) source or −1
    inside: Bools  # (n n',) which correspondences are members
    members: Integers  # (n,) their flat indices, the first size[0] of them
    size: Integers  # (1,)
    gains: Floats  # (n n',)
    pairs: Floats  # (n, n) by source point
    total: Floats  # (1,) hyper-edge and unary weights inside
    reads: Integers  # (1,) subsets looked up and entries of the index read by all changes so far
    pick: Integers  # (d,) scratch
    subset: Integers  # (d,) scratch


def empty_state(index: SubsetIndex) -> State:
    """The empty assignment."""
    state = room_for_state(index)
    state.image.fill(-1)
    state.owner.fill(-1)
    for array in (state.inside, state.members, state.size, state.gains, state.pairs, state.total):
        array.fill(0)
    return state


def room_for_state(index: SubsetIndex) -> State:
    """A state that is filled in before it is read, but for its ``reads``, which begin at 0."""
    order, size = index.indices.shape[1], index.n * index.n_target
    return State(
        image=np.empty(index.n, np.int64),
        owner=np.empty(index.n_target, np.int64),
        inside=np.empty(size, np.bool_),
        members=np.empty(index.n, np.int64),
        size=np.empty(1, np.int64),
        gains=np.empty(size),
        pairs=np.empty((index.n, index.n)),
        total=np.empty(1),
        reads=np.zeros(1, np.int64),
        pick=np.empty(order, np.int64),
        subset=np.empty(order, np.int64),
    )


def objective(index: SubsetIndex, state: State, penalty: float) -> float:
    """Objective f(X) of the state's assignment."""
    return float(state.total[0]) - penalty * math.comb(int(state.size[0]), index.indices.shape[1])


@internal_function()
def completing_correspondence(indices, subset, e):  # type: ignore[no-untyped-def]
    """The correspondence that hyper-edge e has beyond the d−1 of a subset, or −1 if it does not contain these."""
    order = indices.shape[1]
    rest, common = -1, 0
    for p in range(order):
        b = indices[e, p]
        hit = False
        for q in range(order - 1):
            hit = hit or subset[q] == b
        if hit:
            common += 1
        else:
            rest = b
    return rest if common == order - 1 else -1


@internal_function()
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


@internal_function()
def change(index: SubsetIndex, state: State, a: int, entering: bool) -> None:
    """Add correspondence a, whose points are free, or remove it."""
    image, owner, members, size, inside = state.image, state.owner, state.members, state.size, state.inside
    gains, pairs, total, pick, subset = state.gains, state.pairs, state.total, state.pick, state.subset
    order, source, start = index.indices.shape[1], index.source, index.start
    row = source[a]
    k = a - row * index.n_target
    sign, read = 1.0 if entering else -1.0, np.int64(0)
    if entering:
        total[0] += gains[a] + index.unary[a]
    else:
        own = 0
        while members[own] != a:
            own += 1
        size[0] -= 1
        members[own] = members[size[0]]
        image[row], owner[k], inside[a] = -1, -1, False

    # Hyper-edges of a with d−2 members; a is not in `members` meanwhile.
    if index.paired:
        others, held, one = index.others, index.held, np.uint32(1)
        for q in range(size[0]):
            b = members[q]
            place = place_of_pair(np.uint32(a), np.uint32(b))
            t, last = start[place], start[place + one]
            read += 1 + np.int64(last - t)
            while t < last:
                c, h = others[t], sign * held[t]
                t += one
                gains[c] += h
                if inside[c]:
                    # The hyper-edge is inside: found once for each other member c, it counts for the pairs of c.
                    i = source[c]
                    pairs[row, i] += h
                    pairs[i, row] += h
                    pairs[i, source[b]] += h
    else:
        indices, weights, keys, entries = index.indices, index.weights, index.keys, index.entries
        free, count = order - 2, size[0]
        down, tag_down = np.uint64(index.bucket_shift), np.uint64(index.tag_shift)
        tag_mask = np.uint64((1 << (index.bucket_shift - index.tag_shift)) - 1)
        edge_bits, mask = np.uint32(index.edge_bits), np.uint32((1 << index.edge_bits) - 1)
        for q in range(free):
            pick[q] = q
        subset[free] = a
        more = count >= free
        while more:
            key = keys[a]
            for q in range(free):
                subset[q] = members[pick[q]]
                key += keys[subset[q]]
            bucket = np.int64(key >> down)
            tag = np.uint32((key >> tag_down) & tag_mask)
            read += 1 + np.int64(start[bucket + 1] - start[bucket])
            for t in range(np.int64(start[bucket]), np.int64(start[bucket + 1])):
                if entries[t] >> edge_bits != tag:
                    continue
                e = entries[t] & mask
                c = completing_correspondence(indices, subset, e)
                if c < 0:
                    continue
                h = sign * weights[e]
                gains[c] += h
                if inside[c]:
                    # As above.
                    i = source[c]
                    pairs[row, i] += h
                    for q in range(order - 1):
                        pairs[i, source[subset[q]]] += h
            more = next_pick(pick, free, count)
    state.reads[0] += read

    if entering:
        image[row], owner[k], inside[a] = k, row, True
        members[size[0]] = a
        size[0] += 1
    else:
        # Rounding errors must not look like evidence.
        for i in range(image.size):
            pairs[row, i] = 0.0
            pairs[i, row] = 0.0
        total[0] -= gains[a] + index.unary[a]


@internal_function()
def joint_weight(index: SubsetIndex, state: State, c: int, c2: int, i: int, j: int) -> Any:
    """Weight Q of the hyper-edges made of c, c2 and members other than those of source points i and j."""
    order, source = index.indices.shape[1], index.source
    pick, subset, members, count, inside = state.pick, state.subset, state.members, state.size[0], state.inside
    indices, weights, keys, start, entries = index.indices, index.weights, index.keys, index.start, index.entries
    paired, others, held = index.paired, index.others, index.held
    down, tag_down = np.uint64(index.bucket_shift), np.uint64(index.tag_shift)
    tag_mask = np.uint64((1 << (index.bucket_shift - index.tag_shift)) - 1)
    edge_bits, mask = np.uint32(index.edge_bits), np.uint32((1 << index.edge_bits) - 1)
    # Looked up: c, c2 and d−3 members; of two correspondences c alone, and what completes it must be c2.
    free = order - 3 if order > 3 else 0
    subset[free] = c
    if order > 2:
        subset[free + 1] = c2
    for q in range(free):
        pick[q] = q
    total = 0.0
    more = count >= free
    while more:
        key, usable = np.uint64(0), True
        if not paired:
            key = keys[c]
            if order > 2:
                key += keys[c2]
        for q in range(free):
            b = members[pick[q]]
            subset[q] = b
            key += keys[b]
            row = source[b]
            usable = usable and row != i and row != j
        if usable:
            bucket = np.int64(place_of_pair(np.uint32(c), np.uint32(c2))) if paired else np.int64(key >> down)
            tag = np.uint32((key >> tag_down) & tag_mask)
            for t in range(np.int64(start[bucket]), np.int64(start[bucket + 1])):
                if paired:
                    rest, h = np.int64(others[t]), held[t]
                else:
                    if entries[t] >> edge_bits != tag:
                        continue
                    e = entries[t] & mask
                    rest, h = np.int64(completing_correspondence(indices, subset, e)), weights[e]
                if rest == c2:
                    total += h
                elif order > 2 and rest >= 0 and inside[rest]:
                    row = source[rest]
                    total += h if row != i and row != j else 0.0
        more = next_pick(pick, free, count)
    # Each such hyper-edge was found once for each of its d − 2 members.
    return total / (order - 2) if order > 3 else total
