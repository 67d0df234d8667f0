"""The library's errors and warnings in command-line terms: files instead of arrays, options instead of arguments."""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rootmatch.errors import InputError, InputWarning


@contextmanager
def rename_to_options(subjects: Mapping[str, str]) -> Iterator[None]:
    """Rewrite the `InputError` of a block.

    ``subjects``: the user's name, a file or an option, of the argument that an error begins with (``"source: …"``).
    """
    try:
        yield
    except InputError as error:
        raise InputError(translate_to_options(str(error), subjects)) from None


def translate_to_options(text: str, subjects: Mapping[str, str]) -> str:
    """The error text with its subject renamed and every ``name=`` or ``name="value"`` as the option ``--name``."""
    text = re.sub(r'\b([a-z][a-z_0-9]*)="([^"]*)"', lambda found: f"--{_to_dashes(found[1])} {found[2]}", text)
    text = re.sub(r"\b([a-z][a-z_0-9]*)=(…|(?=\W|$))", lambda found: f"--{_to_dashes(found[1])}", text)
    for separator in (":", " is "):
        subject, found, rest = text.partition(separator)
        if found and subject in subjects:
            return f"{subjects[subject]}{separator}{rest}"
    return text


_OPTIONS = [
    "camera",
    "detection_rate",
    "known",
    "max_seconds",
    "min_probability",
    "motions",
    "noise",
    "normals",
    "prior",
    "resolution",
    "rho",
    "sampler",
    "search_budget",
    "solver",
    "source_noise",
    "vertical_noise",
    "view_angle",
]
"""Arguments of Python that the command line has as options."""
_CODE = re.compile(rf"`({'|'.join(_OPTIONS)})(=?)([^`]*)`")
_WORDS = {
    " in `TrackingOptions`": "",
    "`MotionOptions`": "`--velocity` and `--acceleration`",
    "`UP2P`": "`--problem up2p`",
    "`bodies=`": "a column `body`",
    "`diagnose`": "`rootmatch match --diagnose`",
}


def rephrase_advice(advice: str) -> str:
    """An advice, or a diagnosis, in terms of the command line: what it calls an argument is an option here."""
    for word, option in _WORDS.items():
        advice = advice.replace(word, option)
    return translate_to_options(_CODE.sub(_code_of_option, advice), {})


def _code_of_option(found: re.Match[str]) -> str:
    value = found[3].strip("()").replace(", ", ",")
    if value and not found[2]:
        return found[0]  # more than a name
    return f"`--{_to_dashes(found[1])}{' ' * bool(value)}{value}`"


def _to_dashes(name: str) -> str:
    return name.replace("_", "-")


@contextmanager
def print_brief_warnings() -> Iterator[None]:
    """Print each `InputWarning` of a block once, as the command line's own warnings, and others as Python does."""
    with warnings.catch_warnings():
        by_default = warnings.showwarning
        printed: set[str] = set()

        def show(message: Any, category: type[Warning], *where: Any, **told: Any) -> None:
            if not issubclass(category, InputWarning):
                by_default(message, category, *where, **told)
            elif str(message) not in printed:
                printed.add(str(message))
                print(f"rootmatch: warning: {message}", file=sys.stderr)

        warnings.showwarning = show
        warnings.simplefilter("always", InputWarning)
        warnings.filterwarnings("ignore", ".*degrees for radians", InputWarning)  # degrees are given here
        yield
