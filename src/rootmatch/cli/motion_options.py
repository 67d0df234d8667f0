"""Options of ``rootmatch track`` about motions and searches: degrees here, radians in Python."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

from rootmatch.cli import match_options as option
from rootmatch.cli.problem_options import flag
from rootmatch.errors import InputError

if TYPE_CHECKING:
    from rootmatch.tracking.tracker import TrackingOptions

motion = option.option_factory("Motion")

Velocity = Annotated[
    float | None,
    motion("Speed of the body on each axis, in radii of it a second; 0.3 for a map.", metavar="R/S", default="15"),
]
Acceleration = Annotated[
    float | None, motion("Acceleration on each axis, in radii/s²; 1 for a map.", metavar="R/S2", default="100")
]
AngularVelocity = Annotated[
    float | None, motion("Speed of turning about each axis, in degrees/s.", metavar="DEG/S", default="229")
]
AngularAcceleration = Annotated[
    float | None, motion("Acceleration of turning about each axis, in degrees/s².", metavar="DEG/S2", default="1719")
]
SearchBudget = Annotated[
    int | None,
    motion("Evaluations of a search at 60 frames/s; more for a body of many points.", metavar="N", default="30000"),
]
TURNING = "angular_velocity", "angular_acceleration"


def tracking_options(given: Mapping[str, Any]) -> TrackingOptions:
    """The options of `rootmatch.Tracker` that are given."""
    from rootmatch.tracking.motion_filter import MotionOptions
    from rootmatch.tracking.tracker import TrackingOptions

    moves = {name: given[name] for name in ("velocity", "acceleration", *TURNING) if given[name] is not None}
    for name, value in moves.items():
        if not 0.0 < value < math.inf:
            raise InputError(f"{flag(name)}: {value:g} given; give a number above 0")
    moves |= {name: math.radians(moves[name]) for name in TURNING if name in moves}
    budget = {} if given["search_budget"] is None else {"search_budget": given["search_budget"]}
    return TrackingOptions(motion=MotionOptions(**moves), **budget)
