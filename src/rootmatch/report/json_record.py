"""A match as a JSON record, for programs: ``rootmatch match --json``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rootmatch.io import pose_record

if TYPE_CHECKING:
    from rootmatch.problems.pose_fit.pose import Pose
    from rootmatch.result import Match


def match_record(match: Match) -> dict[str, Any]:
    """The match as numbers, lists and strings that JSON can hold.

    Keys: ``assignment`` and ``motions`` (lists of n, −1 unmatched), ``score``, ``margin``, ``probability`` (null where
    there is none), ``confidence`` (list of n, of each match or unmatched point), ``alternatives`` (objects with
    ``assignment`` and ``score``, best first), ``status`` (``"matched"``, ``"ambiguous"`` or ``"untrusted"``),
    ``converged``, ``limited`` (whether the time limit ended it), ``seconds``, ``hyperedges``, ``noise`` (σ in pixels,
    null where it differs by point), ``poses`` (one for each motion, null where it has none; null for problems that fit
    no poses; see `rootmatch.io.pose_record`), which alternatives have too. Indices are zero-based row numbers. A number
    that is not finite becomes null.
    """
    fits = bool(match.problem.least_for_pose)
    others = match.alternative_poses if fits else [None] * len(match.alternatives)
    return {
        "assignment": match.assignment.tolist(),
        "score": _finite(match.score),
        "margin": _finite(match.margin),
        "probability": None if match.probability is None else _finite(match.probability),
        "confidence": [_finite(value) for value in match.confidence.tolist()],
        "motions": match.motions.tolist(),
        "alternatives": [
            {"assignment": other.tolist(), "score": _finite(score), "poses": _records(poses)}
            for (other, score), poses in zip(match.alternatives, others, strict=True)
        ],
        "status": match.status.name.lower(),
        **({} if match.sightings is None else {"sightings": match.sightings.assignment.tolist()}),
        "converged": match.converged,
        "limited": match.limited,
        "seconds": _finite(match.seconds),
        "hyperedges": int(match.hyperedges),
        "noise": _finite(match.noise) if isinstance(match.noise, int | float) else None,
        "poses": _records(match.poses) if fits else None,
    }


def _records(poses: Sequence[Pose | None] | None) -> list[dict[str, Any] | None] | None:
    """Records of poses, None where there are none."""
    return None if poses is None else [None if pose is None else pose_record(pose) for pose in poses]


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
