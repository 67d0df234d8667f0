"""Two point sets that are alike, and not the same: what stands by one law in both, as trees of streets and racks do.

Two streets whose trees stand every ten metres have many trees near each other at some motion: nearer than by chance,
but w from their places, where w is larger than the noise. Some of these are within the noise, and at the best of all
motions many. Against clutter that is evidence for the same points; against an alike scene it is not. So sets may also
be alike: all points deviate by w more, one of the widths of `rootmatch.model.repetition`, or by as large a part of the
spacing about each, as what is like itself in another size does. That is no answer, as a mirror image is none. Points
that have a target near their place, and not in it, tell the one from the other: of the same points there are none.

Where the source shows the same points, what is beside them may be alike to others of its points, a period away. So the
odds of a labelling grow by the odds of its matches and all other targets, as an alike scene, over those of its matches
alone. A target near the place of a point that has no match is none of these others, as a place holds one point.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.deadline import checkpoint
from rootmatch.model.modes import used_mask
from rootmatch.model.point_set_model import Judged, PointSetModel
from rootmatch.model.priors import ALIKE, probability
from rootmatch.model.repetition import RIVALS, SHARED, repetition_widths, select_rival_motions
from rootmatch.problems.points import pairwise_squared_distances
from rootmatch.problems.pose_fit.point_set_fit import FEWEST
from rootmatch.samplers.point_sets.congruent import grow_labellings

BEYOND = 2.0
"""Least width, in σ of a match, at one point: a deviation that noise explains makes nothing alike. A round value."""
NEAR = 4.0 / math.sqrt(2.0 * math.pi * math.e)
"""Deviation, in the largest width times √k, up to which a target is nearer to a place than by chance: up to there
N(d; 0, w² I) is above the density of targets for the w that makes it largest."""
REACH = 4.0
"""Widths within which a point may join an alike motion that is fitted to it. A round value."""
ROUNDS = 3
"""Rounds in which a labelling is fitted and takes what is near its motion. A round value."""
MARGIN = 6.0
"""By how much an alike scene has to be less probable than the same points, at best, to be left out: it changes their
probability by a four-hundredth. A round value; it bounds time."""
NEIGHBOUR = 2
"""Neighbour whose distance is the spacing about a point. A round value."""
PARTS = 0.25 * 0.5 ** np.arange(4)
"""Widths in parts of the spacing about each point: as wide as the widest of all targets', and down to a 32nd."""


class Likeness(NamedTuple):
    """What an alike scene makes of hypotheses."""

    log_odds: float
    """Logarithm of prior times evidence of an alike scene against clutter alone."""
    motions: Integers
    """(G, n) labellings of motions."""
    log_more: Floats
    """(G,) logarithm of the factor on the odds of the labellings about each."""

    def log_factors(self, assignments: Integers) -> Floats:
        """Logarithm (K,) of the factor on the odds of each assignment (K, n)."""
        factors, matched = np.zeros(len(assignments)), (assignments >= 0).sum(axis=1)
        for one, more in zip(self.motions[::-1], self.log_more[::-1], strict=True):  # the best one last
            fewer = np.minimum(matched, int((one >= 0).sum()))
            factors[((assignments == one) & (one >= 0)).sum(axis=1) >= SHARED * fewer] = more
        return factors


def weigh_likeness(model: PointSetModel, proposals: Judged) -> Likeness:
    """Evidence that the sets are alike, from judged labellings, and what it adds to theirs.

    Nothing, where an alike scene is improbable beside the best of them, or that is no better than clutter.
    """
    model = replace(model, prior=None)  # nothing is known of the motion of something else
    clouds, nothing = model.clouds, Likeness(-math.inf, proposals.fit.assignments[:0], np.empty(0))
    if not proposals.log_odds.max(initial=-np.inf) > 0.0:
        return nothing
    found = proposals.take(select_rival_motions(proposals, minimum=-np.inf))
    squared = float(found.fit.scale[0]) ** 2
    noise = float(clouds.target_variance.max() + squared * clouds.source_variance.max())
    minimum, level = BEYOND * math.sqrt(noise), float(found.log_odds[0]) - MARGIN
    every = _likeness_widths(model, math.sqrt(squared))
    widths = [one for one in every if one.max() > minimum and _max_alike_log_odds(model, found, one, noise) > level]
    if not widths:
        return nothing
    rivals = found.take(np.flatnonzero(found.log_odds > 0.0))
    near = _is_near_unmatched(
        rivals, NEAR * math.sqrt(clouds.target.shape[1]) * float(repetition_widths(model.clutter)[0])
    )
    matched = used_mask(rivals.fit.assignments, len(clouds.target))
    parts = np.array([matched | ~near, matched])
    judged = [_weigh_width(model, found, parts, rivals, w / math.sqrt(squared)) for w in widths]
    total, elsewhere, more, own = (np.logaddexp.reduce(part) for part in zip(*judged, strict=True))
    # whether the source is like itself: what is alike elsewhere tells; if so, an alike scene is as probable as none
    itself = probability(float(elsewhere) - math.log(len(widths) / ALIKE))
    gained = np.maximum(more - own, 0.0)
    return Likeness(
        math.log(ALIKE + itself) + float(total) - math.log(len(widths)),
        rivals.fit.assignments,
        np.logaddexp(0.0, math.log(max(itself, 1e-300)) + gained),
    )


