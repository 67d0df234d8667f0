"""A match as a JSON record, for programs: ``rootmatch match --json``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rootmatch.result import Match


def match_record(match: Match) -> dict[str, Any]:
    """The match as numbers, lists and strings that JSON can hold.

    Keys: ``assignment`` and ``motions`` (lists of n, −1 unmatched), ``score``, ``margin``, ``probability`` (null where
    there is none), ``alternatives`` (objects with ``assignment`` and ``score``, best first), ``status`` (``"matched"``,
    ``"ambiguous"`` or ``"untrusted"``), ``converged``, ``limited`` (whether the time limit ended it), ``seconds``,
    ``hyperedges``, ``noise`` (σ in pixels, null where it differs by point). Indices are zero-based row numbers. A
    number that is not finite becomes null.
    """
    return {
        "assignment": match.assignment.tolist(),
        "score": _finite(match.score),
        "margin": _finite(match.margin),
        "probability": None if match.probability is None else _finite(match.probability),
        "motions": match.motions.tolist(),
        "alternatives": [
            {"assignment": other.tolist(), "score": _finite(score)} for other, score in match.alternatives
        ],
        "status": match.status.name.lower(),
        "converged": match.converged,
        "limited": match.limited,
        "seconds": _finite(match.seconds),
        "hyperedges": int(match.hyperedges),
        "noise": _finite(match.noise) if isinstance(match.noise, int | float) else None,
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
