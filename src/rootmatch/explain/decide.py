"""The decision: whether a match can be trusted, by one rule from named facts.

Stages of the pipeline state facts about what they found. `decide` is the only function that makes a `Status` of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum


@dataclass(frozen=True)
class TrustOptions:
    """Thresholds of the status, set on the tuning seeds of `benchmarks/accuracy.py` (docs/notebook/comparison.md)."""

    margin: float = 0.2
    """Least lead in score of a matched assignment if no probability is known."""
    false_alarms: float = -2.0
    """Decimal logarithm of the expected number of false alarms up to which an assignment is trusted."""
    noise_factor: float = 1.9
    noise_chance: float = 1e-3
    """Factor on σ suggested by the residuals about the best pose, from which an assignment is not trusted if such
    residuals are rarer than this chance when σ is right: σ was stated too small, and points may be missing. With σ
    1.5 times too small no match is wrong; with four times, some are."""
    max_named: float = 8.0
    """Factor up to which the advice blames the noise rather than the match. A round value."""
    missed: float = 0.05
    """Probability that there is another pose which explains as much and was missed, beyond which an assignment is
    ambiguous: the search was cut short before it looked for one. As `MIN_PROBABILITY`; searches that end by
    themselves are below it."""
    alternatives: int = 16
    """Largest number of alternatives kept."""
    support: float = 0.25
    """Share of the median support below which a matched point is left unmatched: true matches seldom have less than
    0.3, accidental ones seldom more than 0.2."""
    last_support: float = 0.1
    last_pairs: int = 4
    """The same share if at most so many pairs would remain, which leaves little room for accidents."""


TRUST = TrustOptions()
MIN_PROBABILITY = 0.95
"""Least probability of a match that is trusted by a model of the image, of two views, or of point sets. On seeds from
1000 of benchmarks/together.py, 0.9 trusted 5 wrong matches of 480 controllers with 4 and 5 LEDs, and 0.95 none."""


class Status(Enum):
    """Whether a match can be trusted; `rootmatch.Match.advice` says what to do about it.

    `decide` derives it. UNTRUSTED: the object may not be there, or no pose fits the assignment. AMBIGUOUS: the object
    is there, but its pose is not certain: no pose has the probability `min_probability` or, if none is known, the
    margin is below 0.2. MATCHED otherwise.
    """

    MATCHED = "matched"
    AMBIGUOUS = "ambiguous"
    UNTRUSTED = "untrusted"

    def __bool__(self) -> bool:
        """Only MATCHED is true."""
        return self is Status.MATCHED

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, kw_only=True)
class Facts:
    """The facts from which the status of an assignment is decided. A default speaks neither for it nor against it."""

    support: float = math.inf
    """Score of the hyper-edges that agree with it; infinite if its pose is beyond clutter by itself."""
    false_alarms: float = -math.inf
    """Decimal logarithm of the expected number of false alarms that are as good; infinite if no pose fits it."""
    lead: float | None = None
    """Lead in score over the best different assignment, 0 to 1, where known; it decides if no probability is known."""
    probability: float | None = None
    """Posterior probability of the assignment, given that one of those considered is right."""
    present: float | None = None
    """Posterior probability that the object is there, if a model of all observations gives one."""
    min_probability: float = MIN_PROBABILITY
    """Least probability of a match that is trusted."""
    missed: float = 0.0
    """Probability of a pose that explains as much and was never met; 1 of so few matches that no search meets all."""
    confirmed: bool = True
    """False for an assignment about a predicted pose that is not beyond chance."""
    contested: bool = False
    """Whether another body that explains its detections as well, or another followed pose, may be the right one."""
    incomplete: bool = False
    """Whether a motion that was asked for was not found, and may be in view."""
    sure_of_the_rest: bool = False
    """Whether its pose is certain and its doubtful matches were left out."""

    @property
    def status(self) -> Status:
        """The status that follows."""
        return decide(self)


def decide(facts: Facts) -> Status:
    """The status of an assignment: could it be a false alarm, and is it the only good one."""
    if facts.present is not None and facts.present < facts.min_probability:
        return Status.UNTRUSTED
    if not facts.confirmed or facts.support <= 0.0 or facts.false_alarms > TRUST.false_alarms:
        return Status.UNTRUSTED
    if facts.contested or facts.incomplete:
        return Status.AMBIGUOUS
    if facts.sure_of_the_rest:
        return Status.MATCHED
    likely = facts.lead is None or facts.lead >= TRUST.margin
    if facts.probability is not None:
        likely = facts.probability >= facts.min_probability
    return Status.MATCHED if likely and facts.missed <= TRUST.missed else Status.AMBIGUOUS


def least_trusted(statuses: Iterable[Status]) -> Status:
    """The status of a whole: that of its least trusted part."""
    return max(statuses, key=list(Status).index)
