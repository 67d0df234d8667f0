"""The geometric problem of a command: from options and a camera file."""

from __future__ import annotations

import math
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from rootmatch.errors import InputError

if TYPE_CHECKING:
    from rootmatch.io import Calibration
    from rootmatch.problems.base import Problem


class ProblemName(StrEnum):
    """The problems by their short names."""

    P3P = "p3p"
    UP2P = "up2p"
    THREE_PLUS_ONE = "3p1"


OWN_OPTIONS = {
    ProblemName.P3P: (),
    ProblemName.UP2P: ("vertical_camera", "vertical_world", "vertical_noise"),
    ProblemName.THREE_PLUS_ONE: ("camera2", "axis", "axis2", "axis_noise"),
}
"""Options that only one problem has a use for."""


def posed_problem(name: ProblemName, camera: str, given: dict[str, str | float | None]) -> Problem:
    """The problem of the options; what is not given is taken from the camera file, else left at its default."""
    from rootmatch.io import parse_camera

    for option, asked in given.items():
        if asked is not None and option not in OWN_OPTIONS[name]:
            owner = next(one for one, options in OWN_OPTIONS.items() if option in options)
            raise InputError(f"{flag(option)}: it belongs to --problem {owner}, not to {name}; leave it out")
    calibration: Calibration = parse_camera(camera, "--camera")
    settings: dict[str, Any] = {}
    for option in OWN_OPTIONS[name]:
        asked = given[option]
        value = getattr(calibration, option, None) if asked is None else _setting(option, asked)
        if value is not None:
            settings[option] = tuple(value.tolist()) if hasattr(value, "tolist") else value  # problems stay hashable
    if name is ProblemName.P3P:
        from rootmatch.problems.p3p.problem import P3P

        return P3P(calibration.camera)
    if name is ProblemName.UP2P:
        from rootmatch.problems.up2p.problem import UP2P

        return UP2P(calibration.camera, **settings)
    from rootmatch.problems.three_plus_one.problem import ThreePlusOne

    return ThreePlusOne(calibration.camera, **settings)


def _setting(option: str, asked: str | float) -> Any:
    """The value of an option that only one problem has."""
    from rootmatch.io import parse_camera, parse_direction

    if isinstance(asked, float):
        if not 0.0 <= asked <= 45.0:
            raise InputError(f"{flag(option)}: {asked:g} given; give degrees from 0 to 45")
        return math.radians(asked)
    return parse_camera(asked, flag(option)).camera if option == "camera2" else parse_direction(asked, flag(option))


def flag(name: str) -> str:
    """The option of an argument's name."""
    return f"--{name.replace('_', '-')}"
