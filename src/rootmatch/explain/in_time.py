"""The moments after `max_seconds`: when a match has to be told, and what may still be done by then.

A search ends at its deadline, see `rootmatch.deadline`. What was found is told by what is known then: it is weighed and
doubted until the last moment, and what could not be asked by then is a doubt. So telling never fails, and is done in
one place for every route: `in_time`.
"""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar

from rootmatch.deadline import Deadline, OutOfTime, active_deadline
from rootmatch.explain.body_findings import find_no_body
from rootmatch.explain.finding import Finding
from rootmatch.explain.task import MatchingTask

PREDICTED, TOLD = (0.02, 0.0005), (0.06, 0.003)
"""Shares of the time allowed, and seconds, that a prediction may take beyond it, which is better than nothing, and by
which all is weighed and doubted. Parts of the tenth and 5 ms by which a match may be late; the rest is for a tracker's
belief. Round values."""
TOO_LATE = "`max_seconds` ran out before anything was found; give more time"

_last: ContextVar[Deadline | None] = ContextVar("_last", default=None)


def explain_in_time(task: MatchingTask, found: Callable[[MatchingTask], Finding]) -> Finding:
    """What a route finds of a task by its deadline; of every body nothing, if there was no time for anything."""
    token = _last.set(task.deadline.later(*TOLD))
    try:
        with task.deadline.with_grace().enforce():
            return found(task)
    except OutOfTime:
        return find_no_body(task, TOO_LATE)
    finally:
        _last.reset(token)


def final_deadline() -> Deadline:
    """The deadline by which a match is told, of whatever part of its work runs; outside of a match that in force."""
    return _last.get() or active_deadline()


def prediction_deadline(deadline: Deadline) -> Deadline:
    """The deadline of what is assigned about predictions."""
    return deadline.later(*PREDICTED)
