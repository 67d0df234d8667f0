"""A reweighted random walk from beginning to end in one compiled call, for tensors that are walked in no time.

Step by step, as `ReweightedWalk` takes it on large ones, most of the time of such a walk would pass between its steps.
"""

from __future__ import annotations

import numpy as np

from rootmatch.hypergraph.contraction import scatter
from rootmatch.jit.decorators import driver
from rootmatch.jit.internal import internal_function


@internal_function(error_model="numpy")
def sinkhorn(y, row, column, with_slack, steps, tolerance):  # type: ignore[no-untyped-def]
    """Factors of rows and of columns that balance a matrix with n ≤ n', and whether they do so within the tolerance.

    Columns' begin at 1, or where earlier steps have come to; the slack row is kept as one factor a column.
    """
    n, n_target = y.shape
    spare = float(n_target - n) if with_slack else 0.0
    column_sum = 1.0 if with_slack else n / n_target
    # y_ik r_i c_k, and the slack row s c_k.
    slack = 1.0
    for _ in range(steps):
        for i in range(n):
            total = 0.0
            for k in range(n_target):
                total += y[i, k] * column[k]
            row[i] = 1.0 / total
        if spare > 0:
            total = 0.0
            for k in range(n_target):
                total += column[k]
            slack = spare / total
        worst = 0.0
        for k in range(n_target):
            total = slack if spare > 0 else 0.0
            for i in range(n):
                total += y[i, k] * row[i]
            worst = max(worst, abs(total * column[k] - column_sum))
            column[k] = column_sum / total
        if worst < tolerance:
            return True
    return False


@driver(nogil=True, error_model="numpy")
def walk(  # type: ignore[no-untyped-def]
    indices, weights, unary, iterations, tolerance, share, inflation, steps, balanced_to, with_slack,
    n_target, x, tables, w, y, row, column,
):  # fmt: skip
    """Walk from x (n n',), in place, as `ReweightedWalk.run_walk`: the number of steps, and the last squared change.

    From ``tables`` (2, n n'), w (n n',) and y on all arrays are scratch, made outside, as each array made in jitted
    code costs compile time: y has the smaller set's lines as ``row``, and ``column`` is of the larger one.
    """
    size = x.size
    wide = size // n_target <= n_target
    lines, length = y.shape
    change, done = np.inf, 0
    while done < iterations and change >= tolerance:
        for a in range(size):
            tables[0, a], tables[1, a] = 0.0, 0.0
        scatter(indices, weights, x, 0, weights.size, tables)
        largest, total = 0.0, 0.0
        for a in range(size):
            w[a] = tables[0, a] + tables[1, a] + unary[a]
            largest = max(largest, w[a])
            total += w[a]
        if largest <= 0.0:
            break
        highest = np.exp(inflation)  # of the largest
        for a in range(size):
            i = a // n_target
            k = a - i * n_target
            jump = np.exp(inflation * (w[a] / largest)) / highest
            if wide:
                y[i, k] = jump
            else:
                y[k, i] = jump
        for k in range(length):
            column[k] = 1.0
        sinkhorn(y, row, column, with_slack, steps, balanced_to)
        jumps = 0.0
        for i in range(lines):
            for k in range(length):
                y[i, k] *= row[i] * column[k]
                jumps += y[i, k]
        change = 0.0
        for a in range(size):
            i = a // n_target
            k = a - i * n_target
            jump = y[i, k] if wide else y[k, i]
            new = share * (w[a] / total) + (1.0 - share) * (jump / jumps)
            change += (new - x[a]) ** 2
            x[a] = new
        done += 1
    return done, change
