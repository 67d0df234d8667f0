"""What ``rootmatch track`` says of all frames together: why some are not matched, and what they contradict.

The poses of frames are rows of numbers, in which no sentence has a place.
"""

from __future__ import annotations

import re
import select
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING

from rootmatch.cli.frame_outputs import brief_advice, count_statuses

if TYPE_CHECKING:
    from rootmatch.result import Match

FIRST_FRAMES = 50
"""Frames whose steps are looked at. Not tuned."""
LATE = 1.0
"""Seconds by which answers come later than the first ones from which it is said that frames wait. A round value."""
WAITING = 20
"""Frames in a row that were there before the one before was answered, which say so. A round value."""
_NUMBERS = re.compile(r"\d+(\.\d+)?(e[-+]?\d+)?")


class TrackSummary:
    """All frames: statuses, reasons of those that are not matched, matches that contradict what is known, and times.

    ``rate``: frames a second, where no times are given.
    """

    def __init__(self, rate: float) -> None:
        self.statuses: Counter[str] = Counter()
        self.skipped = 0
        self._rate, self._timed = rate, False
        self._reasons: Counter[str] = Counter()
        self._examples: dict[str, str] = {}
        self._known = self._contradicted = 0
        self._times: list[float] = []

    def take(self, match: Match, statuses: Sequence[str], time: float, *, timed: bool, known: bool) -> None:
        """Count a frame; ``timed``: whether its time was given, ``known``: whether something of its poses was."""
        self.statuses.update(statuses)
        self._timed = timed
        if len(self._times) < FIRST_FRAMES:
            self._times.append(time)
        for one in [match] if match.bodies is None else match.bodies.values():
            if not one:
                advice = brief_advice(one)
                kind = _NUMBERS.sub("#", advice)
                self._reasons[kind] += 1
                self._examples.setdefault(kind, advice)
            elif known and one.prior_holds is not None:
                self._known += 1
                self._contradicted += not one.prior_holds

    def lines(self) -> Iterator[str]:
        """What to say at the end."""
        if 2 * self._contradicted > self._known:
            yield (
                f"warning: {self._contradicted} of {self._known} matches contradict what is known of their pose, "
                "which was ignored; check its directions, frames and σ"
            )
        if self._reasons:
            kind, count = self._reasons.most_common(1)[0]
            total = self._reasons.total()
            share = f"{count} of the {total}" if count < total else f"the {total}"
            of = f"{share} that are not matched"
            of = "the one that is not matched" if total == 1 else of
            yield f"{of}: {self._examples[kind]}"
        yield from self._slow_frames()
        yield f"{count_statuses(self.statuses)}{f', {self.skipped} left out' if self.skipped else ''}"

    def _slow_frames(self) -> Iterator[str]:
        """A warning if frames are seconds apart: their numbers, or times, probably have a smaller unit."""
        from rootmatch.tracking.search_schedule import SLOW, probable_unit

        if len(self._times) < 2:
            return
        step = median(after - before for before, after in pairwise(self._times))
        if step > SLOW:
            unit, divisor = probable_unit(step)
            what, at = f"time is in seconds; if it is in {unit}, divide it by {divisor}", ""
            if not self._timed:
                what = "if frame is a time in milliseconds, give --rate 1000"
                at = f" at --rate {self._rate:g}"
            yield f"warning: the frames are {step:.3g} s apart{at}; {what}"


class Queue:
    """Whether frames of standard input wait for the answers to those before, longer and longer."""

    def __init__(self) -> None:
        self._clock = time.monotonic
        self._minimum = float("inf")
        self._waiting = 0
        self._took: list[float] = []
        self._told = False

    def take(self, when: float, seconds: float) -> str | None:
        """Count a frame of a time, answered now after some work; a warning the first time that frames pile up."""
        late = self._clock() - when
        self._minimum = min(self._minimum, late)
        self._waiting = self._waiting + 1 if _is_ready() else 0
        self._took = [*self._took[1 - WAITING :], seconds]
        if self._told or self._waiting < WAITING or late - self._minimum < LATE:
            return None
        self._told = True
        return (
            f"warning: frames arrive faster than they are processed ({1e3 * median(self._took):.0f} ms each), and "
            f"the output is {late - self._minimum:.1f} s late by now; limit each frame with --max-seconds, or say how "
            "fast the body or the camera moves (--velocity, --acceleration)"
        )


def _is_ready() -> bool:
    """Whether standard input has more to read at once."""
    try:
        return bool(select.select([sys.stdin], [], [], 0.0)[0])
    except (OSError, ValueError, TypeError):  # no pipe, or a system that asks sockets alone
        return False
