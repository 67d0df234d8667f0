"""The status of a match: its thresholds, what it advises, and the one rule by which it follows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from rootmatch.problems.base import Problem


@dataclass(frozen=True)
class TrustOptions:
    """Thresholds of the status. Set on the development scenes of docs/comparison.md (`benchmarks/accuracy.py`).

    Parameters
    ----------
    probability : float
        Least probability of a matched assignment: of those above, 99 in 100 are right (`benchmarks/reliability.py`).
    margin : float
        Least lead in score of a matched assignment where no probability is known.
    false_alarms, false_alarms_of_part : float
        Decimal logarithm of the expected number of false alarms up to which an assignment is trusted, and of one that
        leaves out points of an object and whose rivals no pose has weighed: one in a thousand, which is the goal for 8
        to 20 unrelated points. With that for all, 18 instead of 6 of 100 right matches of six LEDs without clutter
        would not be trusted (`benchmarks/constellations.py`, seeds below 250), and of the headset with a fifth of its
        sensors undetected 22 instead of 11.
    beyond_clutter, beyond_clutter_of_views : float
        Logarithm of the odds against clutter alone from which an assignment is trusted whatever its score, for an
        object in an image and for two views, …  For an object they are odds against clutter that crowds as the
        detections do: on the development seeds of `benchmarks/constellations.py` they never exceeded −3 where nothing
        was to be found (300 scenes of unrelated points, 40 of the headset against a stretched copy of itself).
    beyond_clutter_of_rivals : float
        … from which several poses of an object are called ambiguous rather than chance, where none of them is sure: of
        the odds of all of them together. With `present` seven in eight are right by that.
    present : float
        Log-odds, before anything is seen, that the object is in view, or that two views show the same: they enter the
        confidence of what is not trusted, not the status. On development seeds (`benchmarks/constellations.py`,
        `benchmarks/accuracy.py`) 9 of 10 matches of untrusted assignments were right whose odds against chance were
        even, and odds above −6 never came of unrelated points.
    listed, listed_probability : int, float
        … if the right one is among it and so many alternatives, or the pose is right, with that probability.
    wrong : float
        Fraction of its matches that may be expected to be wrong in a matched assignment of many points. A round value.
    missed : float
        Probability of having missed another pose that explains as much, beyond which an assignment is ambiguous: the
        search was cut short before it looked for one. A round value; searches that end by themselves are below 0.05.
    kept : float
        Least fraction of its matches that is left where those that are not sure are left out of an assignment, to
        call it matched; else it is ambiguous. A round value.
    noise_factor, noise_chance : float
        Factor on σ, as the residuals about the best pose ask for it, from which an assignment is not trusted if
        residuals as large as that are rarer than this chance where σ is right: it was stated too small, and points may
        be missing. Where σ was 1.5 times too small no match is wrong, where it was four times, some are.
    most_named : float
        Factor up to which the advice blames the noise rather than the match. A round value.
    alternatives : int
        Most alternatives that are kept.
    support : float
        Share of the median support below which a matched point is left unmatched: true ones seldom have less than 0.3,
        and those that meet clutter by accident seldom more than 0.2.
    last_support, last_pairs : float, int
        That share where at most so many pairs would remain, too few for an accident to select from.
    clear_margin, clear_support, clear_rival : float
        Lead in score, least support of a matched point and most support of any other match, both over the median
        support, with which an assignment is clear and its neighbours are not fitted: of 2050 such on the development
        seeds none was wrong.
    """

    probability: float = 0.9
    margin: float = 0.2
    false_alarms: float = -2.0
    false_alarms_of_part: float = -3.0
    beyond_clutter: float = 1.0
    beyond_clutter_of_views: float = math.log(100.0)
    beyond_clutter_of_rivals: float = -1.0
    present: float = 3.0
    listed: int = 5
    listed_probability: float = 0.95
    noise_factor: float = 1.9
    noise_chance: float = 1e-3
    most_named: float = 8.0
    kept: float = 0.9
    wrong: float = 0.01
    missed: float = 0.5
    alternatives: int = 16
    support: float = 0.25
    last_support: float = 0.1
    last_pairs: int = 4
    clear_margin: float = 0.5
    clear_support: float = 0.4
    clear_rival: float = 0.05


TRUST = TrustOptions()


class Status(Enum):
    """Whether to believe a match; `advice` says what to do in the words of its problem.

    One rule, see `judged`: UNTRUSTED where a false alarm could be as good, or no pose fits the assignment; else
    AMBIGUOUS where it is not sure: its probability below 0.9 or, where there is none, its margin below 0.2; else
    MATCHED. A `clear` assignment, with a margin of 0.5 and no other match supported, is judged by its margin and by the
    fit of its pose alone: of those all had a probability above 0.9 when that was measured, and fitting their
    neighbours would double the time of a small match.
    """

    MATCHED = "matched: the assignment is well supported and no other explains the points nearly as well"
    AMBIGUOUS = (
        "ambiguous: another assignment explains the points nearly as well; see `alternatives`, {to_tell}, "
        "or add points that break the symmetry"
    )
    UNTRUSTED = (
        "no trustworthy match: too few hyper-edges agree; check {to_check}, raise the noise, "
        "or evaluate more hyper-edges"
    )

    def __bool__(self) -> bool:
        """Only a match that can be believed is true."""
        return self is Status.MATCHED

    def __str__(self) -> str:
        return self.value.format(to_tell=Problem.to_tell, to_check=Problem.to_check)

    def advice(self, problem: Problem) -> str:
        """The text with what to check, and what to add, where this problem is solved."""
        return self.value.format(to_tell=problem.to_tell, to_check=problem.to_check)


def judged(
    score: float, alarms: float, lead: float, probability: float | None = None, most_alarms: float = TRUST.false_alarms
) -> Status:
    """The status of an assignment: could it be a false alarm, and is it the only good one.

    Parameters
    ----------
    score : float
    alarms : float
        Decimal logarithm of the expected number of false alarms.
    lead : float
        Lead in score over the best different assignment.
    probability : float, optional
        Of the assignment; it decides instead of the lead where it is known.
    most_alarms : float
        False alarms up to which it is trusted.
    """
    if score <= 0.0 or alarms > most_alarms:
        return Status.UNTRUSTED
    sure = lead >= TRUST.margin if probability is None else probability >= TRUST.probability
    return Status.MATCHED if sure else Status.AMBIGUOUS
