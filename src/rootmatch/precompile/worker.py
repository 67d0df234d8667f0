"""A process that compiles: ``python -m rootmatch.precompile.worker SET [FOLDER]`` runs the steps named on its input.

It answers each with a line. With a folder, kernels for a generic processor are left there, else those for this machine
in the user's cache.
"""

from __future__ import annotations

import sys
from pathlib import Path

from rootmatch.jit import cache
from rootmatch.precompile.steps import STEPS


def work(chosen: str, folder: str | None = None) -> None:
    """Run the steps of a set as they are named."""
    cache.Settings.into = Path(folder) if folder else None
    cache.Settings.native = not folder
    steps = STEPS[chosen]()
    for line in sys.stdin:
        steps[line.strip()]()
        print("done", flush=True)


if __name__ == "__main__":
    work(*sys.argv[1:])
