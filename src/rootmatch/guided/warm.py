"""The kernel that weighs proposals, compiled ahead of need: see `rootmatch.solvers.warm`."""

from __future__ import annotations

import numpy as np

from rootmatch.guided.search import CANDIDATE2, SEEN
from rootmatch.kernels.weigh import weigh
from rootmatch.simulation import p3p_scene, up2p_scene

SCENES = {"p3p": p3p_scene, "up2p": up2p_scene}


def warm(problem: str) -> None:
    """Compile it for the problem of this name, by one proposal; nothing where there are no proposals."""
    if problem not in SCENES:
        return
    scene = SCENES[problem](6, 2, 1.0, 0)
    tables = scene.problem.prepare(scene.source, scene.target, scene.noise)
    points = np.arange(scene.problem.order - 1)[None]
    images = np.append(0, scene.truth[points[0]])[None]
    weigh(tables, points, images, 1.0, CANDIDATE2, np.empty((0, 0), np.bool_), np.array(SEEN))
