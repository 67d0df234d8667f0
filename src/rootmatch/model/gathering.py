"""What hypotheses predict: the detections that their poses gather in all images."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import OutOfTime, active_deadline
from rootmatch.jit.threads import run_in_pieces
from rootmatch.model.compiled.gathering import gather, gather_about
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.prediction import HIDDEN
from rootmatch.model.proposals import Proposals
from rootmatch.problems.limits import GATE

AT_ONCE = 512
"""Poses that are not taken in pieces where no deadline is set: they take a few milliseconds. A round value."""
RATE = 0.7
"""Detection rate that their order supposes; the model of the image judges them later. A round value."""


def gather_assignments(model: DetectionModel, proposals: Proposals, *, minimum: int, maximum: int) -> Proposals:
    """What hypotheses lead to, each assignment once, the most likely first, at the poses that led to it.

    ``proposals``: poses with the matches, three or more, that determine them; ``minimum``: fewest matches of an
    assignment; ``maximum``: how many assignments.
    """
    assignments, gains = gather_each(model, proposals)
    enough = np.flatnonzero(((assignments >= 0).sum(axis=1) >= minimum) & np.isfinite(gains))
    kept: dict[bytes, int] = {}
    for k in enough[np.argsort(-gains[enough], kind="stable")].tolist():
        kept.setdefault(assignments[k].tobytes(), k)
        if len(kept) == maximum:
            break
    return proposals._replace(assignments=assignments).take(np.array(list(kept.values()), np.int64))


def gather_each(model: DetectionModel, proposals: Proposals) -> tuple[Integers, Floats]:
    """The assignment (K, n) that each pose leads to, and its log-odds (K,) against clutter, to first order.

    −∞ for a pose from which a point of its own would not be seen, and for one that a deadline leaves out.
    """
    assignments, gains = np.full_like(proposals.assignments, -1), np.full(len(proposals.rotation), -np.inf)
    limits = max(len(model.images), 1), GATE**2, RATE, HIDDEN
    scene = model.scene_for_kernels

    def work(first: int, last: int) -> None:
        some = slice(first, last)
        rotation, position, sources = proposals.rotation[some], proposals.position[some], proposals.assignments[some]
        out = assignments[some], gains[some]
        if scene is not None:
            gather_about((rotation, position), sources, scene, limits, out)
            return
        at = model.linearise_about(rotation, position)
        visible = model.visibility(at, np.zeros(last - first))
        gather((at.pixels, at.jacobian, visible), sources, image, limits, out)

    target, sigma, log_weights, *_ = model.image_for_kernels
    image = target, sigma, np.array(model.clutter.log_density), log_weights, np.array(model.image_indices)
    with suppress(OutOfTime):
        if 0 < len(gains) <= AT_ONCE and not active_deadline().is_set:
            work(0, len(gains))
        else:
            run_in_pieces(work, len(gains))
    return assignments, gains
