"""Searches by pairs where the vertical is vague: an error of it turns what two points predict about them.

The farther from the pair, the more. A wide object then shows better where the vertical is than it was measured, and few
of its pairs predict the rest.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rootmatch.samplers.base import SamplingTask

VAGUE = 0.5
"""Noise of a vertical times the width of the detections, over the noise of one, from which triples are searched first,
and pairs only if nothing is beyond chance. With .6 half of all right pairs of a railway's masts are, with 1.7 a tenth,
and with 5.8 none (masts 50 m apart, seeds from 1000). A round value."""


def task_by_triples(task: SamplingTask) -> SamplingTask | None:
    """The task for a search by triples, if one by pairs may miss an object as wide as all detections; else None."""
    if task.without_vertical is None or task.motions != 1:
        return None
    rays = task.tables.rays
    width2 = float(((rays - rays.mean(axis=1, keepdims=True)) ** 2).sum(axis=0).mean())
    if float(task.tables.tilt_variance[0]) * width2 <= VAGUE**2 * float(np.median(task.tables.variance)):
        return None
    return replace(task, tables=task.without_vertical(), order=task.order + 1)
