"""Exit codes of the command line, a public contract; 0 is success."""

from __future__ import annotations

NOT_TRUSTED = 1
"""No trustworthy match, or an ambiguous one."""
BAD_INPUT = 2
"""Input cannot be used, or an output cannot be written."""
INTERRUPTED = 130
"""Ctrl-C, as shells report it."""
READER_GONE = 141
"""The reader of standard output left early, as ``| head -1`` does; shells report so of SIGPIPE."""
TERMINATED = 143
"""SIGTERM, as shells report it."""
