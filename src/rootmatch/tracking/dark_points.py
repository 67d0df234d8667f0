"""Points that a tracker has not seen for a while although they face the camera: they are covered, or off.

An image alone says of each point anew whether it is shown. In a sequence a point that was dark a moment ago mostly is
so still, while clutter comes near it in every frame with the same probability. So the odds of its match are multiplied
by the probability that it is lit, a chain of two states that forgets within `LASTS` seconds. Points are taken to be
independent; several that come back together, as from behind a hand, are doubted more than they should be, for a frame.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.arrays import Bools, Floats
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.model.copy_or_alike import ANOTHER
from rootmatch.model.detection_model import USUAL_RATE
from rootmatch.model.elsewhere import MAXIMUM, seen_elsewhere
from rootmatch.model.image_alike import REACH
from rootmatch.model.priors import WRONG_MODEL
from rootmatch.tracking.followed_places import later_chance, return_factor
from rootmatch.tracking.foreign_lights import LIT, ForeignLights, missed
from rootmatch.tracking.mistaken_identity import FLOOR, TEMPER

LASTS = 0.25
"""Seconds within which a dark point may be lit as probably as any. A round value: as long as a hand takes to pass."""
REMEMBERED = 100
"""Frames of which the mean number of detections is remembered that the body does not explain. A round value."""
STILL = 0.5
"""Probability that what only passes a body is seen in the same place on it as in the last frame. A round value."""
FACING = 1e-3
"""Visibility of a point below which nothing is learned of it. A round value."""


class DarkPoints:
    """How probably each point of a body is lit, and each match is its own; nothing is known at first."""

    def __init__(self) -> None:
        self.lose()
        self.placed: Bools | None = None
        """Whether each point (m,) has been seen in its place, by two cameras at once, in a frame that was trusted."""
        self.more = math.inf
        """Log-odds that these are elsewhere, by how many detections are left; as if certain before any was seen."""
        self.left, self.frames = 0.0, 0
        """Mean number that is left about the body where they are in place, and of how many frames."""
        self.elsewhere = list[tuple[Floats, int]]()
        """Mean places (3,) on the body in which something was seen while points are dark, and of how many frames."""

    def lose(self) -> None:
        """Know no more which points are lit; where they are on the body stays as it was."""
        self.lit: Floats | None = None
        """Probability (n,) at `time`, of each sighting of a rig."""
        self.foreign = ForeignLights(0)
        self.time = -math.inf
        self._ahead: tuple[float, Floats] | None = None

    def at(self, time: float) -> Floats | None:
        """Probability (n,) that each point is lit at a time, before the frame is seen; None if nothing is known."""
        if self.lit is None:
            return None
        if self._ahead is None or self._ahead[0] != time:  # asked for as a frame is weighed and as it is learned from
            self._ahead = time, later_chance(self.lit, LIT, time - self.time, LASTS)
        return self._ahead[1]

    @property
    def holds(self) -> float:
        """See `ForeignLights.holds`; 1 if nothing is known."""
        return 1.0 if self.lit is None else self.foreign.holds

    def forget_lights(self) -> None:
        """Take what was matched for the body's points."""
        self.foreign = ForeignLights(len(self.foreign.own))

    def weighed(self, found: Finding, time: float) -> Finding:
        """A finding whose matches are less probable by what the frames before tell of their points."""
        lit, matched = self.at(time), found.assignment >= 0
        sure, chance = found.confidence, found.probability
        if lit is None or sure is None or chance is None or len(lit) != len(matched):
            return found
        assert found.posterior is not None
        whole, local = _match_credibility(found, sure)
        dark = np.minimum(found.posterior.modes.unmatched[found.mode], 1.0 - local)  # the rest is of other detections
        told = np.minimum(local * _lit_factor(dark, lit, missed(found, lit)), self.foreign.maximum(found, lit, time))
        less = float((told[matched] / np.maximum(local[matched], 1e-300)).prod())
        if less > 1.0 - WRONG_MODEL:
            return found
        return found.lower_probability(chance * less, np.where(matched, whole * told, sure))

    def take(self, found: Finding, time: float, log_back: float = 0.0) -> None:
        """Learn from a frame, if the body is more probably in it than not.

        If it was not seen in the last frame, its matches are as probable as that it is in view now; ``log_back``: see
        `Belief.presence_after_return`.
        """
        told, sure = found.posterior, found.confidence
        if told is None or sure is None or not len(told.probabilities):
            return
        present = return_factor(told.clutter, log_back)
        if (1.0 - told.clutter) * present < 0.5:
            return
        before, matched = self.at(time), found.assignment >= 0
        if before is None or len(before) != len(sure):
            before, self.foreign = np.full(len(sure), LIT), ForeignLights(len(sure))
        dark, less = told.unmatched, missed(found, before)
        own = self.foreign.maximum(found, before, time)
        chance = np.minimum((1.0 - dark) * _lit_factor(dark, before, less), own)  # that it was detected
        is_turned_away = told.modes.visible[found.mode] < FACING
        self.lit = np.where(is_turned_away, before, chance + (1.0 - chance) * before / less)
        if log_back < 0.0:
            self.foreign.since = time
        self.foreign.take(found, present * _match_credibility(found, sure)[1], before, time)
        if found.model is not None and len(found.model.images) > 1 and found.status is Status.MATCHED:
            seen = matched.reshape(len(found.model.images), -1).sum(axis=0) > 1
            self.placed = seen if self.placed is None else self.placed | seen
        if self.placed is not None:
            self._count_left(found, matched.reshape(-1, len(self.placed)))
        self.time, self._ahead = time, None

    def _count_left(self, found: Finding, matched: Bools) -> None:
        """Whether points that are dark in all cameras are seen elsewhere on the body, frame after frame.

        What is beside the body and no point of it was there before, or does not move as the body does. Both are numbers
        of a Poisson distribution. However often it recurs, the points may be dark, and what is seen a thing that nobody
        named and that is as rare as something else: so odds are bounded.
        """
        assert self.placed is not None
        dark = self.placed & ~matched.any(axis=0)
        if not dark.any():
            self.frames, self.more, self.elsewhere = min(self.frames + 1, REMEMBERED), FLOOR, []
            self.left += (_count_about(found) - self.left) / self.frames
            return
        shown = found.posterior_and_model[0].modes.visible[found.mode].reshape(matched.shape)[:, dark].sum()
        own, usual = USUAL_RATE * float(shown), self.left + 0.5
        gained = self._count_again(found) * math.log1p(own / usual) - own
        maximum = np.count_nonzero(dark) * math.log(ANOTHER / (1.0 - USUAL_RATE))
        self.more = min(max(self.more + min(TEMPER * gained, -math.log(STILL)), FLOOR), maximum)

    def _count_again(self, found: Finding) -> int:
        """Number of sightings of what is seen elsewhere on the body, where it was in the frames before.

        What does not move as the body does takes all back that was told of it.
        """
        told, model = found.posterior_and_model
        seen, count = seen_elsewhere(model, told.modes, found.mode), 0
        for place, covariance, sightings in seen:
            mean, frames = place, 1
            for k, (before, often) in enumerate(self.elsewhere):
                off = place - before
                if off @ np.linalg.solve(covariance * (1.0 + 1.0 / often), off) < REACH**2:
                    frames, count = min(often + 1, REMEMBERED), count + sightings
                    mean = before + off / frames
                    del self.elsewhere[k]
                    break
            self.elsewhere.append((mean, frames))
        self.elsewhere = self.elsewhere[-MAXIMUM:]
        if seen and not count:
            self.more = FLOOR
        return count


