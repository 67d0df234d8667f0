"""The exceptions of rootmatch."""

from __future__ import annotations

from reprlib import Repr


class RootmatchError(Exception):
    """Base class of every error that rootmatch raises deliberately."""


class InputError(RootmatchError, ValueError):
    """Unusable input: the text says what was given, what was expected and what to do."""


class UnseenPixelError(InputError):
    """Pixels where the lens model shows nothing: a fault of one frame, not of the camera or the options."""


class InputWarning(UserWarning):
    """Input that can be used and is probably not what was meant: the text says why, and what to do."""


MAX_QUOTED = 60
"""Characters of a value that an error quotes."""


MAX_LISTED = 8
"""Entries of a list or mapping that it quotes; of longer ones it says how many they are."""

BRIEF = Repr()
"""Notation of a value that stays short however large the value is: lists within lists may stand for gigabytes."""
BRIEF.maxlevel = 3
BRIEF.maxlist = BRIEF.maxtuple = BRIEF.maxdict = BRIEF.maxset = BRIEF.maxfrozenset = MAX_LISTED
BRIEF.maxstring = BRIEF.maxother = BRIEF.maxlong = 10 * MAX_QUOTED


def escape_unprintable(text: str) -> str:
    """A text with every character that a terminal may obey as its escape, in the notation of Python."""
    if text.isprintable():
        return text
    return "".join(sign if sign.isprintable() else ascii(sign)[1:-1] for sign in text)


def quote_value(value: object) -> str:
    """A value as an error may quote it: one short line that no terminal obeys."""
    if isinstance(value, list | dict) and len(value) > MAX_LISTED:
        return f"a {'list' if isinstance(value, list) else 'mapping'} of {len(value)}"
    try:
        text = escape_unprintable(" ".join(BRIEF.repr(value).split()))
    except (ValueError, RecursionError):
        return "a number of thousands of digits" if isinstance(value, int) else f"a {type(value).__name__}"
    return text if len(text) <= MAX_QUOTED else f"{text[: MAX_QUOTED - 3]}..."
