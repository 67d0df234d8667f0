"""False alarms: the expected number of accidental assignments with such a score, behind "no trustworthy match"."""

from __future__ import annotations

import math

from rootmatch.problems.base import Problem

TRUE_WEIGHT = {degrees: math.sqrt(0.5**degrees) for degrees in range(1, 9)}
"""Mean of exp(−χ²/2) of a true hyper-edge, by degrees of freedom of χ²."""


def supported_points(score: float, order: int, true_weight: float) -> float:
    """Number of points, all of one motion and all right, that would give this score: C(m, order) · true_weight = score.

    Between whole numbers, C(m, d) is continued as m (m − 1) … (m − d + 1) / d!. The result is at least the order.
    """
    wanted = score / true_weight

    def tuples(m: float) -> float:
        return math.prod(m - k for k in range(order)) / math.factorial(order)

    low, high = float(order), float(order + 1)
    if wanted <= 1.0:
        return low
    while tuples(high) < wanted:
        high *= 2.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if tuples(middle) < wanted else (low, middle)
    return low


def log10_false_alarms(
    problem: Problem, shape: tuple[int, int], *, score: float, true_weight: float, chance: float
) -> float:
    """Decimal logarithm of the expected number of false alarms (a contrario, Desolneux et al. 2000).

    There are C(n, m) n'! / (n' − m)! ways to match m points. A minimal set of them fixes the motion, up to the roots
    of its polynomial, and each further point agrees accidentally with the probability that a random hyper-edge does.

    ``score``: of the assignment, all hyper-edges among its points evaluated. ``true_weight``: mean weight of a true
    hyper-edge. ``chance``: that of a random one over it.
    """
    n, n_target = shape
    m = min(supported_points(score, problem.order, true_weight), float(n), float(n_target))

    def log_factorial(x: float) -> float:
        return math.lgamma(x + 1.0)

    ways = (
        log_factorial(n)
        - log_factorial(m)
        - log_factorial(n - m)
        + log_factorial(n_target)
        - log_factorial(n_target - m)
    )
    agreement = (m - problem.minimal) * math.log(min(max(chance, 1e-12), 1.0))
    return (ways + math.log(problem.degree) + agreement) / math.log(10.0)
