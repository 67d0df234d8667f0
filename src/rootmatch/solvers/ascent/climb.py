"""Ascent of the discrete score by the best single move, from many starts at once.

Correspondences that share a point are in no hyper-edge together, hence with the gains G and pair weights P of
`assignment_state` these changes of f(X) are exact (unary weights u enter with G; the penalty by the size of X):

* add c: G_c; remove b: −G_b; replace b by c: G_c − G_b;
* replace b and b', the two that conflict with c: G_c − G_b − G_b' + P_bb';
* exchange the targets of b and b', which gives c and c': G_c + G_c' + Q_cc' − G_b − G_b' + P_bb', where Q is the weight
  of the hyper-edges that contain c and c' and else members of X; looked up when no other move is left.

The best move is made until none improves f: strictly monotone, and the same on any number of threads.

Every step of an ascent, from reaching its base to leaving out idle points, goes through the one call of `change` in
`_ascend`: Numba copies a called function into every caller, and optimises every copy.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import NEVER
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import driver
from rootmatch.jit.internal import internal_function
from rootmatch.jit.threads import run_in_pieces, run_in_threads
from rootmatch.solvers.ascent.assignment_state import State, change, empty_state, joint_weight, room_for_state
from rootmatch.solvers.ascent.subset_index import SubsetIndex

MIN_STEP = 1e-10
"""A move must gain this part of the score, far above rounding, so that no ascent can go in circles."""

REMOVING, ADDING, CLIMBING, TIDYING = 0, 1, 2, 3
"""Stages of an ascent: members outside of its base leave, the base enters, moves, and idle points leave."""

PARTS = 4
"""Ranges of ascents for each thread: some ascents are longer than others."""


class Ascended(NamedTuple):
    """What some ascents came to, row by row."""

    images: Integers  # (B, n) assignments
    values: Floats  # (B,) their objectives
    moves: Integers  # (B,) as many as the limit where an ascent was cut short
    reads: Integers  # (B,) subsets looked up and entries of the index read, to reach the base too


@internal_function()
def _best_move(unary, state, entry_cost, exit_refund):  # type: ignore[no-untyped-def]
    """Largest change of f by one correspondence: (change, entering a or −1, leaving a or −1).

    One more correspondence costs the penalty `entry_cost`, one less gives back `exit_refund`.
    """
    gains, image, owner, pairs = state.gains, state.image, state.owner, state.pairs
    n_target = owner.size
    best, entering, leaving = 0.0, -1, -1
    for i in range(image.size):
        own = image[i]
        loss = 0.0
        if own >= 0:
            mine = i * n_target + own
            loss = gains[mine] + unary[mine]
            if exit_refund - loss > best:
                best, entering, leaving = exit_refund - loss, -1, mine
        for k in range(n_target):
            c = i * n_target + k
            gain = gains[c] + unary[c]
            # Nothing else can be better than the gain and one release of the penalty.
            if gain + exit_refund <= best or k == own:
                continue
            j = owner[k]
            change = gain
            if j >= 0:
                theirs = j * n_target + k
                change -= gains[theirs] + unary[theirs]
            if own >= 0:
                change -= loss
                if j >= 0:
                    change += pairs[i, j] + exit_refund
            elif j < 0:
                change -= entry_cost
            if change > best:
                best, entering, leaving = change, c, -1
    return best, entering, leaving


@internal_function()
def _find_exchange(index, state, minimum, begin):  # type: ignore[no-untyped-def]
    """The first pair of points, from number `begin` on and round to it, whose exchange adds more than `minimum`.

    Returns (i, j, number of the pair); i = −1 when there is none. The first is taken, not the best, because each needs
    look-ups; to begin where the last was found spreads them.
    """
    n, n_target, image, gains, unary = index.n, index.n_target, state.image, state.gains, index.unary
    marginals = index.marginals
    i, j = begin // n, begin % n
    for _ in range(n * n):
        j += 1
        if j >= n:
            i = i + 1 if i + 1 < n else 0
            j = i + 1
            if j >= n:
                i, j = 0, 1
        if image[i] >= 0 and image[j] >= 0:
            b, b2 = i * n_target + image[i], j * n_target + image[j]
            c, c2 = i * n_target + image[j], j * n_target + image[i]
            gain = gains[c] + unary[c] + gains[c2] + unary[c2] + state.pairs[i, j]
            gain -= gains[b] + unary[b] + gains[b2] + unary[b2]
            # An upper bound first: the weight of all hyper-edges of either.
            if gain + marginals[c] > minimum and gain + marginals[c2] > minimum:
                gain += joint_weight(index, state, c, c2, i, j)
                if gain > minimum:
                    return i, j, i * n + j
        if i * n + j == begin:
            break
    return -1, -1, begin


@driver(nogil=True)
def _ascend(  # type: ignore[no-untyped-def]
    index, root, state, bases, first, last, dues, limit, exchanges, tidy, images, totals, sizes, moves, reads, begins
):
    """Ascents from the bases first … last − 1, one after the other in `state`, each reached from the state `root`.

    `dues` (n + 1,) is the penalty that one more correspondence costs an assignment of each size; `begins` (B,) the
    number of the pair of points at which the search for exchanges begins, and where it has come to.
    """
    index, root, state = borrow((index, root, state))
    bases, dues, images, totals, sizes, moves = borrow((bases, dues, images, totals, sizes, moves))
    reads, begins = borrow((reads, begins))
    n, n_target, unary = index.n, index.n_target, index.unary
    image, owner, gains, total, size = state.image, state.owner, state.gains, state.total, state.size
    for s in range(first, last):
        for i in range(n):
            image[i], state.members[i] = root.image[i], root.members[i]
            for j in range(n):
                state.pairs[i, j] = root.pairs[i, j]
        for k in range(n_target):
            owner[k] = root.owner[k]
        for a in range(gains.size):
            gains[a], state.inside[a] = root.gains[a], root.inside[a]
        size[0], total[0], before = root.size[0], root.total[0], state.reads[0]

        stage, i, made = REMOVING, 0, 0
        begin = begins[s]
        while True:
            # At most two that leave and two that enter, −1 for none.
            out, out2, enter, enter2 = -1, -1, -1, -1
            if stage == CLIMBING:
                minimum = MIN_STEP * total[0] if total[0] > 0.0 else 0.0
                gain, enter, out = 0.0, -1, -1
                if made < limit:
                    gain, enter, out = _best_move(unary, state, dues[size[0]], dues[size[0] - 1 if size[0] else 0])
                if gain > minimum:
                    if enter >= 0:
                        p = enter // n_target
                        k = enter - p * n_target
                        out = p * n_target + image[p] if image[p] >= 0 else -1
                        out2 = owner[k] * n_target + k if owner[k] >= 0 else -1
                else:
                    p = -1
                    if exchanges and n > 1 and made < limit:
                        p, q, begin = _find_exchange(index, state, minimum, begin)
                    if p < 0:
                        stage, i = TIDYING, 0
                        continue
                    out, out2 = p * n_target + image[p], q * n_target + image[q]
                    enter, enter2 = p * n_target + image[q], q * n_target + image[p]
                made += 1
            elif i == n:
                if stage == TIDYING:
                    break
                stage, i = stage + 1, 0
                continue
            else:
                a = i * n_target + image[i]
                base = bases[s, i]
                if stage == ADDING:
                    enter = i * n_target + base if image[i] != base else -1
                elif image[i] >= 0:
                    if stage == REMOVING:
                        out = a if image[i] != base else -1
                    elif tidy and gains[a] + unary[a] <= MIN_STEP * total[0]:
                        # Gains nothing, by the same measure by which it would not be added.
                        out = a
                i += 1
            for step in range(4):
                a = enter2
                if step == 0:
                    a = out
                elif step == 1:
                    a = out2
                elif step == 2:
                    a = enter
                if a >= 0:
                    change(index, state, a, step > 1)
        for i in range(n):
            images[s, i] = image[i]
        totals[s], sizes[s], moves[s], begins[s] = total[0], size[0], made, begin
        reads[s] = state.reads[0] - before


def climb_from(
    index: SubsetIndex,
    root: State,
    bases: Integers,
    *,
    penalty: float,
    limit: int,
    exchanges: bool = False,
    threads: int = 1,
) -> Ascended:
    """Ascents from assignments, the rows of `bases` (B, n), without the points that gain nothing.

    Every base is reached from the state `root`, so it should be near. Exchanges, which cost the most to judge, are
    tried only when wanted, and where no other move is left.
    """
    begins = np.ones(len(bases), np.int64)
    return _climb(
        index, root, None, bases, begins,
        penalty=penalty, limit=limit, exchanges=exchanges, tidy=True, threads=threads,
    )  # fmt: skip


def climb(index: SubsetIndex, state: State, begins: Integers, *, penalty: float, limit: int, exchanges: bool) -> int:
    """Make the best move in a state until none improves f; the number of moves, `limit` when it was cut short.

    ``begins`` (1,), of ones at first, says where the next call goes on: pieces of an ascent make up the whole one.
    """
    base = state.image[None].copy()
    found = _climb(index, state, state, base, begins, penalty=penalty, limit=limit, exchanges=exchanges)
    return int(found.moves[0])


def state_of(index: SubsetIndex, image: Integers, root: State | None = None, *, at_once: bool = False) -> State:
    """The state of an assignment (n,), reached by pieces: an interrupt is seen between two of them, unless ``at_once``.

    It is reached from the empty one, or from the state ``root``, which stays as it is.
    """
    state, begins = empty_state(index), np.ones(1, np.int64)
    if at_once:
        with NEVER.enforce():
            _climb(index, state if root is None else root, state, image[None].copy(), begins, penalty=0.0, limit=0)
        return state
    base = (state if root is None else root).image[None].copy()
    changed = np.flatnonzero(image != base[0])
    base[0, changed] = -1
    entering = changed[image[changed] >= 0]

    def enter(first: int, last: int) -> None:
        base[0, entering[first:last]] = image[entering[first:last]]
        _climb(index, state, state, base, begins, penalty=0.0, limit=0)

    with NEVER.enforce():  # what it is asked for is to be handed on, deadline or not
        _climb(index, state if root is None else root, state, base, begins, penalty=0.0, limit=0)
        run_in_pieces(enter, len(entering))
    return state


def _climb(
    index: SubsetIndex,
    root: State,
    state: State | None,
    bases: Integers,
    begins: Integers,
    *,
    penalty: float,
    limit: int,
    exchanges: bool = False,
    tidy: bool = False,
    threads: int = 1,
) -> Ascended:
    """Ascents on some threads, in the given state or in new ones."""
    count, n, order = len(bases), index.n, index.indices.shape[1]
    images, totals = np.empty((count, n), np.int64), np.empty(count)
    sizes, moves, reads = np.empty((3, count), np.int64)
    dues = _penalties(penalty, n, order - 1)

    def ascend(first: int, last: int) -> None:
        own = room_for_state(index) if state is None else state
        _ascend(
            index, root, own, bases, first, last, dues, limit, exchanges, tidy,
            images, totals, sizes, moves, reads, begins,
        )  # fmt: skip

    run_in_threads(ascend, count, threads, PARTS)
    return Ascended(images, totals - _penalties(penalty, n, order)[sizes], moves, reads)


def _penalties(penalty: float, n: int, order: int) -> Floats:
    """``penalty`` for each subset of so many correspondences of assignments of each size, (n + 1,)."""
    if penalty == 0.0:
        return np.zeros(n + 1)
    return np.array([penalty * math.comb(size, order) for size in range(n + 1)])
