"""What hypotheses predict: the detections that their poses gather in all images."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from rootmatch.deadline import OutOfTime
from rootmatch.jit.threads import in_pieces
from rootmatch.model.compiled.gathering import gather
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.proposals import Proposals
from rootmatch.problems.limits import GATE

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

RATE = 0.7
"""Detection rate that their order supposes; the model of the image judges them later. A round value."""
HIDDEN = 0.1
"""Visibility below which a point is not looked for. A round value."""


def gathered(model: DetectionModel, proposals: Proposals, *, least: int, most: int) -> Proposals:
    """What hypotheses lead to, each assignment once, the most likely first, at the poses that led to it.

    Parameters
    ----------
    model : DetectionModel
    proposals : Proposals
        Poses with the matches, three or more, that determine them.
    least, most : int
        Minimum number of matches, and maximum number of assignments.
    """
    assignments, gains = gathered_by_each(model, proposals)
    enough = np.flatnonzero(((assignments >= 0).sum(axis=1) >= least) & np.isfinite(gains))
    kept: dict[bytes, int] = {}
    for k in enough[np.argsort(-gains[enough], kind="stable")].tolist():
        kept.setdefault(assignments[k].tobytes(), k)
        if len(kept) == most:
            break
    return proposals._replace(assignments=assignments).take(np.array(list(kept.values()), np.int64))


def gathered_by_each(model: DetectionModel, proposals: Proposals) -> tuple[Integers, Floats]:
    """The assignment (K, n) that each pose leads to, and its log-odds (K,) against clutter, to first order.

    −∞ for a pose from which a point of its own would not be seen, and for one that a deadline leaves out.
    """
    at = model.linearised(proposals.rotation, proposals.position)
    visible = model.visibility(at, np.zeros(len(at.seen)))
    assignments, gains = np.full_like(proposals.assignments, -1), np.full(len(at.seen), -np.inf)
    target, sigma, log_weights, *_ = model.image_for_kernels
    image = target, sigma, np.array(model.clutter.log_density), log_weights, np.array(model.image_of)

    def work(first: int, last: int) -> None:
        some = slice(first, last)
        gather(
            (at.pixels[some], at.jacobian[some], visible[some]),
            proposals.assignments[some],
            image,
            (max(len(model.images), 1), GATE**2, RATE, HIDDEN),
            (assignments[some], gains[some]),
        )

    with suppress(OutOfTime):
        in_pieces(work, len(gains))
    return assignments, gains
