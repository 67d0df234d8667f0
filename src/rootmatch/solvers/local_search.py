"""Ascent of the discrete score by the best single move, from many starts at once.

Correspondences that share a point are in no hyper-edge together, hence with the gains G and pair weights P of
`discrete_state` these changes of f(X) are exact (unary weights u enter with G; the penalty by the size of X):

* add c: G_c; remove b: −G_b; replace b by c: G_c − G_b;
* replace b and b', the two that conflict with c: G_c − G_b − G_b' + P_bb';
* exchange the targets of b and b', which gives c and c': G_c + G_c' + Q_cc' − G_b − G_b' + P_bb', where Q is the weight
  of the hyper-edges that contain c and c' and else members of X; looked up when no other move is left.

The best move is made until none improves f: strictly monotone, and the same on any number of threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from rootmatch.solvers.discrete_state import (
    State,
    binomial,
    bucket_of,
    completion,
    copy_state,
    enter,
    leave,
    next_pick,
    objective,
    put,
)
from rootmatch.solvers.subset_index import SubsetIndex

LEAST_STEP = 1e-10
"""A move must gain this part of the score, far above rounding, so that no ascent can go in circles."""


@njit(cache=True)
def _best_move(index, state, penalty):  # type: ignore[no-untyped-def]
    """Largest change of f by one correspondence: (change, entering a or −1, leaving a or −1)."""
    order, n_target, size = index.indices.shape[1], index.n_target, state.size[0]
    gains, unary, image, owner = state.gains, index.unary, state.image, state.owner
    # The penalty for one more, and what one less gives back.
    dearer, cheaper = penalty * binomial(size, order - 1), penalty * binomial(size - 1, order - 1)
    best, entering, leaving = 0.0, -1, -1
    for i in range(index.n):
        mine = i * n_target + image[i]
        loss = gains[mine] + unary[mine] if image[i] >= 0 else 0.0
        if image[i] >= 0 and cheaper - loss > best:
            best, entering, leaving = cheaper - loss, -1, mine
        for k in range(n_target):
            c = i * n_target + k
            gain = gains[c] + unary[c]
            # Nothing else can be better than the gain and one release of the penalty.
            if gain + cheaper <= best or k == image[i]:
                continue
            j = owner[k]
            change = gain
            if j >= 0:
                theirs = j * n_target + k
                change -= gains[theirs] + unary[theirs]
            if image[i] >= 0:
                change -= loss
            if image[i] < 0 and j < 0:
                change -= dearer
            elif image[i] >= 0 and j >= 0:
                change += state.pairs[i, j] + cheaper
            if change > best:
                best, entering, leaving = change, c, -1
    return best, entering, leaving


@njit(cache=True)
def _joint_weight(index, state, c, c2, i, j):  # type: ignore[no-untyped-def]
    """Q: weight of the hyper-edges made of c, c2 and members other than those of source points i and j."""
    order, n_target = index.indices.shape[1], index.n_target
    pick, subset, members, count = state.pick, state.subset, state.members, state.size[0]
    edge_bits = np.uint32(index.edge_bits)
    mask = np.uint32((1 << index.edge_bits) - 1)
    total = 0.0
    if order == 2:
        subset[0] = c
        first, last, tag = bucket_of(index, index.keys[c])
        for t in range(first, last):
            entry = index.entries[t]
            if entry >> edge_bits == tag and completion(index, subset, entry) == c2:
                total += index.weights[entry & mask]
        return total
    free = order - 3
    for q in range(free):
        pick[q] = q
    subset[free], subset[free + 1] = c, c2
    if count < free:
        return total
    more = True
    while more:
        key = index.keys[c] + index.keys[c2]
        usable = True
        for q in range(free):
            b = members[pick[q]]
            subset[q] = b
            key += index.keys[b]
            row = b // n_target
            usable = usable and row != i and row != j
        if usable:
            first, last, tag = bucket_of(index, key)
            for t in range(first, last):
                entry = index.entries[t]
                if entry >> edge_bits == tag:
                    rest = completion(index, subset, entry)
                    row = rest // n_target
                    if rest >= 0 and row != i and row != j and state.image[row] == rest - row * n_target:
                        total += index.weights[entry & mask]
        more = next_pick(pick, free, count)
    # Each such hyper-edge was seen once for each of its d − 2 members.
    return total / (order - 2)


@njit(cache=True)
def _exchange_terms(index, state, i, j):  # type: ignore[no-untyped-def]
    """Change of f when i and j exchange targets, without the term Q, and an upper bound of Q."""
    n_target = index.n_target
    b, b2 = i * n_target + state.image[i], j * n_target + state.image[j]
    c, c2 = i * n_target + state.image[j], j * n_target + state.image[i]
    gains, unary = state.gains, index.unary
    change = gains[c] + unary[c] + gains[c2] + unary[c2] + state.pairs[i, j]
    change -= gains[b] + unary[b] + gains[b2] + unary[b2]
    return change, min(index.marginals[c], index.marginals[c2])


@njit(cache=True)
def _exchange_change(index, state, i, j):  # type: ignore[no-untyped-def]
    """Change of f when i and j exchange targets."""
    n_target = index.n_target
    c, c2 = i * n_target + state.image[j], j * n_target + state.image[i]
    return _exchange_terms(index, state, i, j)[0] + _joint_weight(index, state, c, c2, i, j)


@njit(cache=True)
def _find_exchange(index, state, least, begin):  # type: ignore[no-untyped-def]
    """The first pair of points, from number `begin` on and round to it, whose exchange adds more than `least`.

    Returns (i, j, number of the pair); i = −1 when there is none. The first is taken, not the best, because each needs
    look-ups; to begin where the last was found spreads them.
    """
    n = index.n
    i, j = begin // n, begin % n
    for _ in range(n * n):
        j += 1
        if j >= n:
            i = i + 1 if i + 1 < n else 0
            j = i + 1
            if j >= n:
                i, j = 0, 1
        if state.image[i] >= 0 and state.image[j] >= 0:
            change, most = _exchange_terms(index, state, i, j)
            if change + most > least and _exchange_change(index, state, i, j) > least:
                return i, j, i * n + j
        if i * n + j == begin:
            break
    return -1, -1, begin


@njit(cache=True)
def _exchange(index, state, i, j):  # type: ignore[no-untyped-def]
    """Exchange the targets of i and j."""
    k, k2, n_target = state.image[i], state.image[j], index.n_target
    leave(index, state, i * n_target + k)
    leave(index, state, j * n_target + k2)
    enter(index, state, i * n_target + k2)
    enter(index, state, j * n_target + k)


@njit(cache=True)
def climb(index: SubsetIndex, state: State, penalty: float, limit: int, exchanges: bool) -> int:
    """Make the best move until none improves f; the number of moves, `limit` when it was cut short.

    Exchanges, which cost the most to judge, are tried only when wanted, and where no other move is left.
    """
    moves, last = 0, 1
    while moves < limit:
        least = LEAST_STEP * state.total[0]
        change, entering, leaving = _best_move(index, state, penalty)
        if change > least:
            if entering >= 0:
                put(index, state, entering)
            else:
                leave(index, state, leaving)
        elif not exchanges or index.n == 1:
            return moves
        else:
            i, j, last = _find_exchange(index, state, least, last)
            if i < 0:
                return moves
            _exchange(index, state, i, j)
        moves += 1
    return moves


@njit(cache=True)
def _drop_idle(index, state):  # type: ignore[no-untyped-def]
    """Unmatch the points that gain nothing, by the same measure by which they would not be added."""
    for i in range(index.n):
        if state.image[i] >= 0:
            a = i * index.n_target + state.image[i]
            if state.gains[a] + index.unary[a] <= LEAST_STEP * state.total[0]:
                leave(index, state, a)


@njit(cache=True, parallel=True)
def climb_from(
    index: SubsetIndex,
    root: State,
    bases: NDArray[Any],
    penalty: float,
    limit: int,
    exchanges: bool,
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Ascents from assignments, the rows of `bases` (B, n).

    Every base is reached from the state `root`, so it should be near. Returns the assignments (B, n), their objectives
    (B,) and numbers of moves (B,).
    """
    count = bases.shape[0]
    images = np.empty((count, index.n), np.int64)
    values = np.empty(count)
    moves = np.empty(count, np.int64)
    for s in prange(count):
        state = copy_state(root)
        for i in range(index.n):
            if state.image[i] >= 0 and state.image[i] != bases[s, i]:
                leave(index, state, i * index.n_target + state.image[i])
        for i in range(index.n):
            if state.image[i] != bases[s, i]:
                enter(index, state, i * index.n_target + bases[s, i])
        moves[s] = climb(index, state, penalty, limit, exchanges)
        _drop_idle(index, state)
        images[s] = state.image
        values[s] = objective(index, state, penalty)
    return images, values, moves


