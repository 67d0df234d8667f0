"""Labellings of two point sets: those proposed and their neighbours, each weighed by a fit of its own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.deadline import checkpoint
from rootmatch.hypergraph.assignment import are_targets_disjoint
from rootmatch.model.exact_sets import LEADING, is_turned, share_by_exact_shapes
from rootmatch.model.labelling_sums import LabellingSums, is_same_motion, sum_labellings
from rootmatch.model.point_set_model import Judged, PointSetModel
from rootmatch.model.priors import COPY, COUNTS

MIRRORED = 0.01
"""Prior probability that the targets are a mirror image of the object, because an axis is flipped or a frame is
left-handed, although no reflection was asked for. If that explains them, nothing is trusted. A round value."""
KEPT = 64
"""Largest number of hypotheses whose shares are summed, and of those elsewhere. A round value."""
NEGLIGIBLE = 12.0
"""Log-odds against the best hypothesis beyond which a hypothesis is ignored. A round value."""
WORTH = 5.0
"""Log-odds against the best hypothesis up to which a hypothesis' neighbours are weighed. A round value."""
ROUNDS = 3
"""Largest number of rounds of weighing neighbours. A round value."""
EXPANDED = 6
"""Hypotheses whose neighbours are weighed in each round. A round value."""
CHANGES = 64
"""Number of changes of a hypothesis that are weighed, the most probable ones. A round value."""
MOTIONS = 8
"""Largest number of motions about which all labellings are summed. A round value."""
ENOUGH = 8.0
"""Number of samples that must count if a sum is to add to the probability of a motion. A round value."""


class Changes(NamedTuple):
    """K changes of one assignment: a source point gets another target, and maybe a second point another one."""

    source: Integers
    """(K,) source point."""
    target: Integers
    """(K,) its new target, −1 where it becomes unmatched."""
    other: Integers
    """(K,) second source point, −1 for none."""
    other_target: Integers
    """(K,) the new target of the second point, −1 for none."""

    def take(self, which: NDArray[np.integer] | Bools) -> Changes:
        """A subset of the changes."""
        return Changes(*(column[which] for column in self))

    def apply_to(self, assignment: Integers) -> Integers:
        """The changed assignments, (K, n)."""
        changed = np.repeat(assignment[None], len(self.source), axis=0)
        rows, second = np.arange(len(changed)), self.other >= 0
        changed[rows, self.source] = self.target
        changed[rows[second], self.other[second]] = self.other_target[second]
        return changed


def likely_changes(assignment: Integers, gains: Floats, minimum: float) -> tuple[Changes, Floats]:
    """The one-change neighbours whose gain to first order is above ``minimum``, and those gains.

    An assignment is a neighbour if a point is moved to a free target, becomes unmatched or hands its target to an
    unmatched point, or if two points exchange their targets; neighbours are listed in this order.

    Parameters
    ----------
    assignment : (n,) int64 array
    gains : (n, n') array
        What each correspondence adds, given the rest of the assignment; finite where it is in the assignment.
    minimum : float
    """
    from rootmatch.hypergraph.change_listing import list_changes  # takes Numba

    capacity = 4 * len(assignment) + 16
    while True:
        columns, gain = np.empty((4, capacity), np.int64), np.empty(capacity)
        count = list_changes(assignment, gains, minimum, columns, gain)
        if count <= capacity:
            return Changes(*columns[:, :count]), gain[:count]
        capacity = count


class Weighed(NamedTuple):
    """Labellings of one body, the best one first, weighed against clutter alone.

    Attributes
    ----------
    assignments : (K, n) int64
    log_odds : (K,) float64
        Of each by itself, without what is known of the motion.
    log_mass : (K,) float64
        With it, and with what a self-motion of the source makes equal.
    mirrored : (n,) int64, optional
        The best labelling by a reflection, which is no answer.
    log_mirrored : float
        Its log-odds, prior included.
    sums : sequence of LabellingSums
        Over all labellings about the most probable motions, if there are many more than these.
    """

    assignments: Integers
    log_odds: Floats
    log_mass: Floats
    mirrored: Integers | None
    log_mirrored: float
    sums: Sequence[LabellingSums] = ()

    def take(self, which: Integers) -> Weighed:
        """Some of the labellings."""
        return self._replace(**{name: getattr(self, name)[which] for name in ("assignments", "log_odds", "log_mass")})


def empty_weighed(n: int) -> Weighed:
    """No labelling of n points."""
    return Weighed(np.empty((0, n), np.int64), np.empty(0), np.empty(0), None, -math.inf)


