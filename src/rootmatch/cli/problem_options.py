"""The geometric problem of a command, built from its name, its options and a camera file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Any, Literal

from rootmatch.cli.error_messages import rename_to_options
from rootmatch.errors import InputError
from rootmatch.problems import PROBLEMS, problem_class

if TYPE_CHECKING:
    from rootmatch.problems.base import Problem

    ProblemName = str
else:
    ProblemName = Literal[tuple(PROBLEMS)]

Option = str | float | int | None
OF_PROBLEM = (
    "camera", "vertical_camera", "vertical_world", "vertical_noise", "camera2", "axis", "axis2", "axis_noise", "centre",
    "dimension",
)  # fmt: skip
"""Options that only some problems have."""


def build_problem(name: str, given: Mapping[str, Any]) -> Problem:
    """The problem of that name, a key of `rootmatch.problems.PROBLEMS`.

    Those of a command's arguments that are `OF_PROBLEM` set the field of the same name, as text or number; what is left
    out, None, comes from the camera file, else from the defaults.
    """
    from rootmatch.io import Calibration, parse_camera

    options: dict[str, Option] = {option: given[option] for option in OF_PROBLEM if option in given}
    problem = problem_class(name)
    known = {field.name: field for field in fields(problem) if field.init}
    for option, value in options.items():
        if value is not None and option not in known:
            having = (other for other in PROBLEMS if option in {field.name for field in fields(problem_class(other))})
            owners = " or ".join(having)
            raise InputError(f"{flag(option)}: it applies to --problem {owners}, not to {name}; leave it out")
    calibration: Calibration | None = None
    if options.get("camera") is not None:
        calibration = parse_camera(str(options.get("camera")), "--camera")
    settings: dict[str, Any] = {}
    for option, field in known.items():
        text = options.get(option)
        setting = getattr(calibration, option, None)
        if text is not None and option != "camera":
            setting = _setting(option, text)
        if setting is not None:
            settings[option] = tuple(setting.tolist()) if hasattr(setting, "tolist") else setting  # hashable
        elif field.default is MISSING:
            raise InputError(f"{flag(option)}: missing; --problem {name} needs it")
    with rename_to_options({option: flag(option) for option in known}):
        built: Problem = problem(**settings)
    return built


def angle(option: str, degrees: float, maximum: float) -> float:
    """An angle of the command line, in degrees, in radians."""
    if not 0.0 <= degrees <= maximum:
        raise InputError(f"{flag(option)}: {degrees:g} given; give degrees from 0 to {maximum:g}")
    return math.radians(degrees)


def _setting(option: str, text: str | float | int) -> Any:
    """The parsed value of an option that only some problems have."""
    from rootmatch.io import parse_camera
    from rootmatch.io.camera_files import parse_direction, parse_numbers

    if isinstance(text, int):
        return text
    if isinstance(text, float):
        return angle(option, text, 45.0)
    if option == "camera2":
        return parse_camera(text, flag(option)).camera
    if option == "centre":
        return tuple(parse_numbers(text, 2, flag(option), "320,240"))
    return parse_direction(text, flag(option))


def flag(name: str) -> str:
    """The command-line option of a keyword argument: ``max_hyperedges`` is ``--max-hyperedges``."""
    return f"--{name.replace('_', '-')}"
