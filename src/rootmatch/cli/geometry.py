"""The geometric problem of a command: from its name, options and a camera file."""

from __future__ import annotations

import math
from dataclasses import MISSING, fields
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from rootmatch.errors import InputError
from rootmatch.problems import PROBLEMS, problem_class

if TYPE_CHECKING:
    from rootmatch.problems.base import Problem

    ProblemName = StrEnum
else:
    ProblemName = StrEnum("ProblemName", {name: name for name in PROBLEMS})

Given = str | float | int | None


def posed_problem(name: str, given: dict[str, Given]) -> Problem:
    """The problem of that name; what is not given is taken from the camera file, else left at its default.

    Parameters
    ----------
    name : str
        A key of `rootmatch.problems.PROBLEMS`.
    given : dict
        Of the options that not every problem has, as text or number; None where one is not given. An option sets the
        field of its name.
    """
    from rootmatch.io import Calibration, parse_camera

    problem = problem_class(name)
    known = {field.name: field for field in fields(problem) if field.init}
    for option, asked in given.items():
        if asked is not None and option not in known:
            owners = " or ".join(_owners(option))
            raise InputError(f"{flag(option)}: it belongs to --problem {owners}, not to {name}; leave it out")
    calibration: Calibration | None = None
    if given["camera"] is not None:
        calibration = parse_camera(str(given["camera"]), "--camera")
    settings: dict[str, Any] = {}
    for option, field in known.items():
        asked = given.get(option)
        value = getattr(calibration, option, None)
        if asked is not None and option != "camera":
            value = _setting(option, asked)
        if value is not None:
            settings[option] = tuple(value.tolist()) if hasattr(value, "tolist") else value  # problems stay hashable
        elif field.default is MISSING:
            raise InputError(f"{flag(option)}: missing; --problem {name} needs it")
    posed: Problem = problem(**settings)
    return posed


def _owners(option: str) -> list[str]:
    """The problems that have an option."""
    return [name for name in PROBLEMS if option in {field.name for field in fields(problem_class(name))}]


def _setting(option: str, asked: str | float | int) -> Any:
    """The value of an option that not every problem has."""
    from rootmatch.io import parse_camera, parse_direction, parse_numbers

    if isinstance(asked, int):
        return asked
    if isinstance(asked, float):
        if not 0.0 <= asked <= 45.0:
            raise InputError(f"{flag(option)}: {asked:g} given; give degrees from 0 to 45")
        return math.radians(asked)
    if option == "camera2":
        return parse_camera(asked, flag(option)).camera
    if option == "centre":
        return tuple(parse_numbers(asked, 2, flag(option), "320,240"))
    return parse_direction(asked, flag(option))


def flag(name: str) -> str:
    """The option of an argument's name."""
    return f"--{name.replace('_', '-')}"
