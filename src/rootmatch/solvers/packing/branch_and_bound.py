"""Weighted set packing by branch and bound, with the prices of the linear relaxation."""

from __future__ import annotations

import numpy as np

from rootmatch.jit.decorators import driver


@driver(nogil=True)
def branch_and_bound_packing(elements, loss, price, slot_price, maximum, budget, nodes):  # type: ignore[no-untyped-def]
    """The disjoint sets that lose least against a bound, if they lose less than `budget`.

    With prices y ≥ 0 of the elements and z of each of the `maximum` slots, the value of a packing is Σ y + `maximum` z
    less its losses: y of each element that no set covers, z of each free slot, and of each set its price less value.
    The element that fewest sets can still cover is covered by each in turn, the least loss first, or not at all. The
    loss of a set in equal parts on its elements bounds from below what the open elements must lose.

    Parameters
    ----------
    elements : (G, k) int64 array
        Elements of each set, −1 after the last.
    loss : (G,) array
        Price less value of each, not negative.
    price : (N,) array
        y.
    slot_price : float
        z.
    maximum : int
        Most sets.
    budget : float
        Loss of the best packing known.
    nodes : int
        Most nodes.

    Returns
    -------
    chosen : (G,) bool array
        Empty sets where nothing better was found.
    lost : float
        Its loss, or `budget`.
    used : int
        Nodes; `nodes` where the search ended there.
    """
    sets, width = elements.shape
    count = price.size
    best = np.zeros(sets, np.bool_)
    lost = budget
    state = np.zeros(count, np.int8)  # 0 open, 1 covered, 2 given up
    lists = np.empty((count + 2, sets), np.int32)
    lengths = np.zeros(count + 2, np.int64)
    options = np.empty((count + 2, sets), np.int32)
    option_count = np.zeros(count + 2, np.int64)
    at = np.zeros(count + 2, np.int64)
    branch = np.zeros(count + 2, np.int64)
    so_far = np.zeros(count + 2)
    taken = np.full(count + 2, -1, np.int64)
    covers = np.empty(count, np.int64)
    share = np.empty(count)
    size = np.zeros(sets, np.int64)
    for g in range(sets):
        while size[g] < width and elements[g, size[g]] >= 0:
            size[g] += 1
    for g in range(sets):
        if loss[g] < lost:
            lists[0, lengths[0]] = g
            lengths[0] += 1
    depth, held, used, fresh = 0, 0, 0, True
    while depth >= 0:
        if fresh:
            # a new node: a lower bound of its loss, and where to branch
            used += 1
            fresh = False
            option_count[depth] = -1
            if used > nodes:
                break
            # not by slices, which would be compiled with all the text of an error
            for e in range(count):
                covers[e], share[e] = 0, price[e]
            length = lengths[depth] if held < maximum else 0
            for q in range(length):
                g = lists[depth, q]
                part = loss[g] / size[g]
                for p in range(size[g]):
                    e = elements[g, p]
                    covers[e] += 1
                    share[e] = min(share[e], part)
            bound, wanted = so_far[depth], -1
            for e in range(count):
                if state[e] == 0:
                    bound += share[e]
                    if covers[e] > 0 and (wanted < 0 or covers[e] < covers[wanted]):
                        wanted = e
            if wanted < 0:
                bound += slot_price * (maximum - held)
                if bound < lost:
                    lost = bound
                    for g in range(sets):
                        best[g] = False
                    for q in range(depth):
                        if taken[q] >= 0:
                            best[taken[q]] = True
            elif bound < lost:
                branch[depth], at[depth], option_count[depth] = wanted, 0, 0
                for q in range(length):
                    g = lists[depth, q]
                    for p in range(size[g]):
                        if elements[g, p] == wanted:
                            place = option_count[depth]
                            while place > 0 and loss[options[depth, place - 1]] > loss[g]:
                                options[depth, place] = options[depth, place - 1]
                                place -= 1
                            options[depth, place] = g
                            option_count[depth] += 1
        # undo the last option tried here
        if taken[depth] >= 0:
            for p in range(size[taken[depth]]):
                state[elements[taken[depth], p]] = 0
            held -= 1
        elif at[depth] > 0:
            state[branch[depth]] = 0
        taken[depth] = -1
        if at[depth] > option_count[depth]:
            at[depth] = 0
            depth -= 1
            continue
        if at[depth] < option_count[depth]:
            g = options[depth, at[depth]]
            total = so_far[depth] + loss[g]
            taken[depth] = g
            held += 1
            for p in range(size[g]):
                state[elements[g, p]] = 1
        else:
            total = so_far[depth] + price[branch[depth]]
            state[branch[depth]] = 2
        at[depth] += 1
        if total >= lost:
            continue
        so_far[depth + 1] = total
        lengths[depth + 1] = 0
        for q in range(lengths[depth]):
            g = lists[depth, q]
            if total + loss[g] >= lost:
                continue
            free = True
            for p in range(size[g]):
                free = free and state[elements[g, p]] == 0
            if free:
                lists[depth + 1, lengths[depth + 1]] = g
                lengths[depth + 1] += 1
        depth += 1
        at[depth] = 0
        taken[depth] = -1
        fresh = True
    return best, lost, min(used, nodes)
