"""One mistake that people make about an input."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from rootmatch.explain.task import MatchingTask
from rootmatch.problems.points import PointSets

Change = Callable[[MatchingTask], MatchingTask]
"""Corrects a task, by its deadline."""
METRES = {"metres": 1.0, "feet": 0.3048, "inches": 0.0254, "centimetres": 1e-2, "millimetres": 1e-3}
"""Units of length, the largest first."""


def ratio_of_units(one: str, other: str) -> float:
    """How many times a unit of length is as large as another one."""
    return METRES[one] / METRES[other]


def make_change(**changes: Any) -> Change:
    """Other values of some attributes of a task, which is then tried without what is known of the pose."""
    return lambda task: replace(task.without_priors(), **changes)


def scale_noise(points: PointSets, source: float, target: float) -> PointSets:
    """Points whose noise is so many times as large, that of each set."""
    covariances = [
        None if known is None else factor**2 * known
        for known, factor in ((points.source_covariance, source), (points.target_covariance, target))
    ]
    of_model = points.target_noise**2 - points.detection_noise**2  # which no noise of detections enlarges
    return replace(
        points,
        source_noise=source * points.source_noise,
        target_noise=np.sqrt((target * points.detection_noise) ** 2 + of_model),
        noise_alone=None if points.noise_alone is None else target * points.noise_alone,
        source_covariance=covariances[0],
        target_covariance=covariances[1],
    )


def each_body(task: MatchingTask) -> list[MatchingTask]:
    """The tasks of single bodies among all detections."""
    return [task] if task.bodies is None else [task.body(number) for number in range(len(task.bodies.names))]


class Mistake(NamedTuple):
    """What may be wrong, what to do about it, and how a task is corrected."""

    name: str
    remedy: str
    change: Change
    if_nothing_fits: bool = False
    """Whether it is tried only if no mistake before it explains the points: two at once, or the same in another way."""
    complete: Callable[[Mistake, Any], Mistake] | None = None
    """Adds to the name what the trusted match of the corrected task found, such as a scale."""
    fitted: int = 0
    """Number of values that the change fitted to the points, which is no prediction of them."""
    rivals: tuple[Change, ...] = ()
    """Changes of the same size that mean nothing: what fits as well with one of them tells of no mistake."""
