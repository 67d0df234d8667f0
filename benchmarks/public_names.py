"""Public names that were renamed, so that one script calls and reads revisions from before and after.

Write the new names; `options` and `read` fall back to the old ones where this package does not know the new ones yet.
Angles are given in degrees here and handed on in the unit that this package takes.
"""

from __future__ import annotations

import inspect
import math
from functools import cache
from typing import Any

import numpy as np

import rootmatch as rm

OPTIONS = {
    "sampler": "hyperedges",
    "max_evaluations": "limit",
    "detection_rate": "detection",
}
ATTRIBUTES = {
    "evaluated": "hyperedges",
    "stopped_early": "limited",
    "motion_labels": "motions",
    "soft_assignment": "soft",
    "dof": "freedom",
    "update": "match",
}
ABSENT = "absent"


@cache
def known_options() -> frozenset[str]:
    """Names of the arguments of `rootmatch.match`."""
    return frozenset(inspect.signature(rm.match).parameters)


@cache
def takes_radians() -> bool:
    """Whether angles are radians, of which 90 are too many."""
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 0.5]])
    try:
        rm.Matcher(points, rm.P3P(rm.Camera(1.0, 1.0, 0.0, 0.0)), normals=np.ones((5, 3)), view_angle=90.0)
    except rm.InputError:
        return True
    return False


def options(**given: Any) -> dict[str, Any]:
    """Arguments under the names that this package knows; ``view_angle`` in degrees."""
    if "source_noise" in given and "source_noise" not in known_options():
        given["noise"] = (given.pop("source_noise"), given["noise"])
    if "view_angle" in given and takes_radians():
        given["view_angle"] = np.asarray(given["view_angle"]) * (math.pi / 180.0)
    return {name if name in known_options() else OPTIONS.get(name, name): value for name, value in given.items()}


def read(owner: Any, name: str, default: Any = ABSENT) -> Any:
    """An attribute under its new name or its old one; the default if it has neither."""
    found = getattr(owner, name, ABSENT)
    if found is ABSENT and name in ATTRIBUTES:
        found = getattr(owner, ATTRIBUTES[name], ABSENT)
    return default if found is ABSENT else found
