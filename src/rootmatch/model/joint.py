"""Joint hypotheses of several bodies: one labelling of each, or none, such that no detection is used twice.

The odds of a joint hypothesis against clutter alone are the product of those of its parts, but for the number of
clutter points: clutter is what none of the bodies explains, so each body gains by what the others explain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers

BEAM = 4096
"""Most joint hypotheses that are kept from one body to the next, the most probable ones. A round value."""


def joint_marginals(
    uses: Sequence[Bools],
    masses: Sequence[Floats],
    log_left: Callable[[Bools], Floats],
    *,
    given: Sequence[int] | None = None,
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
    given : sequence of int, optional
        The body on which the log-odds of each depend; −1 for none.

    Returns
    -------
    list of (M + 1,) arrays
        Probability of each hypothesis, and of the body's absence as the last.
    """
    if len(uses) == 1:
        return [_softmax(np.concatenate([masses[0], [0.0]]))]
    count = uses[0].shape[1]
    absent = np.zeros((1, count), np.float32)  # of floats: products of Booleans take longer
    taken, value = np.zeros((1, count), np.float32), np.zeros(1)
    whole, chosen = value, np.empty((1, 0), np.int64)
    for used, mass, of in zip(uses, masses, given or [-1] * len(uses), strict=True):
        own = np.atleast_2d(mass) - log_left(used)
        mine, own = np.concatenate([used, absent]), np.concatenate([own, np.zeros((len(own), 1))], axis=1)
        with np.errstate(invalid="ignore"):  # BLAS may set the flag for what it pads small matrices with
            row, mode = (taken @ mine.T < 0.5).nonzero()  # which joint hypotheses leave which modes their detections
        value = value[row] + own[chosen[row, of] if of >= 0 and len(own) > 1 else 0, mode]
        taken = taken[row] + mine[mode]
        whole = value + log_left(taken > 0.5)
        chosen = np.concatenate([chosen[row], mode[:, None]], axis=1)
        if len(value) > BEAM:
            best = np.argsort(-whole, kind="stable")[:BEAM]
            value, taken, whole, chosen = value[best], taken[best], whole[best], chosen[best]
    shares = _softmax(whole)
    counts = [np.bincount(chosen[:, k], shares, mass.shape[-1] + 1) for k, mass in enumerate(masses)]
    return [np.asarray(one, np.float64) for one in counts]


def remaining_parts(assignments: Integers, others: Bools, shared: Bools, least: int) -> tuple[Integers, Integers]:
    """What remains of assignments (K, n) if others (J, n') take the detections that they share, each part once.

    The row (P,) that each is part of, and the parts (P, n) with so many matches at the ``least``; ``shared`` (J, K):
    which take anything from which.
    """
    known, rows, parts = {one.tobytes() for one in assignments}, list[int](), [assignments[:0]]
    for other, row in np.argwhere(shared).tolist():
        part = np.where((assignments[row] >= 0) & others[other, assignments[row]], -1, assignments[row])
        if np.count_nonzero(part >= 0) >= least and part.tobytes() not in known:
            known.add(part.tobytes())
            rows.append(row)
            parts.append(part[None])
    return np.array(rows, np.int64), np.concatenate(parts)


def _softmax(log_odds: Floats) -> Floats:
    """Probabilities of hypotheses by their log-odds."""
    shares = np.exp(log_odds - log_odds.max())
    return np.asarray(shares / shares.sum())
