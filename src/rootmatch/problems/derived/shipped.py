"""Formulas that come with the package: generated once from equations, so that they need no SymPy.

``python -m rootmatch.problems.derived.shipped`` writes them anew from the equations in the problems' files.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from rootmatch.problems.derived.store import Generated, vetted

FOLDER = Path(__file__).parent / "formulas"


@cache
def shipped(name: str) -> Generated:
    """The formulas of that name, vetted like any generated text."""
    path = FOLDER / f"{name}.txt"
    return vetted(path.read_text(encoding="utf-8"), path.name)


def regenerate() -> None:
    """Write all shipped formulas from their equations."""
    from rootmatch.camera import Camera
    from rootmatch.problems import planar_motion, up2pf

    for problem in (planar_motion.derivation(Camera(1000.0, 1000.0, 320.0, 240.0)), up2pf.derivation()):
        FOLDER.mkdir(exist_ok=True)
        (FOLDER / f"{problem.name}.txt").write_text(problem.code, encoding="utf-8")


if __name__ == "__main__":
    regenerate()