@njit(cache=True)
def _changes(index: SubsetIndex, state: State) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """All changes of an assignment by a point to a free target, a target to a free point, or an exchange.

    Returns rows (source, its new target, other source, its new target), −1 where nothing changes or a point becomes
    free; the change of f; and for exchanges what the term Q, not yet in it, may add.
    """
    n, n_target, image = index.n, index.n_target, state.image
    most = n * n_target + n * n
    rows, change, slack = np.full((most, 4), -1, np.int64), np.empty(most), np.zeros(most)
    count = 0
    for i in range(n):
        if image[i] < 0:
            continue
        b = i * n_target + image[i]
        loss = state.gains[b] + index.unary[b]
        for k in range(n_target):
            if state.owner[k] < 0:
                c = i * n_target + k
                rows[count, 0], rows[count, 1] = i, k
                change[count] = state.gains[c] + index.unary[c] - loss
                count += 1
        for j in range(n):
            if image[j] < 0:
                c = j * n_target + image[i]
                rows[count, 0], rows[count, 2], rows[count, 3] = i, j, image[i]
                change[count] = state.gains[c] + index.unary[c] - loss
                count += 1
            elif j > i:
                rows[count, 0], rows[count, 1], rows[count, 2], rows[count, 3] = i, image[j], j, image[i]
                change[count], slack[count] = _exchange_terms(index, state, i, j)
                count += 1
    return rows[:count], change[:count], slack[:count]


