"""Whether a pose fits: how much larger the noise looks about it than it was given."""

from __future__ import annotations

import math
from typing import NamedTuple

from rootmatch.explain.decide import TRUST
from rootmatch.model.priors import NOISE_FREEDOM

MOST_INFLATION = 4.0
"""Largest factor on the given variances: of a pose that asks for more than twice the given σ nothing is believed. A
round value; what it refuses: the unrelated points of benchmarks/constellations.py."""


class Misfit(NamedTuple):
    """How much larger the noise looks than it was given, by the residuals of an assignment about its best pose."""

    variances: float
    """Factor on the variances that is believed, infinite where no pose fits: the given σ counts for
    `NOISE_FREEDOM` residuals."""
    sigma: float
    """Factor on σ by the residuals alone; NaN where a pose leaves none."""
    dof: int
    """Degrees of freedom of that."""

    @classmethod
    def of(cls, chi2: float, freedom: int) -> Misfit:
        """The misfit of a pose with this χ²."""
        sigma = math.sqrt(chi2 / freedom) if freedom else math.nan
        return cls((NOISE_FREEDOM + chi2) / (NOISE_FREEDOM + freedom), sigma, freedom)

    def log_odds_if_larger(self, log_odds: float) -> float:
        """Log-odds of the pose if σ was stated as many times too small, of those with the σ given.

        With Q = χ² all matches are of that σ: the terms of s² in docs/model.md for Q / f² in the place of Q, with the
        densities and the volume of the pose that are left of f⁻ᵈ.
        """
        chi2, d = self.dof * self.sigma**2, self.dof
        gained = 0.5 * (NOISE_FREEDOM + d) * math.log((NOISE_FREEDOM + chi2) / (NOISE_FREEDOM + d))
        return log_odds + gained - d * math.log(self.sigma)

    @property
    def chance(self) -> float:
        """How often residuals are as large as that where σ is right."""
        from scipy.special import gammaincc  # slow to import, rarely needed

        if not self.dof:
            return 1.0
        return float(gammaincc(0.5 * self.dof, 0.5 * self.dof * self.sigma**2))


def does_not_fit(fault: Misfit) -> bool:
    """Whether no pose fits an assignment within the noise that was given."""
    if not fault.variances <= MOST_INFLATION:
        return True
    return fault.sigma >= TRUST.noise_factor and fault.chance < TRUST.noise_chance
