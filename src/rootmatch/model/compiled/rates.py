"""Which points are detected and which are not, with an unknown detection rate integrated out, compiled."""

from __future__ import annotations

import math

from rootmatch.jit.decorators import part

SMALL, APART = 1e-150, 8
"""Size below which a product of chances goes on as a logarithm, and number of factors between two looks: each is above
1e-16, unless it is zero."""


@part
def fill_miss_products(missing, distances, maximum, rates, products):  # type: ignore[no-untyped-def]
    """Chances that none of the points up to some distance is detected, at each rate, into ``products`` (2, Q).

    Each is the first row times the exponential of the second. ``missing`` and ``distances``, in any scale: (n,).
    """
    products[0], products[1] = 1.0, 0.0
    since = 0
    for point in range(missing.shape[0]):
        if missing[point] > 0.0 and distances[point] <= maximum:
            for q in range(rates.shape[0]):
                products[0, q] *= 1.0 - rates[q] * missing[point]
            since += 1
            if since == APART:
                since = 0
                for q in range(rates.shape[0]):
                    if products[0, q] < SMALL:
                        products[1, q] += math.log(products[0, q])
                        products[0, q] = 1.0


@part
def log_over_rates(missing, matches, rates, log_weights, products):  # type: ignore[no-untyped-def]
    """Log-probability that some points are detected and the others are not, the rate integrated out.

    The visibility of the former apart. ``missing`` (n,): that of the latter, zero for the former; ``products`` (2, Q):
    scratch.
    """
    fill_miss_products(missing, missing, math.inf, rates, products)  # of all points
    highest, total = -math.inf, 0.0
    for q in range(rates.shape[0]):
        each = log_weights[q] + matches * math.log(rates[q]) + products[1, q] + math.log(products[0, q])
        if each > highest:
            total = total * math.exp(highest - each) + 1.0 if total > 0.0 else 1.0
            highest = each
        else:
            total += math.exp(each - highest)
    return highest + math.log(total)
