"""Options of posteriors: priors of whole hypotheses, and how far their neighbourhoods are searched."""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.options import Options, option

COUNTS = 3.0
"""Log-odds against a copy of the body at which its place still counts: with a twentieth, a probability changes by half
of that."""


@dataclass(frozen=True)
class PosteriorOptions(Options):
    """Priors of whole hypotheses, and how far their neighbourhoods are searched."""

    present: float = option(0.8, above=0.0, most=1.0)
    """Prior probability that the image shows the body, given that somebody asks for it."""
    copy: float = option(1e-3, above=0.0, most=1.0)
    """Prior odds that the image shows another copy of the body, which nobody named. A stated value, not measured."""
    wrong_model: float = option(1e-3, least=0.0, most=1.0)
    """Probability that the model does not hold at all (another body, a wrong calibration): no result is more certain
    than that. A stated floor, not measured."""
    grown: int = option(6, least=0)
    """Number of modes that grow by their best changes and whose changes are summed. A round value."""
    rounds: int = option(6, least=0)
    """Largest number of changes by which a mode grows. A round value."""
    weighed: int = option(32, least=1)
    """Number of changes of a mode that are weighed with the pose they lead to; the others count to first order. A round
    value."""
    independent: int = option(9, least=1)
    """Number of matches from which changes of different points hardly move the pose and are therefore independent; with
    fewer, only single changes are summed. A round value: two minimal sets more than one."""
    negligible: float = option(9.0, above=0.0)
    """Log-odds against a change or a mode at which it is left out: e⁻⁹ is a tenth of `wrong_model`."""
    hopeless: float = option(30.0, above=0.0)
    """Log-odds against a proposal at which it is not fitted, to first order about its given pose, and at which what a
    prediction or another body's pose proposes does not grow, against clutter alone: of 181 such modes two grew to be
    more probable than clutter, by .2 (benchmarks/flights.py, rooms and rigs, 3 flights each from 1100). A round
    value."""
    same_pose: float = option(2.0, above=0.0)
    """Difference in standard deviations up to which two poses count as one. With 5, the two poses of a board that faces
    the camera were one, and a tracker kept to the wrong one; 1 finds the same as 2.5 (benchmarks/flights.py, board).
    """


DEFAULT_POSTERIOR = PosteriorOptions()