def _likeness_widths(model: PointSetModel, scale: float) -> Floats:
    """Widths (W, n) at the points of the source: as much everywhere, or in parts of the spacing about each of them."""
    points, everywhere = model.clouds.source, repetition_widths(model.clutter)[: len(PARTS), None]
    squared = pairwise_squared_distances(points[None], points)[0]
    spacing = scale * np.sqrt(np.sort(squared, axis=1)[:, min(NEIGHBOUR, len(points) - 1)])
    return np.concatenate([np.repeat(everywhere, len(points), axis=1), PARTS[:, None] * spacing])


def _max_alike_log_odds(model: PointSetModel, found: Judged, width: Floats, noise: float) -> float:
    """About the most log-odds of an alike scene of some widths: of labellings with all that is near their motions."""
    fit, size = found.fit, model.clouds.target.shape[1]
    widest, wider = 1.0 + float(width.max()) ** 2 / noise, 1.0 + float(width.min()) ** 2 / noise
    near = pairwise_squared_distances(fit.places[0], fit.clouds.target) < (REACH * width[:, None]) ** 2
    near &= ~used_mask(fit.assignments, near.shape[2])[:, None]
    near &= (fit.assignments < 0)[:, :, None]
    others = np.minimum(near.any(axis=2).sum(axis=1), near.any(axis=1).sum(axis=1))
    maximum = found.log_odds + 0.5 * fit.chi2 * (1.0 - 1.0 / widest) - 0.5 * fit.dof * math.log(wider)
    each = model.log_volume - 0.5 * size * (math.log(2.0 * math.pi * noise * wider) + 1.0)
    for k, (matched, more) in enumerate(zip((fit.assignments >= 0).sum(axis=1), others, strict=True)):
        counts = model.log_counts[matched : matched + more + 1]
        maximum[k] += float((np.arange(len(counts)) * each + counts - counts[0]).max())
    return float(maximum.max())


def _weigh_width(
    model: PointSetModel, found: Judged, parts: Bools, rivals: Judged, width: Floats
) -> tuple[float, float, Floats, Floats]:
    """Log-odds at one width, in units of the source: of all labellings, and of the best elsewhere than the first.

    And (G,), about the motions of rivals: of each of two parts (2, G, n') of the targets.
    """
    checkpoint()
    wide = replace(model, repeated=model.clutter, clouds=model.clouds.off_by(width))
    judged = wide.judge(grow_about(wide, found.fit.assignments, model.allowed))
    best = judged.take(np.argsort(-judged.log_odds, kind="stable")[: 2 * RIVALS])
    labels, first = best.fit.assignments, found.fit.assignments[0]
    fewer = np.minimum((labels >= 0).sum(axis=1), int((first >= 0).sum()))
    apart = ((labels == first) & (first >= 0)).sum(axis=1) < SHARED * fewer
    labels = np.concatenate([labels, rivals.fit.assignments])  # which have all that is matched
    more, own = _weigh_target_parts(wide, labels, parts)
    return float(np.logaddexp.reduce(best.log_odds)), float(best.log_odds[apart].max(initial=-np.inf)), more, own


def grow_about(model: PointSetModel, labels: Integers, allowed: Bools | None) -> Integers:
    """Labellings (K, n) with those of what is near their motions, as long as that finds more."""
    for _ in range(ROUNDS):
        before, labels = labels, grow_labellings(model.clouds, labels, model.mirror, allowed)
        if np.array_equal(before, labels):
            break
    return labels


def _is_near_unmatched(rivals: Judged, distance: float) -> Bools:
    """Which targets (G, n') are near the place of a point that has no match."""
    target, fit = rivals.fit.clouds.target, rivals.fit
    near = pairwise_squared_distances(fit.places[0], target) < distance**2
    return np.asarray((near & (fit.assignments < 0)[:, :, None]).any(axis=1))


def _weigh_target_parts(model: PointSetModel, labels: Integers, which: Bools) -> Floats:
    """Log-odds (P, G) of all labellings (K, n) with some targets (P, G, n') only; −∞ where that leaves no motion."""
    parts = np.where((labels >= 0) & which[..., np.maximum(labels, 0)], labels, -1)
    enough = (parts >= 0).sum(axis=-1) >= FEWEST
    odds = np.full(enough.shape, -np.inf)
    if enough.any():  # many are the same
        distinct, number = np.unique(parts[enough], axis=0, return_inverse=True)
        odds[enough] = model.judge(distinct).log_odds[number]
    return np.asarray(np.logaddexp.reduce(odds, axis=-1))
