"""The errors that rootmatch raises on purpose."""

from __future__ import annotations


class RootmatchError(Exception):
    """Base of every error that rootmatch raises on purpose."""


class InputError(RootmatchError, ValueError):
    """The input cannot be used: the text says what was given, what was expected and what to do."""