@njit(cache=True)
def _complete_exchanges(index: SubsetIndex, state: State, rows: NDArray[Any], change: NDArray[Any]) -> None:
    """Put the exact change of f for exchanges."""
    for r in range(rows.shape[0]):
        change[r] = _exchange_change(index, state, rows[r, 0], rows[r, 2])


def modifications(
    index: SubsetIndex, state: State, penalty: float, keep: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Best `keep` changes of an assignment: a point to a free target, a target to a free point, or an exchange.

    Returns the assignments (keep or fewer, n) and their objectives, best first.
    """
    rows, change, slack = _changes(index, state)
    # The term Q of an exchange is looked up where it could decide who is among the best.
    enough = np.partition(change, -keep)[-keep] if 0 < keep < change.size else -np.inf
    open_ = np.flatnonzero((slack > 0) & (change + slack >= enough))
    exact = change[open_]
    _complete_exchanges(index, state, rows[open_], exact)
    change[open_] = exact
    chosen = np.argsort(-change, kind="stable")[:keep]
    images = np.repeat(state.image[None], chosen.size, axis=0)
    every = np.arange(chosen.size)
    source, target, other, theirs = rows[chosen].T
    images[every, source] = target
    images[every[other >= 0], other[other >= 0]] = theirs[other >= 0]
    return images, objective(index, state, penalty) + change[chosen]
