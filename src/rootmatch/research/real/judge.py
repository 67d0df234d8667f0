"""Judgement of a reply: right, wrong and missed points, and whether it was vouched for."""

from __future__ import annotations

from typing import Any

import numpy as np

from rootmatch.errors import quote_value
from rootmatch.research.real.scenes import RealScene

MOST_OF_ERROR = 200
"""Characters of a method's own words that are kept."""
MOST_SECONDS = 1e9
FULL = 0.9
"""Share of the visible points that a full match finds, with none wrong."""
LEAST_OF_INSTANCE = 12
"""Right pairs of an instance from which it is found: four times what a pose takes."""


def judge_reply(scene: RealScene, reply: dict[str, Any]) -> dict[str, Any]:
    """Figures of a reply, as JSON can hold them."""
    error = None
    if reply.get("error") is not None:
        error = str(reply["error"])[:MOST_OF_ERROR] or "an error without words"
    seconds = _seconds(reply.get("seconds", reply["wall"]))
    if error is None and seconds is None:
        error = f"seconds: {quote_value(reply['seconds'])}, which is no time"
    found = _assignment(scene, reply.get("assignment")) if error is None else None
    if found is None:
        error = error or "assignment: of another length, or an index out of range or used twice"
        found = np.full(len(scene.request["source"]), -1, np.int64)
    right, wrong, visible = _counts(scene, found)
    return {
        "scene": scene.name,
        "protocol": scene.protocol,
        "right": right,
        "wrong": wrong,
        "visible": visible,
        "full": wrong == 0 and right >= FULL * visible,
        "claimed": bool(reply.get("matched", found.max(initial=-1) >= 0)) and not error,
        "misled": wrong > (1.0 - FULL) * (right + wrong),
        "seconds": float(reply["wall"]) if seconds is None else seconds,
        "wall": float(reply["wall"]),
        "error": error,
    }


def _seconds(given: Any) -> float | None:
    """The time that a method says it took, or None if it is none."""
    if isinstance(given, bool) or not isinstance(given, int | float) or not 0.0 <= given <= MOST_SECONDS:
        return None
    return float(given)


def _assignment(scene: RealScene, given: Any) -> Any:
    """The assignment as an array, or None if it is none."""
    try:
        found = np.array(given, dtype=np.int64)
    except (TypeError, ValueError, OverflowError):
        return None
    n, n_target = len(scene.request["source"]), len(scene.request["target"])
    if found.shape != (n,) or found.min(initial=0) < -1 or found.max(initial=-1) >= n_target:
        return None
    used = found[found >= 0]
    return found if len(np.unique(used)) == len(used) else None


def _counts(scene: RealScene, found: Any) -> tuple[int, int, int]:
    """Right, wrong and visible: of points, or of instances where these are what is looked for."""
    if scene.truth is not None:
        truth = scene.truth
        right = int(((found == truth) & (truth >= 0)).sum())
        return right, int(((found >= 0) & (found != truth)).sum()), int((truth >= 0).sum())
    pairs = np.array(scene.request["candidates"])
    chosen = found[pairs[:, 0]] == pairs[:, 1]
    instances = scene.instances or []
    seen = sum(int((chosen & instance).sum()) >= LEAST_OF_INSTANCE for instance in instances)
    stray = int((chosen & ~np.any(instances, axis=0)).sum())
    return seen, int(stray > (1.0 - FULL) * chosen.sum()), len(instances)
