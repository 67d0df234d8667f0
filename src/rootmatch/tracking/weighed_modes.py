"""The modes of a frame as the next hypotheses of a body: what each weighs, and which of them go on."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.rig_triples import search_meets
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.modes import Modes
from rootmatch.model.pose_density import LEAST
from rootmatch.tracking.followed_pose import Step

LIKELY = 0.5
"""Probability of a mode, among all that a prediction may have become, from which its pose is used."""


class WeighedModes(NamedTuple):
    """The modes of a frame's posterior, and what it says of each as a hypothesis of the body."""

    modes: Modes
    origin: Integers
    """(K,) the hypothesis that each continues; −1 of a new one."""
    place: Integers
    """(K,) see `in_places`."""
    alone: Floats
    more: Floats
    """(K,) both: log-odds of what each explains in its place for itself, and what the frames before add to that."""
    shown: Floats
    """(K,) part of each one's log-odds that tells which points are detected."""
    chances: Floats
    """(K,) logarithm of the probability of each."""
    weights: Floats
    """(K,) logarithm of the weight of each, without ``shown``."""

    def is_shown(self, found: Finding) -> bool:
        """Whether a frame shows the body, whether or not its pose fits; what may be a copy is followed as well."""
        copy = 0.0 if found.posterior is None else found.posterior.copy
        return found.in_view + copy >= found.facts.min_probability

    def steps(self, found: Finding, model: DetectionModel, nothing: float, log_shares: Floats) -> list[Step]:
        """The modes that hypotheses go on with.

        ``nothing``: logarithm of the probability that the frame does not show the body; ``log_shares``: of hypotheses,
        the last that of a new one.
        """
        modes, is_shown, out = self.modes, self.is_shown(found), list[Step]()
        for k, of in enumerate(self.origin.tolist()):
            if k and (modes.rotation[:k] == modes.rotation[k]).all(axis=(1, 2)).any():
                continue  # what is left of another mode
            if of < 0:
                many = search_meets(found.task, model, modes.assignments[k], points=0)
                told_of = k == 0 and bool(found.prior_holds)  # by the caller
                chance = float((many or told_of) and (found.status is not Status.UNTRUSTED or is_shown))
            else:
                chance = math.exp(self.chances[k] - np.logaddexp(self.chances[k], nothing + log_shares[of]))
                if np.count_nonzero(modes.assignments[k] >= 0) < LEAST:  # its pose is that of these matches alone
                    chance *= math.exp(min(float(modes.log_odds[k] - modes.log_mass[k]), 0.0))
            if chance >= LIKELY:
                out.append(
                    Step(
                        float(self.weights[k]), float(self.shown[k]), of, k, chance,
                        place=int(self.place[k]), alone=float(self.alone[k]), more=float(self.more[k]),
                    )
                )  # fmt: skip
        return out
