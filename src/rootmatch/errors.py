"""The exceptions of rootmatch."""

from __future__ import annotations


class RootmatchError(Exception):
    """Base class of every error that rootmatch raises deliberately."""


class InputError(RootmatchError, ValueError):
    """Unusable input: the text says what was given, what was expected and what to do."""
