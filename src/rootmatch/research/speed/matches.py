"""Whole matches: time, accuracy and number of evaluations."""

from __future__ import annotations

import statistics
from functools import partial
from typing import Any

from rootmatch.api import match
from rootmatch.matcher import Matcher
from rootmatch.research.speed.scenes import NOISE, make_scene
from rootmatch.research.speed.timing import seconds

FRAMES = 9
"""Frames of a tracked scene, after the first ones."""


def measure_matches(problem: str, points: int, outliers: int, seeds: range) -> dict[str, Any]:
    """Median time and evaluations and mean accuracy over scenes, after a warm-up scene."""
    spent, accuracy, evaluations = [], [], []
    for seed in (seeds[0], *seeds):
        scene = make_scene(problem, points, outliers, seed)
        result = match(scene.source, scene.target, scene.problem, noise=NOISE, seed=seed)
        spent.append(result.seconds)
        accuracy.append(scene.accuracy(result.assignment))
        evaluations.append(result.evaluated)
    return _row(f"{problem} {points} + {outliers}", spent[1:], accuracy[1:], evaluations[1:])


def measure_tracked(problem: str, points: int, outliers: int, seeds: range) -> dict[str, Any]:
    """Time of the median frame of a `Matcher`, with its accuracy."""
    spent, accuracy, evaluations = [], [], []
    for seed in seeds:
        scene = make_scene(problem, points, outliers, seed)
        matcher = Matcher(scene.source, scene.problem, noise=NOISE, seed=seed)
        result = matcher.match(scene.target)
        spent.append(seconds(partial(matcher.match, scene.target), FRAMES))
        accuracy.append(scene.accuracy(result.assignment))
        evaluations.append(result.evaluated)
    return _row(f"{problem} {points} + {outliers}, tracked", spent, accuracy, evaluations)


def _row(case: str, spent: list[float], accuracy: list[float], evaluations: list[int]) -> dict[str, Any]:
    return {
        "case": case, "scenes": len(spent), "milliseconds": 1e3 * statistics.median(spent),
        "accuracy": statistics.fmean(accuracy), "evaluations": statistics.median(evaluations),
    }  # fmt: skip