def _count_about(found: Finding) -> int:
    """Number of detections without a match that may be points of the body, if these are elsewhere on it."""
    told, model = found.posterior_and_model
    left, own = np.ones(model.shape[1], np.bool_), slice(found.mode, found.mode + 1)
    left[told.modes.assignments[own][told.modes.assignments[own] >= 0]] = False  # also what is doubtful
    if not left.any():
        return 0
    at, images = model.linearise_about(told.modes.rotation[own], told.modes.position[own]), len(model.images)
    weight = at.seen[0].reshape(images, -1, 1) / max(len(model.points) / images, 1.0)
    shown = np.maximum(weight.sum(axis=1), 1e-300)  # nothing is near the body in an image that shows none of it
    centre = (at.pixels[0].reshape(images, -1, 2) * weight).sum(axis=1) / shown
    reach = (
        0.5 * (REACH * model.radius) ** 2 * (at.jacobian[0, :, :, 3:].reshape(images, -1, 6) ** 2 * weight).sum((1, 2))
    )
    of = model.image_indices[left]
    off = model.target[left] - centre[of]
    return int(np.count_nonzero((off * off).sum(axis=1) < (reach / shown[:, 0])[of]))


def _lit_factor(dark: Floats, lit: Floats, less: Floats) -> Floats:
    """Factor (n,) on the probabilities of each point's detections, as it is ``lit`` with a probability.

    ``dark``: probability of none if it were lit for certain; ``less``: `missed`.
    """
    return lit / np.maximum((1.0 - dark) * lit + dark * less, 1e-300)


def _match_credibility(found: Finding, confidence: Floats) -> tuple[Floats, Floats]:
    """Probability (n,) that one of the poses with each match is right, and of the match given that.

    That a body has several poses makes no match doubtful, given one of them.
    """
    told, matched = found.posterior, found.assignment >= 0
    assert told is not None
    same = told.modes.assignments == found.assignment
    whole = told.probabilities @ same
    whole[~same[found.mode]] = told.probabilities[found.mode]  # of a blob's likeliest point
    given = confidence / np.maximum(whole, 1e-300)
    maximum = max(float(given[matched].max(initial=0.0)), 1e-300)
    return maximum * whole, np.minimum(given / maximum, 1.0)
