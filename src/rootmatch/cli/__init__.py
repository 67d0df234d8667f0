"""The command line tool ``rootmatch``.

Each command is one function in a file of its own, named in `rootmatch.cli.app.COMMANDS`.
"""

from __future__ import annotations

from rootmatch.cli.app import app, main

__all__ = ["app", "main"]
