"""Sums over all one-to-one assignments, each the product of the odds of its matches: exact where few can be confused.

Points are taken one by one; what has to be remembered of those before is which detections they took that a later one
may want. Detections near one epipolar line are few, so these states are, and what they share is never repeated.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers

MAXIMUM = 3000
"""Steps from one state to another. Of more the least odds are left out. A round value: it bounds time."""
FEWEST = 3
"""Matches of an assignment that tells a relative pose. Fewer agree with poses all over the place, of which samples
about some tell nothing."""
ROUNDING = 1e-9
"""Part of a sum below which a difference is rounding. By construction."""
HARDER = 1.5
"""Logarithm by which the odds that count rise until there are so few. A round value."""


class Matchings(NamedTuple):
    """Sums over assignments, for each of K tables of odds."""

    log_total: Floats
    """(K,)"""
    rows: Integers
    """(P,) points of the pairs that may be matches."""
    columns: Integers
    """(P,) detections of those."""
    marginals: Floats
    """(K, P) probability of each pair."""
    log_odds: Floats
    """(K, P)"""

    def take(self, tables: Integers) -> Matchings:
        """The sums of some of the tables."""
        chosen = self.marginals[tables], self.log_odds[tables]
        return Matchings(self.log_total[tables], self.rows, self.columns, *chosen)


def sum_matchings(log_odds: Floats, rows: Integers, columns: Integers, order: Integers, minimum: float) -> Matchings:
    """Sums over all assignments.

    Parameters
    ----------
    log_odds : (K, P) array
        Of each pair against being unmatched.
    rows, columns : (P,) arrays
        Points and detections of the pairs.
    order : (n,) array
        Of the points; those that may have the same detections should follow each other.
    minimum : float
        Log-odds below which a pair counts for nothing in every table.
    """
    return _drop_small_matchings(_sum_any_size(log_odds, rows, columns, order, minimum))


def sum_matchings_by_part(log_odds: Floats, rows: Integers, columns: Integers, minimum: float) -> Matchings:
    """As `sum_matchings`, where many points have few detections near them: what has none in common is summed by itself.

    Its order is found, and the number of steps is bounded for each part.
    """
    good = np.flatnonzero(log_odds.max(axis=0, initial=-np.inf) > minimum)
    rows, columns, log_odds = rows[good], columns[good], log_odds[:, good]
    alone = (np.bincount(rows)[rows] == 1) & (np.bincount(columns)[columns] == 1)
    own = log_odds[:, alone]
    free = -np.logaddexp(0.0, own)
    parts = [Matchings(-free.sum(axis=1), rows[alone], columns[alone], np.exp(own + free), own)]
    for pairs, order in _iterate_components(rows, columns, np.flatnonzero(~alone)):
        parts.append(_sum_any_size(log_odds[:, pairs], rows[pairs], columns[pairs], order, minimum))
    log_total = np.sum([part.log_total for part in parts], axis=0)
    joined = (np.concatenate(each, axis=-1) for each in zip(*(part[1:] for part in parts), strict=True))
    return _drop_small_matchings(Matchings(log_total, *joined))


def _sum_any_size(log_odds: Floats, rows: Integers, columns: Integers, order: Integers, minimum: float) -> Matchings:
    """As `sum_matchings`, over assignments of any number of matches."""
    count, n = len(log_odds), len(order)
    highest = log_odds.max(axis=0)
    while True:
        good = highest > minimum
        own = [np.flatnonzero(good & (rows == i)) for i in order]
        possible = [columns[some].tolist() for some in own]
        if _count_transitions(possible) <= MAXIMUM:
            break
        minimum += HARDER
    kept = np.concatenate(own)
    rows, columns, chosen = rows[kept], columns[kept], log_odds[:, kept]
    # each point's own odds sum to one, so that nothing overflows
    first = np.concatenate([[0], np.cumsum([len(some) for some in possible])]).tolist()
    odds = np.exp(np.minimum(chosen, 600.0)).T
    scale, free = np.zeros(count), np.empty((n, count))
    for i in range(n):
        total = 1.0 + odds[first[i] : first[i + 1]].sum(axis=0)
        odds[first[i] : first[i + 1]] /= total
        free[i] = 1.0 / total
        scale += np.log(total)
    later = _future_masks(possible)
    forward: list[dict[int, Floats]] = [{0: np.ones(count)}]
    for i in range(n):
        reached: dict[int, Floats] = {}
        for state, weight in forward[-1].items():
            _add_weight(reached, state & later[i], weight * free[i])
            for place, k in enumerate(possible[i], first[i]):
                if not state >> k & 1:
                    _add_weight(reached, (state | 1 << k) & later[i], weight * odds[place])
        forward.append(reached)
    total = np.maximum(forward[-1][0], 1e-300)
    marginals = np.zeros((len(columns), count))
    backward: dict[int, Floats] = {0: 1.0 / total}
    for i in range(n - 1, -1, -1):
        before: dict[int, Floats] = {}
        for state, weight in forward[i].items():
            value = free[i] * backward[state & later[i]]
            for place, k in enumerate(possible[i], first[i]):
                if not state >> k & 1:
                    part = odds[place] * backward[(state | 1 << k) & later[i]]
                    marginals[place] += weight * part
                    value = value + part
            before[state] = value
        backward = before
    return Matchings(np.log(total) + scale, rows, columns, marginals.T, chosen)


def log_sum_of_enough(log_total: Floats, log_odds: Floats, rows: Integers, columns: Integers | None) -> Floats:
    """Logarithm (K,) of a sum over assignments, or of a bound of it, without those of fewer than `FEWEST` matches.

    ``columns`` None: a detection may have many points.
    """
    odds = np.exp(np.minimum(log_odds, 300.0))
    total = odds.sum(axis=1)
    pairs = total**2 - (_label_sums(odds, rows) ** 2).sum(axis=1)
    if columns is not None:
        pairs += (odds**2).sum(axis=1) - (_label_sums(odds, columns) ** 2).sum(axis=1)
    few = (1.0 + total + 0.5 * pairs) * np.exp(-np.minimum(log_total, 700.0))
    enough = few < 1.0 - ROUNDING
    return np.where(enough, log_total + np.log1p(-np.where(enough, few, 0.0)), -np.inf)


def _drop_small_matchings(sums: Matchings) -> Matchings:
    """Sums over the assignments of `FEWEST` matches and more."""
    log_total = log_sum_of_enough(sums.log_total, sums.log_odds, sums.rows, sums.columns)
    odds = np.exp(np.minimum(sums.log_odds, 300.0))
    of_row, of_column = (_label_sums(odds, some)[:, some] for some in (sums.rows, sums.columns))
    few = odds * (1.0 + odds.sum(axis=1, keepdims=True) - of_row - of_column + odds)
    known = np.isfinite(log_total)
    here = sums.marginals * np.exp(np.where(known, sums.log_total - log_total, 0.0))[:, None]
    few *= np.exp(-np.where(known, np.minimum(log_total, 700.0), 0.0))[:, None]
    return sums._replace(log_total=log_total, marginals=np.clip(here - few, 0.0, 1.0))


def _iterate_components(rows: Integers, columns: Integers, pairs: Integers) -> Iterator[tuple[Integers, Integers]]:
    """Pairs that have points or detections in common, and the points of each such part, neighbours after each other."""
    of_row: dict[int, list[int]] = {}
    of_column: dict[int, list[int]] = {}
    for pair, row, column in zip(pairs.tolist(), rows[pairs].tolist(), columns[pairs].tolist(), strict=True):
        of_row.setdefault(row, []).append(pair)
        of_column.setdefault(column, []).append(pair)
    left = dict.fromkeys(of_row)
    while left:
        order = [next(iter(left))]
        del left[order[0]]
        for row in order:  # which grows
            for pair in of_row[row]:
                for other in of_column[int(columns[pair])]:
                    if (beside := int(rows[other])) in left:
                        del left[beside]
                        order.append(beside)
        yield np.array([pair for row in order for pair in of_row[row]]), np.array(order)


def _label_sums(values: Floats, labels: Integers) -> Floats:
    """Sums (K, L) of values (K, P) of each label."""
    members = labels[:, None] == np.arange(int(labels.max(initial=0)) + 1)
    return np.asarray(values @ members)


def _add_weight(states: dict[int, Floats], state: int, weight: Floats) -> None:
    """Add a weight to that of a state."""
    states[state] = states[state] + weight if state in states else weight


def _future_masks(possible: list[list[int]]) -> list[int]:
    """Detections that a later point may want, after each point, as bits."""
    kept, later = [], 0
    for some in reversed(possible):
        kept.append(later)
        for k in some:
            later |= 1 << k
    return kept[::-1]


def _count_transitions(possible: list[list[int]]) -> int:
    """Number of steps from one state to another, or more than `MAXIMUM`."""
    states, steps = {0}, 0
    for some, mask in zip(possible, _future_masks(possible), strict=True):
        steps += len(states) * (1 + len(some))
        if steps > MAXIMUM:
            return steps
        states = {
            (state | taken) & mask for state in states for taken in (0, *(1 << k for k in some if not state >> k & 1))
        }
    return steps
