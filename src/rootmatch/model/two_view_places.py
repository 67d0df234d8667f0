"""Where in the first image the points are that have a match: what moves by itself, or is hidden, lies together.

The detection rate is one for all points. But a vehicle that has moved since is a crowd of points that the pose of the
street has no images for, and one of them whose epipolar line crosses a detection by accident looked as probable as a
house. So given a pose, points with a match and points without one have densities of their own, each predicted from the
others of its kind, by the shares and widths in which all points crowd (`rootmatch.model.clutter`): the odds of a pair
have the ratio of the two as a factor. Neither is a reason for the pose, whose probability stays what it was.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.model.clutter import Clutter
from rootmatch.model.matchings import sum_matchings_by_part
from rootmatch.model.two_view_posterior import MINIMUM, TwoViewPosterior


def reweigh_by_crowding(told: TwoViewPosterior) -> TwoViewPosterior:
    """A posterior whose odds of pairs are those of points at such places."""
    if told.model.crowds is None:
        return told
    parts = []
    for drawn, weights, sums in told.parts:
        matched = np.zeros(told.model.shape[0])
        np.add.at(matched, sums.rows, weights @ sums.marginals / weights.sum())
        more = log_member_density(told.model.crowds, matched) - log_member_density(told.model.crowds, 1.0 - matched)
        again = sum_matchings_by_part(sums.log_odds + more[sums.rows], sums.rows, sums.columns, MINIMUM)
        log = np.where(weights > 0.0, again.log_total - sums.log_total, -np.inf)
        own = np.flatnonzero(np.isfinite(log))
        if not len(own):
            return told
        now = weights[own] * np.exp(log[own] - log[own].max())
        parts.append((drawn.take(own), now * (weights.sum() / now.sum()), again.take(own)))
    return replace(told, parts=parts)


def log_member_density(crowds: Clutter, members: Floats) -> Floats:
    """Logarithm (n,) of the density of points that are members with some probabilities (n,), each given all others.

    One more of them lies anywhere.
    """
    others = members.sum() - members + 1.0
    about = crowds.about @ members[crowds.centres] + crowds.crowd_share * crowds.uniform
    return np.asarray(np.log(crowds.alone * crowds.uniform + about / others))
