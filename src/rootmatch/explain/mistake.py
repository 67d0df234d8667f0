"""One mistake that people make about an input."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from rootmatch.explain.task import MatchingTask

Change = Callable[[], MatchingTask]
"""Makes the corrected task."""


class Mistake(NamedTuple):
    """What may be wrong, what to do about it, and the task without it."""

    name: str
    remedy: str
    change: Change
    if_nothing_fits: bool = False
    """Whether it is tried only if no mistake before it explains the points: two at once, or the same in another way."""
    scaled: bool = False
    """Whether the corrected task finds the scale, which is then part of the name."""
    rivals: tuple[Change, ...] = ()
    """Changes of the same size that mean nothing: what fits as well with one of them tells of no mistake."""
