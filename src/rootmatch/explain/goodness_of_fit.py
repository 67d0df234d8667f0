"""Whether a pose fits: how much larger the noise looks about it than it was given."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.explain.decide import TRUST
from rootmatch.explain.finding import Finding
from rootmatch.model.image_alike import LOG_INEXACT, OWN
from rootmatch.model.priors import NOISE_FREEDOM, WRONG_MODEL

MAX_INFLATION = 4.0
"""Largest factor on the given variances: of a pose that asks for more than twice the given σ nothing is believed. A
round value; what it refuses: the unrelated points of benchmarks/constellations.py."""
SHAPE = 0.2
"""Of the distribution Beta(a, 1) of the chance of residuals as large as those of something else. A round value."""
MAX_ALIKE = 300.0
"""Largest logarithm of what is worth a number."""
FREEDOM_OF_RIG = 5.0
"""Residuals by which σ is known about a pose before a rig, whose calibration may be off by more in one place than in
another. A round value."""


ANOTHER = (
    "another object that differs in a point, such as a variant of the body that `bodies=` should name as well, or the "
    "body with a mistake in an input (see `diagnose`)"
)
"""What advice says if `Misfit.another` is most of the doubt."""


class Misfit(NamedTuple):
    """How much larger the noise looks than it was given, by the residuals of an assignment about its best pose."""

    variances: float
    """Factor on the variances that is believed, infinite where no pose fits: the given σ counts for
    `NOISE_FREEDOM` residuals."""
    sigma: float
    """Factor on σ by the residuals alone; NaN where a pose leaves none."""
    dof: int
    """Degrees of freedom of that."""
    alike: Floats | None = None
    """Log-odds (W,) of points that are off, see `rootmatch.model.image_alike`; None if nothing is near any that has no
    match."""
    another: float = -math.inf
    """Log-odds of something else that shares some of the points, see `rootmatch.model.elsewhere`, or one line."""
    moved: float = 0.0
    """How far its detections move with the points, see `rootmatch.model.evidence.residual_statistics`."""

    @classmethod
    def of(cls, chi2: float, freedom: int, moved: float = 0.0) -> Misfit:
        """The misfit of a pose with this χ²."""
        sigma = math.sqrt(chi2 / freedom) if freedom else math.nan
        return cls((NOISE_FREEDOM + chi2) / (NOISE_FREEDOM + freedom), sigma, freedom, moved=moved)

    @classmethod
    def of_finding(cls, found: Finding) -> Misfit | None:
        """The misfit of a finding; None if nothing is known of its residuals."""
        if (factor := found.noise_factor) is None:
            return None
        return cls(factor**2, factor, found.noise_dof, found.alike, found.another, moved=found.moved)

    def rescaled_log_odds(self, log_odds: float) -> float:
        """Log-odds of the pose if σ was stated as many times too small, of those with the σ given.

        With Q = χ² all matches are of that σ: the terms of s² in docs/model.md for Q / f² in the place of Q, with the
        densities and the volume of the pose that are left of f⁻ᵈ.
        """
        chi2, d = self.squared, self.dof
        gained = 0.5 * (NOISE_FREEDOM + d) * math.log((NOISE_FREEDOM + chi2) / (NOISE_FREEDOM + d))
        return log_odds + gained - d * math.log(self.sigma)

    @property
    def squared(self) -> float:
        """χ² of the residuals."""
        return self.dof * self.sigma**2 if self.dof else 0.0

    @property
    def chance(self) -> float:
        """How often residuals are as large as that where σ is right."""
        from scipy.special import gammaincc  # slow to import, rarely needed

        if not self.dof:
            return 1.0
        return float(gammaincc(0.5 * self.dof, 0.5 * self.dof * self.sigma**2))

    def odds_of_something_else(self, of_rig: bool = False) -> float:
        """How much more probable what is found is of something else than the body, which has nearly its shape.

        The chance of residuals as large is uniform for the body, and has a Beta distribution towards 0 for anything
        else (compare Sellke, Bayarri and Berger 2001). What is beside points without a match tells of it as well.
        """
        beside = 0.0 if self.alike is None else float(np.exp(np.minimum(self.alike, MAX_ALIKE)).mean())
        if not self.dof:
            return 1.0 + beside
        chance = float(_tail_of_f()(self.dof, FREEDOM_OF_RIG if of_rig else NOISE_FREEDOM, self.sigma**2))
        return beside + float(SHAPE * max(chance, 1e-300) ** (SHAPE - 1.0))

    def log_odds_of_errors(self, log_inexact: Sequence[float]) -> Floats:
        """Log-odds (OWN,) of the body with points that are off, of the body as given, with their prior.

        ``log_inexact``: see `MatchingTask.log_inexact`.
        """
        before = LOG_INEXACT + np.array(log_inexact or (0.0,) * OWN)
        return np.full(OWN, -np.inf) if self.alike is None else before + self.alike[:OWN]

    def largest_error_gain(self, log_inexact: Sequence[float]) -> float:
        """The largest of these without their prior, if that is the most probable of the body; 0 if it is as given."""
        odds = self.log_odds_of_errors(log_inexact)
        which = int(odds.argmax())
        return float(self.alike[which]) if self.alike is not None and odds[which] > 0.0 else 0.0


@cache
def _tail_of_f() -> Callable[..., Any]:
    """SciPy's complement of the F distribution, which is slow to import; frame after frame asks for it."""
    from scipy.special import fdtrc

    return fdtrc  # type: ignore[no-any-return]


def discount_misfit(
    found: Finding, fault: Misfit, of_rig: bool = False, *, alike: float = 0.0, as_off: float = 0.0
) -> Finding:
    """A finding that is less probable by how its residuals speak for something else; a wrong model is allowed for.

    ``alike``: share of what else there is that has nearly the shape, as where a scene repeats itself. ``as_off``: odds
    of the body with points that are off, of the body as given: that is the body, too.
    """
    as_given = fault.alike is None and fault.another == -math.inf and not fault.sigma > 1.0
    if found.facts.probability is None or as_given:
        return found
    odds = WRONG_MODEL + alike
    against = odds * fault.odds_of_something_else(of_rig) + math.exp(min(fault.another, MAX_ALIKE))
    own = min((1.0 + odds) / (1.0 + against / (1.0 + as_off)), 1.0)
    present = None if found.facts.present is None else own * found.facts.present
    return found.with_facts(present=present).scale_probability(own)


def is_misfit(fault: Misfit) -> bool:
    """Whether no pose fits an assignment within the noise that was given."""
    if not fault.variances <= MAX_INFLATION:
        return True
    return fault.sigma >= TRUST.noise_factor and fault.chance < TRUST.noise_chance
