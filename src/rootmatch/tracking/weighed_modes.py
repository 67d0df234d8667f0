"""The modes of a frame as the next hypotheses of a body: what each weighs, and which of them go on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.rig_triples import is_met_by_search
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.modes import Modes
from rootmatch.model.pose_density import MINIMUM
from rootmatch.model.priors import WRONG_MODEL, log_chance
from rootmatch.tracking.followed_places import (
    LOOKED_AT,
    log_return,
    relative_log_weights,
    sole_odds_of,
    sort_into_places,
)
from rootmatch.tracking.followed_pose import FollowedPose, Step, temper

LIKELY = 0.5
"""Probability of a mode, among all that a prediction may have become, from which its pose is used."""


class WeighedModes(NamedTuple):
    """The modes of a frame's posterior, and what it says of each as a hypothesis of the body."""

    modes: Modes
    origin: Integers
    """(K,) the hypothesis that each continues; −1 of a new one."""
    place: Integers
    """(K,) see `sort_into_places`."""
    alone: Floats
    more: Floats
    """(K,) both: log-odds of what each explains in its place for itself, and what the frames before add to that."""
    own: Floats
    """(K,) see `log_weight`, of the place of each; −∞ if there is one place only."""
    shown: Floats
    """(K,) part of each one's log-odds that tells which points are detected."""
    chances: Floats
    """(K,) logarithm of the probability of each."""
    weights: Floats
    """(K,) logarithm of the weight of each, without ``shown``."""
    others: bool
    """Whether the frame has something beside what is followed."""
    is_shown: bool
    """Whether the frame shows the body, whether or not its pose fits; what may be a copy is followed as well."""

    def steps(self, found: Finding, model: DetectionModel, nothing: float, log_shares: Floats) -> list[Step]:
        """The modes that hypotheses go on with.

        ``nothing``: logarithm of the probability that the frame does not show the body; ``log_shares``: of hypotheses,
        the last that of a new one.
        """
        modes, out = self.modes, list[Step]()
        for k, of in enumerate(self.origin.tolist()):
            if k and (modes.rotation[:k] == modes.rotation[k]).all(axis=(1, 2)).any():
                continue  # what is left of another mode
            if of < 0:
                many = is_met_by_search(found.task, model, modes.assignments[k], points=0)
                told_of = k == 0 and bool(found.prior_holds)  # by the caller
                chance = float((many or told_of) and (found.status is not Status.UNTRUSTED or self.is_shown))
            else:
                chance = math.exp(self.chances[k] - np.logaddexp(self.chances[k], nothing + log_shares[of]))
                if np.count_nonzero(modes.assignments[k] >= 0) < MINIMUM:  # its pose is that of these matches alone
                    chance *= math.exp(min(float(modes.log_odds[k] - modes.log_mass[k]), 0.0))
            if chance >= LIKELY:
                out.append(
                    Step(
                        float(self.weights[k]), float(self.shown[k]), of, k, chance,
                        place=int(self.place[k]), alone=float(self.alone[k]), more=float(self.more[k]),
                        weighed=float(self.own[k]),
                    )
                )  # fmt: skip
        return out


def weigh_modes(
    found: Finding,
    origin: Integers,
    log_shares: Floats,
    tempering: tuple[int, float],
    *,
    poses: Sequence[FollowedPose],
    maximum: int,
    time: float,
) -> tuple[WeighedModes, int]:
    """The modes of a frame with their weights, and the largest number of matches with which a place was weighed alone.

    ``origin``: (K,) the hypothesis, of ``poses``, that each mode continues. ``log_shares``: (H + 1,) of hypotheses, the
    last that of a new one. ``tempering``: the first mode that continues a hypothesis, and the power of the frame's
    evidence. ``maximum``: that number, before the frame.
    """
    (told, model), (first, often) = found.posterior_and_model, tempering
    modes = told.modes.first(LOOKED_AT)
    shown = modes.detected.copy()
    place, alone, more, own = sort_into_places(model, modes, origin, poses, shown)
    count = int(np.count_nonzero(modes.assignments[0] >= 0))
    places = place.tolist()
    if count > maximum and len(set(places)) == 1:
        maximum, alone[:] = count, max(alone[0], sole_odds_of(model, modes, 0))
    each = log_chance(told.probabilities[: len(origin)])
    followed, others = {one.place for one in poses}, False
    weight = log_shares[origin] + temper(each - log_shares[origin] - shown, origin, often) + more
    if not followed.issuperset(places):
        elsewhere = np.array([one not in followed for one in places])
        others = bool((elsewhere & ((alone > 0.0) | (each > math.log(WRONG_MODEL)))).any())
        new = elsewhere & (place != place[first]) & [not found.is_exchanged(k) for k in range(len(origin))]
        weight[new] = weight[first] + each[new] - each[first]  # no later frame makes more of it
        if new.any() and origin[first] >= 0:
            not_there = log_return(poses[origin[first]], time)
            weight[new] = weight[first] + not_there + relative_log_weights(model, modes, each, own, first)[new]
    is_shown = found.presence_probability + told.copy >= found.facts.min_probability
    weighed = WeighedModes(
        modes, origin, place,
        alone=alone, more=more, own=own, shown=shown, chances=each, weights=weight, others=others, is_shown=is_shown,
    )  # fmt: skip
    return weighed, maximum
