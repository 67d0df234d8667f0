"""Searches by pairs where the vertical is vague: an error of it turns what two points predict about them.

The farther from the pair, the more. A wide object then shows better where the vertical is than it was measured, and few
of its pairs predict the rest.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rootmatch.samplers.base import SamplingTask
from rootmatch.samplers.guided.search import Search

VAGUE = 1.5
"""Noise of a vertical times the width of an object in the image, over the noise of a detection, from which triples are
searched as well. With 1.2 half of all right pairs of a railway's masts are beyond chance, with 3.7 a tenth, and with 12
none (masts 50 m apart, seeds from 1000). A round value."""


def triples_for(task: SamplingTask, search: Search) -> SamplingTask | None:
    """The task for a search by triples, if one by pairs may have missed an object as wide as what it found.

    Where that is not beyond chance, as wide as all detections.
    """
    if task.without_vertical is None or not search.single:
        return None
    tables, own = search.tables, np.arange(search.n_target)
    if search.is_beyond_chance():
        best = search._clustered()[2].best[0]
        own = best[best >= 0]
    rays = tables.rays[:, own]
    width2 = float(((rays - rays.mean(axis=1, keepdims=True)) ** 2).sum(axis=0).mean())
    if float(tables.tilt_variance[0]) * width2 <= VAGUE**2 * float(np.median(tables.variance[own])):
        return None
    return replace(task, tables=task.without_vertical(), order=task.order + 1)
