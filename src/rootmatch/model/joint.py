"""Joint hypotheses of several bodies: one labelling of each, or none, such that no detection is used twice.

The odds of a joint hypothesis against clutter alone are the product of those of its parts, but for the number of
clutter points: clutter is what none of the bodies explains, so each body gains by what the others explain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers

BEAM = 4096
"""Most joint hypotheses that are kept from one body to the next, see `thin_hypotheses`. A round value."""
FEW = 64
"""Joint hypotheses that are not looked through for some that can be merged: it would take longer. A round value."""
IMPOSSIBLE = -20.0
"""Log-odds that a hypothesis never exceeds, whatever the others take, for it to be left out: 2e-9."""
LISTED = 128
"""Choices of a mode of each body, or none, up to which all are weighed at once. A round value."""


class _Step(NamedTuple):
    """What a body adds to joint hypotheses (K,) of those before it: each takes one of its modes, or none."""

    before: Floats
    """(K,) log-odds."""
    row: Integers
    """(E,) the joint hypothesis that goes on."""
    mode: Integers
    """(E,) with this mode of the body."""
    gain: Floats
    """(E,) and so much more log-odds."""
    after: Integers
    """(E,) as this joint hypothesis."""

    def thinned(self, kept: Integers, more: Floats, count: int) -> _Step:
        """The same where some of so many joint hypotheses are kept, and have so much more log-odds."""
        place = np.full(count, -1)
        place[kept] = np.arange(len(kept))
        after = place[self.after]
        left = after >= 0
        return _Step(self.before, self.row[left], self.mode[left], (self.gain + more[after])[left], after[left])


def joint_marginals(
    uses: Sequence[Bools],
    masses: Sequence[Floats],
    log_left: Callable[[Bools], Floats],
    *,
    images: Integers | None = None,
    given: Sequence[int] | None = None,
    same: Sequence[Sequence[int]] = (),
) -> list[Floats]:
    """The marginal probabilities of each body's hypotheses.

    Parameters
    ----------
    uses : sequence of (M, n') bool arrays
        Which detections each hypothesis of a body takes.
    masses : sequence of (M,) or (L + 1, M) arrays
        Log-odds of each, prior included, against its absence, if all other detections are clutter; a row for each
        hypothesis of a body before it, and that one's absence, if it depends on that.
    log_left : callable
        From detections (K, n') that are taken to the logarithm (K,) of the odds of as many clutter points as they
        leave; part of the log-odds.
    images : (n',) int array, optional
        The image of each detection, if that depends on how many are taken in each.
    given : sequence of int, optional
        The body on which the log-odds of each depend; −1 for none.
    same : sequence of sequence of int
        Numbers, ascending, of bodies whose hypotheses and log-odds are the same, and so are their marginals.

    Returns
    -------
    list of (M + 1,) arrays
        Probability of each hypothesis, and of the body's absence as the last.
    """
    if len(uses) == 1:
        return [_softmax(np.concatenate([masses[0], [0.0]]))]
    count, of_each = uses[0].shape[1], given or [-1] * len(uses)
    if not same and math.prod([len(used) + 1 for used in uses]) <= LISTED:
        return _list_marginals(uses, masses, log_left, of_each)
    possible = _possible_hypotheses(uses, masses, log_left, of_each)
    if any(len(some) < len(used) for some, used in zip(possible, uses, strict=True)):
        left = [
            mass[some] if mass.ndim == 1 else mass[np.ix_(np.append(possible[of], -1), some)]
            for mass, some, of in zip(masses, possible, of_each, strict=True)
        ]
        taking = [used[some] for used, some in zip(uses, possible, strict=True)]
        told = joint_marginals(taking, left, log_left, images=images, given=given, same=same)
        every = [np.zeros(len(used) + 1) for used in uses]
        for shares, some, of_some in zip(every, possible, told, strict=True):
            shares[np.append(some, -1)] = of_some
        return every
    alike = {k: (alike[p - 1] if p else -1, len(alike) - p) for alike in same for p, k in enumerate(alike)}
    asks = [of if mass.ndim > 1 else -1 for of, mass in zip(of_each, masses, strict=True)]
    absent = np.zeros((1, count), np.float32)  # of floats: products of Booleans take longer
    taken, value = np.zeros((1, count), np.float32), np.zeros(1)
    chosen, steps = np.empty((1, 0), np.int64), list[_Step]()
    for k, (used, mass, of) in enumerate(zip(uses, masses, asks, strict=True)):
        previous, orders = alike.get(k, (-1, 1))
        own = np.atleast_2d(mass) - log_left(used) + math.log(orders)
        mine, own = np.concatenate([used, absent]), np.concatenate([own, np.zeros((len(own), 1))], axis=1)
        with np.errstate(invalid="ignore"):  # BLAS may set the flag for what it pads small matrices with
            row, mode = (taken @ mine.T < 0.5).nonzero()  # which joint hypotheses leave which modes their detections
        if previous >= 0:  # bodies that are the same in the order of their hypotheses stand for all orders
            (ordered,) = ((mode > chosen[row, previous]) | (mode == len(used))).nonzero()
            row, mode = row[ordered], mode[ordered]
        gain = own[chosen[row, of] if of >= 0 else 0, mode]
        before, value, first = value, value[row] + gain, np.arange(len(row))
        following, after = range(k + 1, len(uses)), first
        if len(row) > FEW and following:
            asked = {asks[j] for j in following} | {alike[j][0] for j in following if j in alike}
            wanted = np.asarray(np.concatenate([uses[j] for j in following]).any(axis=0))
            of_taken, of_mode = _key_weights(wanted, images, [j in asked for j in range(k + 1)])
            keys = taken.astype(np.int64) @ of_taken + chosen @ of_mode[:k]
            own_keys = mine.astype(np.int64) @ of_taken + np.arange(len(mine)) * of_mode[k]
            first, after = _find_equal(keys[row] + own_keys[mode])
            value = _sum_logs(value, after, len(first))
        step = _Step(before, row, mode, gain, after)
        taken = taken[row[first]] + mine[mode[first]]
        chosen = np.concatenate([chosen[row[first]], mode[first, None]], axis=1)
        if len(value) > BEAM and following:
            future = _largest_future_worth(uses[k + 1 :], masses[k + 1 :], count)
            kept, more = thin_hypotheses(value + log_left(taken > 0.5) - taken @ future, BEAM)
            step = step.thinned(kept, more, len(value))
            value, taken, chosen = value[kept] + more, taken[kept], chosen[kept]
        steps.append(step)
    found = _marginals(steps, log_left(taken > 0.5), [mass.shape[-1] + 1 for mass in masses])
    for bodies in same:
        for each in bodies, [k for k, of in enumerate(of_each) if of in bodies]:  # and what depends on them
            mean = np.sum([found[k] for k in each], axis=0) / max(len(each), 1)
            found = [mean if k in each else one for k, one in enumerate(found)]
    return found


def _possible_hypotheses(
    uses: Sequence[Bools], masses: Sequence[Floats], log_left: Callable[[Bools], Floats], given: Sequence[int]
) -> list[Integers]:
    """Those of each body's hypotheses that may have a probability.

    Each is compared with the body's absence. It is worth the more, the more clutter the others explain: at most all
    that any of theirs take.
    """
    explained = [used.any(axis=0) for used in uses]
    found = list[Integers]()
    for k, (used, mass) in enumerate(zip(uses, masses, strict=True)):
        others = np.any([*explained[:k], *explained[k + 1 :]], axis=0)
        maximum = np.atleast_2d(mass).max(axis=0) + log_left(used | others) - log_left(used) - log_left(others & ~used)
        for of, one in zip(given, masses, strict=True):
            if of == k and one.ndim > 1 and one.size:
                with np.errstate(invalid="ignore"):  # what is impossible beside both
                    maximum += np.nan_to_num(one[:-1] - one[-1]).max(axis=1).clip(min=0.0)
        found.append(np.flatnonzero(maximum > IMPOSSIBLE))
    return found


def _list_marginals(
    uses: Sequence[Bools], masses: Sequence[Floats], log_left: Callable[[Bools], Floats], given: Sequence[int]
) -> list[Floats]:
    """As `joint_marginals` of a few hypotheses, of which every choice is listed."""
    modes, rows = _list_choices(tuple([len(used) for used in uses]))
    every = np.concatenate([*uses, np.zeros((1, uses[0].shape[1]), np.bool_)])
    taken = every[rows].sum(axis=0)
    left = log_left(np.concatenate([every, taken > 0]))
    value = left[len(every) :] - left[rows].sum(axis=0)
    for chosen, mass, of in zip(modes, masses, given, strict=True):
        gains = np.zeros((*mass.shape[:-1], mass.shape[-1] + 1))
        gains[..., :-1] = mass
        value += gains[chosen] if mass.ndim == 1 else gains[modes[of], chosen]
    shares = _softmax(np.where((taken > 1).any(axis=1), -np.inf, value))
    each = zip(modes, uses, strict=True)
    return [np.bincount(chosen, shares, len(used) + 1).astype(np.float64) for chosen, used in each]


@lru_cache(maxsize=64)
def _list_choices(counts: tuple[int, ...]) -> tuple[Integers, Integers]:
    """Every choice of one of so many modes of each body, or none as the last (B, K), and its row among all modes."""
    modes = np.indices([one + 1 for one in counts]).reshape(len(counts), -1)
    first, maximum = np.cumsum([0, *counts])[:-1, None], np.array(counts)[:, None]
    return modes, np.where(modes < maximum, first + modes, sum(counts))


def _key_weights(wanted: Bools, images: Integers | None, asked: Sequence[bool]) -> tuple[Integers, Integers]:
    """Weights of taken detections (n',) and of the mode of each body: a joint hypothesis has their sum as its key.

    Keys differ, but by a chance of 2⁻⁶⁴, where that makes a difference to what follows: by which of the ``wanted``
    detections (n',) are taken, by how many are in each image, and by the modes of bodies that are ``asked`` for.
    """
    image = np.zeros(len(wanted), np.int64) if images is None else images
    some = np.random.default_rng(0).integers(-(2**63), 2**63 - 1, len(wanted) + len(asked) + image.max(initial=0) + 1)
    of_taken, of_mode, of_image = np.split(some, [len(wanted), len(wanted) + len(asked)])
    return of_image[image] + wanted * of_taken, of_mode * np.array(asked)


def _find_equal(keys: Integers) -> tuple[Integers, Integers]:
    """The first (G,) of each kind of joint hypotheses by their keys (K,), in order, and the kind (K,) of each."""
    _, first, kind = np.unique(keys, return_index=True, return_inverse=True)
    order = first.argsort()
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    return first[order], place[kind]


def _marginals(steps: Sequence[_Step], after: Floats, counts: Sequence[int]) -> list[Floats]:
    """The probability of each mode, of so many, by all joint hypotheses; ``after``: (K,) what the last are worth."""
    found = list[Floats]()
    for step, count in zip(reversed(steps), reversed(counts), strict=True):
        worth = step.gain + after[step.after]
        found.append(np.bincount(step.mode, _softmax(step.before[step.row] + worth), count).astype(np.float64))
        after = _sum_logs(worth, step.row, len(step.before))
    return found[::-1]


def _sum_logs(values: Floats, groups: Integers, count: int) -> Floats:
    """Logarithms (count,) of the sums of what has logarithms (K,), by groups (K,)."""
    top = np.full(count, -np.inf)
    np.maximum.at(top, groups, values)
    top = np.maximum(top, -1e300)
    with np.errstate(divide="ignore"):
        return np.asarray(top + np.log(np.bincount(groups, np.exp(values - top[groups]), count)))


def _largest_future_worth(uses: Sequence[Bools], masses: Sequence[Floats], count: int) -> Floats:
    """What each of so many detections (n',) is worth to bodies that are still to come, at most.

    What they would take if it was left is no reason to prefer that another one has taken it.
    """
    maximum = np.zeros(count)
    for used, mass in zip(uses, masses, strict=True):
        each = np.maximum(np.atleast_2d(mass).max(axis=0), 0.0) / np.maximum(used.sum(axis=1), 1)
        maximum = np.maximum(maximum, (used * each[:, None]).max(axis=0, initial=0.0))
    return maximum


def thin_hypotheses(log_odds: Floats, maximum: int) -> tuple[Integers, Floats]:
    """At most so many of hypotheses (K,), and logarithms of factors on their odds, with which they stand for all.

    The most probable ones are kept as they are. Of the others, every so often one is kept for as much as lies between:
    where copies are in many places, all orders of them are as probable, and the first few alone would name them.
    """
    order = np.argsort(-log_odds, kind="stable")
    weights = np.exp(log_odds[order] - log_odds[order[0]])
    rest = weights[::-1].cumsum()[::-1]
    whole = int((weights[:maximum] * (maximum - np.arange(maximum)) <= rest[:maximum]).argmax())
    each = rest[whole] / (maximum - whole)
    if not each > 0.0:
        return order[:whole], np.zeros(whole)
    others = whole + np.searchsorted(weights[whole:].cumsum(), each * (np.arange(maximum - whole) + 0.5))
    return order[np.append(np.arange(whole), others)], np.append(np.zeros(whole), np.log(each / weights[others]))


def remaining_parts(assignments: Integers, others: Bools, shared: Bools, minimum: int) -> tuple[Integers, Integers]:
    """What remains of assignments (K, n) if others (J, n') take the detections that they share, each part once.

    The row (P,) that each is part of, and the parts (P, n) with so many matches at the ``minimum``; ``shared`` (J, K):
    which take anything from which.
    """
    other, row = shared.nonzero()
    own = assignments[row]
    parts = np.where((own >= 0) & others[other[:, None], own], -1, own)
    (enough,) = (np.count_nonzero(parts >= 0, axis=1) >= minimum).nonzero()
    known = dict.fromkeys(_row_bytes(assignments), -1)
    for k, part in zip(enough.tolist(), _row_bytes(parts[enough]), strict=True):
        known.setdefault(part, k)
    kept = np.array([k for k in known.values() if k >= 0], np.int64)
    return row[kept], parts[kept]


def _row_bytes(rows: Integers) -> list[bytes]:
    """Each row of a table (K, m), to compare it as a whole."""
    return np.ascontiguousarray(rows).view(f"V{rows.itemsize * rows.shape[1]}").ravel().tolist()


def _softmax(log_odds: Floats) -> Floats:
    """Probabilities of hypotheses by their log-odds."""
    shares = np.exp(log_odds - log_odds.max())
    return np.asarray(shares / shares.sum())
