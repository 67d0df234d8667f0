"""Geometric problems, one folder each, and the one list of those that the package exports."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from rootmatch.errors import InputError

PROBLEMS = {
    "p3p": "p3p:P3P",
    "up2p": "up2p:UP2P",
    "3p1": "three_plus_one:ThreePlusOne",
    "planar": "planar_motion:PlanarMotion",
    "up2pf": "up2pf:UP2PF",
    "similarity": "similarity:Similarity",
    "rigid": "similarity:Rigid",
}
"""Short name of each problem, as on the command line, with its folder and its class: a line for each, and a class is
exported as ``rootmatch.<class>``. Nothing is imported before it is asked for."""

MODULES = {name: f"problems.{folder}" for folder, name in (place.split(":") for place in PROBLEMS.values())}
"""Module of each exported class."""


def problem_class(name: str) -> Any:
    """Class of the problem with that short name."""
    if name not in PROBLEMS:
        raise InputError(f"problem: {name!r} given; one of {', '.join(PROBLEMS)} expected")
    folder, attribute = PROBLEMS[name].split(":")
    return getattr(import_module(f"{__name__}.{folder}"), attribute)
