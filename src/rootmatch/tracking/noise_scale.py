"""The noise of a sequence: how much larger its residuals are than the σ that was stated, and whether points are off.

A calibration that is off by a pixel is so in every frame, so what one frame tells of σ is the prior of the next one:
the inverse gamma distribution of the variances' factor s², of which the model of an image integrates the rest.

Residuals that are too large may be those of something else, a reflection or another model of a controller. These stay
the same from one frame to the next one, where those of noise are drawn anew: how much they change tells s² of the noise
alone, whatever is followed. It is taken in also of frames that fit with `MAX_OF_CHANGES` times the noise only.

Or they are those of points that are off, though no noise of them was stated: these stay as well. Once that is certain,
the points have a noise as if it had been stated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Hashable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from rootmatch.arrays import Bools, Floats, median
from rootmatch.explain.body_labels import Label
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.goodness_of_fit import MAX_INFLATION
from rootmatch.explain.inexact_points import error_gains
from rootmatch.model.evidence import normalised_deviations
from rootmatch.model.image_alike import OWN
from rootmatch.model.priors import NOISE_FREEDOM, WRONG_MODEL
from rootmatch.tracking.mistaken_identity import TEMPER

Findings = Mapping[Label | None, Finding]

MAX_FREEDOM = 1000.0
"""Residuals that are remembered, those of some thirty frames: the factor may change, as with a lens that warms up. A
round value."""
MAXIMUM, MAX_OF_RIG = math.sqrt(MAX_INFLATION), 4.0
"""Largest factor on σ that is believed: of one camera as of one image, and of a rig, whose calibration may be off by
more than the noise: a pose takes up what is wrong with one camera, not what is wrong between several. What fits with no
less is another object: of 1,440 frames that show the asked ring of LEDs beside one of another layout, which came first,
491 were trusted for the wrong one with 4.0, 136 with 2.0. The second is a round value."""
MAX_OF_CHANGES = 4.0
"""Largest factor on σ that is believed of residuals that change from frame to frame. A round value."""
FREEDOM_OF_CHANGES = 100.0
"""Changes that are remembered, those of a few frames: vibration comes and goes. A round value."""
FADES = 0.8
"""What the last few frames count for after each. A round value."""
MAX_OF_MEAN = 4.0
"""Of the squared residual of a point, relative to the mean: one in fifty is larger. A round value."""
VAGUE = 2.0
"""Residuals for which a scale of which hardly anything is known counts. A round value."""
LOG_CHANGED, MAX_OF_FRAME = math.log(WRONG_MODEL), -0.5 * math.log(WRONG_MODEL)
"""Log-odds, at first, that the noise has become another one, and what one frame says of that at most: a pose that comes
upon something else changes once, where noise is drawn anew in each frame."""
QUIET = 1.2
"""Factor on σ up to which the residuals of a frame are no sign of more noise. A round value: a frame of ten points has
a larger one in one of six."""
FEW = 4
"""Points, least, whose residuals are compared: of fewer, a pose leaves nothing."""
MINIMUM = 8.0 * math.log(WRONG_MODEL)
"""Log-odds from which frames are not asked any more: points stay as they are."""
FRAME = -0.5 * math.log(WRONG_MODEL)
"""Log-odds that one frame adds at most."""


@dataclass
class Scale:
    """Inverse gamma distribution of the factor on the variances; at least 1 is believed."""

    maximum: float
    chi2: float = NOISE_FREEDOM
    freedom: float = NOISE_FREEDOM

    @property
    def factor(self) -> float:
        """Of σ."""
        return max(math.sqrt(self.chi2 / self.freedom), 1.0)

    def take(self, chi2: float, freedom: float) -> None:
        """Take in residuals, and forget those of long ago."""
        self.chi2 += chi2
        self.freedom += freedom
        if self.freedom > self.maximum:
            self.chi2, self.freedom = self.maximum / self.freedom * self.chi2, self.maximum

    def log_density(self, chi2: float, freedom: float) -> float:
        """Of the χ² of further residuals, but for what does not depend on those before."""
        a, b = 0.5 * self.freedom, 0.5 * (self.freedom + freedom)
        return math.lgamma(b) - math.lgamma(a) + a * math.log(self.chi2) - b * math.log(self.chi2 + chi2)


stated_scale = partial(Scale, FREEDOM_OF_CHANGES)
"""The scale of changes as σ was stated."""
vague_scale = partial(stated_scale, VAGUE, VAGUE)
"""One that is hardly known."""


@dataclass(frozen=True)
class Residuals:
    """Residuals (n, 2) of a frame in units of the stated noise, of matched points (n,).

    They are those of the best pose without any prediction, which would take a few frames to follow something else.
    """

    of: Floats
    matched: Bools
    dof: int

    @classmethod
    def about(cls, found: Finding, factor: float) -> Residuals | None:
        """Those of a finding that is trusted, made with σ times a factor, unless it contradicts a prediction."""
        model, told = found.model, found.posterior
        if found.status is not Status.MATCHED or found.prior_holds is False or model is None or told is None:
            return None
        mode = told.modes.take(slice(found.mode, found.mode + 1))
        matched = (found.assignment >= 0) & (found.assignment == mode.assignments[0])
        if (count := int(matched.sum())) < FEW:
            return None
        if found.point_error:  # in units of the noise alone
            model = replace(model, source_covariance=None)
        at = model.linearise_about(mode.rotation, mode.position)
        offset, jacobian = (one[0, matched] for one in normalised_deviations(model, mode.assignments, at))
        rows = jacobian.reshape(2 * count, -1)
        step, _, rank, _ = np.linalg.lstsq(rows, offset.ravel(), rcond=None)
        of = np.zeros((len(matched), 2))
        of[matched] = offset - (rows @ step).reshape(count, 2)
        return cls(factor * of, matched, 2 * count - int(rank))


@dataclass
class NoiseScale:
    """The factor on the stated σ that the frames so far suggest; at least 1."""

    residuals: Scale = field(default_factory=lambda: Scale(MAX_FREEDOM + NOISE_FREEDOM))
    changes: Scale = field(default_factory=stated_scale)
    is_stated: bool = True
    """Whether nothing says that the noise alone is more than it was stated to be."""
    fresh: float = 0.0
    every: float = 0.0
    """Variance of the residuals that changed in the last few frames, and all of it."""
    new: Scale = field(default_factory=vague_scale)
    """Of the changes since the noise may have become another one."""
    log_new: float = LOG_CHANGED
    """Log-odds that it has (a test of Page, 1954)."""
    last: dict[Hashable, Residuals | None] = field(default_factory=dict)
    waiting: list[Hashable] = field(default_factory=list)
    """Labels of the bodies that the next frame looks for with more noise, instead of a search."""
    stays: float | None = None
    """Log-odds that residuals, which are those of points that are off, stay; of the last frame."""

    @property
    def factor(self) -> float:
        """Of σ."""
        return max(self.residuals.factor, self.changes.factor)

    @property
    def is_doubted(self) -> bool:
        """Whether the last residuals suggest another noise, and the next ones will tell."""
        return self.log_new > LOG_CHANGED

    def take(self, found: Finding, factor: float) -> None:
        """Take in the residuals of a frame's finding, which was made with σ times a factor.

        They count if the pose is certain, whether or not it fits: that no pose fits as well says that σ is too small.
        """
        facts, dof, ratio = found.facts, found.noise_dof, found.noise_factor
        sure = facts.sure_of_the_rest and facts.present is not None and facts.present >= facts.min_probability
        maximum = MAXIMUM if found.task.rig is None else MAX_OF_RIG
        if found.point_error:  # one frame does not tell which of both it is
            return
        if found.labellings is not None and found.alike is not None:  # they may be those of something else
            return
        if not sure or not dof or ratio is None or not ratio * factor <= maximum:
            return
        self.residuals.take(dof * (ratio * factor) ** 2, dof)

    def compare(
        self,
        parts: Findings,
        asked: Container[Hashable],
        factor: float,
        with_more: Callable[[float], Findings],
        *,
        later: bool,
    ) -> bool:
        """Compare the residuals of each body with those of the frame before; whether the noise has become another one.

        ``parts``: findings of a frame, made with σ times a ``factor``. ``asked``: bodies to look for with more noise,
        if they are not trusted and do not fit; ``with_more``: from another factor to the findings with it. ``later``:
        whether the next frame looks for them, as this one was searched, which takes long enough.
        """
        doubtful = {label for label, part in parts.items() if label in self.waiting or _is_bad_fit(part, factor)}
        each: list[Hashable] = [label for label in doubtful if label in asked]
        louder, before = with_more(MAX_OF_CHANGES) if each and not later else {}, self.changes
        self.waiting = each if later else []
        for label, part in parts.items():
            if label not in doubtful:
                self.take_changes(label, part, factor)
            elif louder and label in asked:
                self.take_changes(label, louder[label], MAX_OF_CHANGES)
        return self.changes is not before

    def take_changes(self, label: Hashable, found: Finding, factor: float) -> None:
        """Take in how much the residuals of a body differ from those of the frame before."""
        self.stays = None
        quiet = found.status is Status.MATCHED and (found.noise_factor or 0.0) * factor < QUIET
        quiet &= not found.point_error
        if quiet and self.is_stated:  # as usual: nothing to compare
            self.new, self.log_new, self.last[label] = vague_scale(), LOG_CHANGED, None
            return
        before, now = self.last.get(label), Residuals.about(found, factor)
        self.last[label] = now
        if before is None or now is None:
            return
        both = before.matched & now.matched
        if (count := int(both.sum())) < FEW:
            return
        each = _residual_variance(now.of[both]), _residual_variance(before.of[both])
        changed = _residual_variance(now.of[both] - before.of[both]) / 2.0
        if found.point_error:
            size = max(min(each), 1.0)
            freedom = now.dof * count / max(int(now.matched.sum()), 1)
            self.stays = 0.5 * freedom * (math.log(size) - changed * (1.0 - 1.0 / size))
        self.fresh = FADES * self.fresh + changed
        self.every = FADES * self.every + 0.5 * sum(each)
        if self.fresh < 0.5 * self.every:  # they correlate by more than a half: what they are of stays
            changed = min(changed, self.changes.factor**2)
        left = now.dof / (2.0 * now.matched.sum())
        freedom = count * left
        chi2 = freedom * min(changed / left, MAX_OF_CHANGES**2)
        gain = self.new.log_density(chi2, freedom) - self.changes.log_density(chi2, freedom)
        self.log_new += min(max(gain, -MAX_OF_FRAME), MAX_OF_FRAME)
        self.new.take(chi2, freedom)
        if self.log_new > 0.0:
            seen = self.new.chi2 - VAGUE, self.new.freedom - VAGUE
            self.is_stated = stated_scale().log_density(*seen) > vague_scale().log_density(*seen)
            self.changes = stated_scale() if self.is_stated else self.new
            self.new, self.log_new = vague_scale(), LOG_CHANGED
        elif not self.is_stated:
            self.changes.take(chi2, freedom)
        if self.log_new < LOG_CHANGED:
            self.new, self.log_new = vague_scale(), LOG_CHANGED


def is_frame_of_row(frame: int, every: int) -> bool:
    """Whether a frame does what takes long and compares a frame with the one before: the first half of ``every`` do."""
    return 2 * (frame % every) < every


def scale_noise_by(noise: Any, factor: float) -> Any:
    """A noise that is so many times as large: standard deviations, covariances, or a pair of these for point sets."""
    if isinstance(noise, str):  # it is estimated in each frame
        return noise
    if isinstance(noise, tuple | list) and len(noise) == 2:
        return tuple(scale_noise_by(one, factor) for one in noise)
    return np.asarray(noise) * factor ** (1 if np.ndim(noise) < 3 else 2)


def _is_bad_fit(found: Finding, factor: float) -> bool:
    """Whether a finding with σ times a factor is not trusted, and its residuals are larger than usual."""
    return found.status is not Status.MATCHED and (found.noise_factor or 0.0) * factor >= QUIET


def _residual_variance(residuals: Floats) -> float:
    """Variance of residuals (k, 2), of which some may be those of wrong matches: larger ones count no more."""
    squared = (residuals**2).sum(axis=1)
    usual = median(squared) / math.log(2.0)  # twice the variance
    return float(np.minimum(squared, MAX_OF_MEAN * usual).mean()) / 2.0


@dataclass
class InexactPoints:
    """Whether the points of a followed body are off."""

    log_odds: tuple[float, ...] = (0.0,) * OWN
    """By the fit of the frames so far; see `MatchingTask.log_inexact`."""
    log_stay: float = math.log(WRONG_MODEL)
    """That residuals which are too large stay the same (a test of Page, 1954)."""
    error: float | None = None
    """Standard deviation of a coordinate, once it is certain."""

    def take(self, found: Finding | None, stays: float | None) -> None:
        """Learn from a frame of a single body.

        ``stays``: log-odds, by the residuals of this frame and those of the one before, that they stay.
        """
        if found is None or found.status is not Status.MATCHED or self.error is not None:
            return
        if found.labellings is None and (found.model is None or len(found.model.images) > 1):
            return
        if not found.point_error and found.task.points.source_covariance is not None:
            return
        if not found.point_error:
            if self.log_odds[-1] > MINIMUM and found.noise_dof and found.noise_factor is not None:
                gains = [min(max(TEMPER * gain, -FRAME), FRAME) for gain in error_gains(found).tolist()]
                told = [one + gain for one, gain in zip(self.log_odds, gains, strict=True)]
                self.log_odds = tuple(min(max(one, MINIMUM), 0.0) for one in told)
            return
        self.log_odds = tuple(min(one + FRAME, 0.0) for one in self.log_odds)
        if stays is not None:
            self.log_stay = max(self.log_stay + min(max(stays, -FRAME), FRAME), math.log(WRONG_MODEL))
        if self.log_stay > 0.0:
            self.error = found.point_error
