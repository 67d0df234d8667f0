"""Exit codes of the command line, a public contract; 0 is success."""

from __future__ import annotations

NOT_TRUSTED = 1
"""No trustworthy match, or an ambiguous one."""
BAD_INPUT = 2
INTERRUPTED = 130
"""Ctrl-C, as shells report it."""
