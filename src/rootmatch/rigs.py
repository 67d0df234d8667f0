"""Matches of a rig: several cameras see one body at once.

Hypotheses come from minimal sets within one camera. Each is a pose of the rig, which predicts the detections of all
cameras; what it gathers there is fitted, gathered again, and ranked by its posterior probability with all cameras.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rootmatch.cameras.rig import Rig, rig_of
from rootmatch.errors import InputError
from rootmatch.hypergraph.assignment import margin, one_hot
from rootmatch.hypergraph.support import scores_of
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.options import Options, option
from rootmatch.pipeline.detection_odds import DEFAULT_OPTIONS
from rootmatch.pipeline.posterior import NO_POSE, Ranked, ranked
from rootmatch.pipeline.sampling import sample
from rootmatch.pipeline.status import TRUST, judged
from rootmatch.pipeline.task import MatchingTask
from rootmatch.problems.gate import GATE
from rootmatch.problems.points import PointSets
from rootmatch.problems.pose_fit.absolute import AbsoluteFit
from rootmatch.problems.pose_fit.rig_fit import LEAST, STEPS, Copies, rig_fit, rig_pose
from rootmatch.problems.rig_copies import RigCopies
from rootmatch.result import Match, Sightings
from rootmatch.samplers.clutter import CROWDING
from rootmatch.samplers.guided.sampler import Guided

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class RigOptions(Options):
    """How hypotheses of single cameras are verified with all of them; nothing is tuned."""

    hypotheses: int = option(100, least=1)
    """Of each camera, those of the highest evidence."""
    kept: int = option(40, least=1)
    """Of all, after the first round of gathering."""
    rounds: int = option(3, least=1)
    """Rounds of gathering and fitting."""
    gate: float = option(GATE, above=0.0)
    """Distance from a prediction, in standard deviations of it, within which a detection is gathered."""
    budget: int = option(3_000_000, least=1)
    """Evaluations of the search in one camera."""


OPTIONS = RigOptions()
INSTEAD = {
    "bodies": "match the points of each body by themselves, with all detections",
    "prior": "its poses are not predicted, so leave it out",
}
"""What to do where a rig does not take an option."""
UNREACHABLE = 1e9
"""Cost of a detection beyond the gate: no assignment takes it."""


def is_rig(task: MatchingTask) -> bool:
    """Whether the detections of a task are those of a rig."""
    return rig_of(task.problem) is not None


def match_rig(task: MatchingTask, options: RigOptions = OPTIONS) -> Match:
    """The match of a task whose camera is a rig.

    Raises
    ------
    InputError
        For an option that rigs do not take.
    """
    _check(task)
    rig: Rig = task.problem.camera  # type: ignore[attr-defined]
    _, plane, sigma = rig.chart(task.points.target, task.points.target_noise)
    copies = Copies(rig, task.points.source, rig.offsets(task.points.target), task.points.target[:, 2].astype(np.int64))
    tensor, hypotheses, evaluated = _searched(task, copies, options)
    whole = _of_copies(task, copies, plane, sigma)
    proposals = _verified(whole, copies, hypotheses, options)
    found = ranked(whole, proposals) if proposals else Ranked([], np.empty(0), math.nan, NO_POSE)
    return _reported(task, whole, copies, tensor=tensor, found=found, evaluated=evaluated)


def _check(task: MatchingTask) -> None:
    """Refuse what rigs do not take."""
    options = task.options
    if task.problem.name != "p3p":
        raise InputError(f"rig: {task.problem.name} takes one camera; use P3P(rig)")
    given = {
        "motions": options.motions != 1,
        "bodies": task.bodies is not None,
        "prior": task.predicted is not None,
        "preset": options.preset is not None,
        "solver": options.solver is not None,
        "scheduler": options.scheduler is not None,
        "samples": options.samples is not None,
        "hyperedges": options.hyperedges not in (None, "auto", "guided"),
    }
    for name, is_given in given.items():
        if is_given:
            raise InputError(f"{name}: a rig does not take it; {INSTEAD.get(name, 'leave it out')}")


def _searched(task: MatchingTask, copies: Copies, options: RigOptions) -> tuple[AffinityTensor, list[Integers], int]:
    """Hyper-edges within the cameras, assignments of copies that hypotheses of single cameras name, and the cost."""
    n, n_target = task.shape
    indices, weights, hypotheses, evaluated = [], [], [], 0
    for k, camera in enumerate(copies.rig.cameras):
        own = np.flatnonzero(copies.owner == k)
        if len(own) < task.problem.order or task.deadline.passed():
            continue
        part = task.subset(np.arange(n), own)
        part = replace(
            part,
            problem=replace(task.problem, camera=camera),  # type: ignore[type-var]
            points=replace(part.points, target=np.ascontiguousarray(part.points.target[:, :2])),
            options=replace(part.options, hyperedges=Guided(budget=options.budget, hypotheses=options.hypotheses)),
        )
        sampled = sample(part)
        evaluated += sampled.evaluated
        i, j = np.divmod(sampled.tensor.indices.astype(np.int64), len(own))
        indices.append((i * n_target + own[j]).astype(np.int32))
        weights.append(np.asarray(sampled.tensor.weights))
        for assignment in sampled.assignments if sampled.assignments is not None else []:
            if (assignment >= 0).sum() >= LEAST:
                whole = np.full(n * len(copies.offsets), -1, np.int64)
                whole[k * n : (k + 1) * n] = np.where(assignment >= 0, own[assignment], -1)
                hypotheses.append(whole)
    joined = np.concatenate(indices) if indices else np.empty((0, task.problem.order), np.int32)
    values = np.concatenate(weights) if weights else np.empty(0)
    tensor = AffinityTensor.unchecked(np.ascontiguousarray(joined), values, (n, n_target), task.prior)
    return tensor, hypotheses, evaluated


def _of_copies(task: MatchingTask, copies: Copies, plane: Floats, sigma: Floats) -> MatchingTask:
    """The task of the copies, each of which may be any detection of its camera."""
    cameras, points = len(copies.offsets), task.points
    own = np.repeat(np.arange(cameras), copies.count)[:, None] == copies.owner
    return replace(
        task,
        problem=RigCopies(copies),
        points=PointSets(
            source=np.tile(points.source, (cameras, 1)),
            target=plane,
            source_noise=np.tile(points.source_noise, cameras),
            target_noise=sigma,
            normals=None if points.normals is None else np.tile(points.normals, (cameras, 1)),
            view_cosine=None if points.view_cosine is None else np.tile(points.view_cosine, cameras),
        ),
        allowed=own if task.allowed is None else own & np.tile(task.allowed, (cameras, 1)),
        prior=None if task.prior is None else np.tile(task.prior, (cameras, 1)),
    )


def _verified(whole: MatchingTask, copies: Copies, hypotheses: list[Integers], options: RigOptions) -> list[Integers]:
    """Assignments that hypotheses gather in all cameras, the best first."""
    if not hypotheses:
        return []
    target, sigma = whole.points.target, whole.points.target_noise
    assert whole.allowed is not None
    low, high = target.min(axis=0), target.max(axis=0)
    density = CROWDING * len(target) / max(float(np.prod(high - low)), 1e-300)
    current = np.array(hypotheses)
    for turn in range(options.rounds):
        # at first all matches are of one camera, whose own fit is the best one
        fit = rig_fit(copies, target, sigma, current, steps=0 if turn == 0 else STEPS)
        possible = np.flatnonzero(np.isfinite(fit.chi2))
        gathered = [
            _gathered(fit, k, copies, whole.allowed, density=density, options=options) for k in possible.tolist()
        ]
        order = np.argsort([-gain for _, gain in gathered], kind="stable")
        if not len(order):
            break
        current = np.array([gathered[k][0] for k in order])
        _, first = np.unique(current, axis=0, return_index=True)
        current = current[np.sort(first)[: options.kept if turn + 1 < options.rounds else TRUST.alternatives]]
    return list(current)


def _gathered(
    fit: AbsoluteFit, k: int, copies: Copies, allowed: NDArray[np.bool_], *, density: float, options: RigOptions
) -> tuple[Integers, float]:
    """What the pose of assignment k predicts, and its log-odds against clutter of some density.

    Within each camera the one-to-one assignment of least χ².
    """
    from scipy.optimize import linear_sum_assignment  # slow to import, and few have a rig

    out, gain = np.full(len(allowed), -1, np.int64), 0.0
    jacobian = fit.jacobian[k]
    spread = jacobian @ fit.covariance[k] @ jacobian.transpose(0, 2, 1)
    for camera in range(len(copies.offsets)):
        rows, own = slice(camera * copies.count, (camera + 1) * copies.count), np.flatnonzero(copies.owner == camera)
        if not len(own):
            continue
        total = spread[rows, None] + fit.variance[own][:, None, None] * np.eye(2)
        difference = fit.target[own] - fit.predicted[k][rows, None]
        a, b, c = total[..., 0, 0], total[..., 0, 1], total[..., 1, 1]
        x, y = difference[..., 0], difference[..., 1]
        with np.errstate(all="ignore"):
            determinant = a * c - b * b
            chi2 = (c * x * x - 2.0 * b * x * y + a * y * y) / determinant
        near = (chi2 <= options.gate**2) & allowed[rows][:, own] & fit.seen[k][rows, None]
        i, j = linear_sum_assignment(np.where(near, chi2 - options.gate**2, UNREACHABLE))
        kept = near[i, j]
        out[camera * copies.count + i[kept]] = own[j[kept]]
        found = i[kept], j[kept]
        gain -= float((0.5 * (chi2[found] + np.log(determinant[found])) + math.log(2.0 * math.pi * density)).sum())
    return out, gain


def _reported(
    task: MatchingTask, whole: MatchingTask, copies: Copies, *, tensor: AffinityTensor, found: Ranked, evaluated: int
) -> Match:
    """The match: one detection for each point, and all of them beside."""
    n = task.shape[0]
    every = [one.reshape(-1, n) for one in found.assignments[: TRUST.alternatives + 1]]
    best = every[0] if every else np.full((len(copies.offsets), n), -1, np.int64)
    first = [_first_of(one) for one in (every or [best])]
    scores = scores_of(tensor, np.array(first)).tolist()
    alternatives = [
        (one, score) for one, score in zip(first[1:], scores[1:], strict=True) if not np.array_equal(one, first[0])
    ]
    probability = found.probability if every else None
    listed = found.probability_of(1 + TRUST.listed) if every else 0.0
    trusted = found.beyond_chance > TRUST.beyond_clutter and listed > TRUST.listed_probability
    trusted = trusted and found.misfit.variances <= DEFAULT_OPTIONS.most_inflation
    lead = margin(scores[0], alternatives, first[0])
    status = judged(math.inf if trusted else 0.0, -math.inf if trusted else math.inf, lead, probability)
    confidence = np.full(n, math.nan)
    if found.marginals is not None:
        # of the sightings of a point the surest one, of an unseen point the least sure
        each = found.marginals.each.reshape(-1, n)
        surest = np.where(best >= 0, each, -1.0).max(axis=0)
        confidence = np.where((best >= 0).any(axis=0), surest, each.min(axis=0))
    pose = rig_pose(copies, whole.points.target, whole.points.target_noise, best.ravel()) if every else None
    return Match(
        task=task,
        assignment=first[0],
        score=float(scores[0]),
        margin=lead,
        alternatives=alternatives,
        soft=one_hot(first[0], task.shape[1]),
        tensor=tensor,
        motions=np.where(first[0] >= 0, 0, -1),
        status=status,
        converged=True,
        hyperedges=evaluated,
        seconds=0.0,
        fitted_confidence=confidence,
        fitted_probability=probability,
        sightings=Sightings(best, pose, every[1:]),
    )


def _first_of(sightings: Integers) -> Integers:
    """The detection of each point in the first camera that has one, −1 for none; of (C, n)."""
    seen = sightings >= 0
    return np.where(seen.any(axis=0), sightings[seen.argmax(axis=0), np.arange(sightings.shape[1])], -1)