def weigh_labellings(
    model: PointSetModel, proposals: Judged, mirrored: Integers | None = None, *, of_several: bool = False
) -> Weighed:
    """Proposed labellings of three matches or more and their neighbours by one change, the best ones of them.

    Neighbours are weighed by fits of their own. Labellings that a self-motion of the source exchanges become equally
    probable to the degree that the source is exactly symmetric under it. ``mirrored``: labellings (M, n) by
    reflections, which are not answers. ``of_several``: whether other bodies may take what the best ones need.

    Raises
    ------
    OutOfTime
        If the deadline in force passes: without its neighbours a labelling would look more certain than it is.
    """
    if not len(proposals.log_odds):
        return empty_weighed(len(model.clouds.source))
    checkpoint()
    kept = found = _select_best(proposals, of_several)
    model.keep(found.take(slice(1)))
    known_ones = {one.tobytes() for one in found.fit.assignments}
    expanded: set[bytes] = set()
    for _ in range(ROUNDS):
        fit, odds = found.fit, found.log_odds
        likely = np.argsort(-odds, kind="stable")[: np.count_nonzero(odds > odds.max() - WORTH)].tolist()
        waiting = [k for k in likely if fit.assignments[k].tobytes() not in expanded][:EXPANDED]
        new: list[Integers] = []
        for k in waiting:
            checkpoint()
            one = fit.assignments[k]
            expanded.add(one.tobytes())
            changes, gains = likely_changes(one, model.gains(fit, k), odds.max() - odds[k] - NEGLIGIBLE)
            some = np.argsort(-gains, kind="stable")[:CHANGES]
            better = changes.take(some[gains[some] > 0.0])
            for other in (*changes.take(some).apply_to(one), _apply_disjoint_changes(one, better)):
                if other.tobytes() not in known_ones and (other >= 0).sum() >= 3:
                    known_ones.add(other.tobytes())
                    new.append(other)
        if not new:
            break
        found = found.joined(model.judge(np.array(new)))
    if found is not kept:
        found = _select_best(found, of_several)
        model.keep(found.take(slice(1)))
    assignments, known = found.fit.assignments, found.known  # which tells symmetric motions from each other
    odds = found.log_odds - known
    maximum, mass = float(odds.max()), found.log_odds.copy()
    images = [] if mirrored is None else [mirrored, proposals.fit.assignments]
    image = _best_mirror_image(model, images, assignments, found.log_odds)
    sums = []
    in_question = np.logaddexp.reduce(mass) > max(image[1], model.log_absent) - WORTH
    if in_question and len(odds) >= KEPT and np.sort(odds)[-KEPT] > maximum - NEGLIGIBLE:
        sums = _sum_likely_motions(model, assignments, found.log_odds)
        left = np.ones(len(assignments), np.bool_)  # what is about two motions counts for the better one
        for one in sums:
            own = is_same_motion(assignments, one.about, model.twins)
            if one.count >= ENOUGH:
                mass[left & own] -= math.log(max(float(one.shares(assignments[own]).sum()), 1e-300))
            left &= ~own
    return Weighed(assignments, odds, share_by_exact_shapes(model, found, mass), *image, sums)


def _sum_likely_motions(model: PointSetModel, assignments: Integers, log_odds: Floats) -> list[LabellingSums]:
    """The sums over all labellings about the most probable motions of some, the best one first."""
    sums: list[LabellingSums | None] = []
    left = np.ones(len(assignments), np.bool_)
    while len(sums) < MOTIONS and left.any():
        best = int(np.where(left, log_odds, -np.inf).argmax())
        if log_odds[best] < log_odds.max() + math.log(LEADING):
            break
        checkpoint()
        own = left & is_same_motion(assignments, assignments[best], model.twins)
        order = np.flatnonzero(own)[np.argsort(-log_odds[own], kind="stable")]
        sums.append(sum_labellings(model, assignments[order], np.exp(log_odds[order] - log_odds[best])))
        left &= ~own
    return [one for one in sums if one is not None]


def _apply_disjoint_changes(assignment: Integers, changes: Changes) -> Integers:
    """An assignment with as many of some changes, the best first, as do not concern the same points or targets."""
    changed, touched = assignment.copy(), np.zeros(len(assignment), np.bool_)
    for row in zip(*changes, strict=True):
        points = [point for point in row[::2] if point >= 0]
        new = [target for target in row[1::2] if target >= 0]
        others = np.delete(changed, points)
        if not touched[points].any() and not np.isin(new, others).any():
            changed[points], touched[points] = row[1 : 2 * len(points) : 2], True
    return changed


def _select_best(found: Judged, of_several: bool) -> Judged:
    """The best hypotheses that are not negligible, those of a copy, and turns of the best one, which is the first.

    Of several bodies, all that are better than clutter: others may take what a better one needs.
    """
    odds, assignments = found.log_odds, found.fit.assignments
    if len(odds) == 1:
        return found
    order = np.argsort(-odds, kind="stable")
    minimum = 0.0 if of_several else -math.log(COPY)
    apart = are_targets_disjoint(assignments[order], assignments[order[0]]) & (odds[order] > minimum - COUNTS)
    near = (odds[order] > odds[order[0]] - 2.0 * NEGLIGIBLE) & (np.arange(len(order)) < KEPT)
    if of_several:
        near |= (odds[order] > 0.0) & (np.arange(len(order)) < KEPT)
    # by how much a turn that an exact symmetry makes is worse, is chance: the more so, the more points
    more = apart | (is_turned(assignments[order], assignments[order[0]]) & (odds[order] > 0.0))
    order = order[near | (more & (np.cumsum(more & ~near) <= KEPT))]
    return found.take(order)


def _best_mirror_image(
    model: PointSetModel, labellings: Sequence[Integers], assignments: Integers, odds: Floats
) -> tuple[Integers | None, float]:
    """The best mirror image and its log-odds, prior included.

    Points nearly in a plane fit a reflection as well as a rotation; with the same labels, a reflection is a different
    answer only by what it explains better. Labellings that a rotation explains roughly may be those of a mirror image.
    """
    mirrored = np.concatenate([*labellings, assignments[:0]])
    if not len(mirrored):
        return None, -math.inf
    weight = reflected_log_odds(model, mirrored)
    for one, value in zip(assignments, odds, strict=True):
        same = (mirrored == one).all(axis=1)
        more = np.maximum(weight[same] - value, 0.0)
        weight[same] += np.log1p(-np.exp(-more), where=more > 0.0, out=np.full(len(more), -np.inf))
    best = int(np.argmax(weight))
    return mirrored[best], float(weight[best]) + math.log(MIRRORED)


def reflected_log_odds(model: PointSetModel, labellings: Integers) -> Floats:
    """Log-odds (M,) of labellings (M, n) by reflections; −∞ where a rotation fits one better."""
    image = replace(model, mirror=True).judge(labellings)
    return np.where(np.linalg.det(image.fit.rotation) < 0.0, image.log_odds, -np.inf)
