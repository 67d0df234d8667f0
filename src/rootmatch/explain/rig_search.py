"""Matches of a rig: several cameras see one body at once.

Hypotheses come from minimal sets within one camera. Each is a pose of the rig, which predicts the detections of all
cameras; those that it gathers there are what the model of all images judges.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import OutOfTime
from rootmatch.explain.decide import TRUST
from rootmatch.explain.finding import Finding, empty_tensor
from rootmatch.explain.image_decision import assess_image
from rootmatch.explain.image_hypotheses import Candidate, is_search_needless, make_detection_model
from rootmatch.explain.inexact_points import allow_point_errors
from rootmatch.explain.rig_triples import search_rig_triples
from rootmatch.explain.sampling import make_guided, sample_once
from rootmatch.explain.task import MatchingTask
from rootmatch.frozen import copy_with
from rootmatch.hypergraph.assignment import one_hot
from rootmatch.hypergraph.deferred_tensor import concatenate_tensors, renumber_tensor
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import weigh_poses
from rootmatch.model.gathering import gather_assignments
from rootmatch.model.modes import best_of_places, used_mask
from rootmatch.model.pose_density import Gaussian
from rootmatch.model.prediction import propose_about, score_predictions
from rootmatch.model.proposals import (
    Proposals,
    fit_assignments,
    join_proposals,
    refit_proposals,
    solve_minimal_sets,
)
from rootmatch.model.shown_in_part import ShownOfCopy
from rootmatch.problems.pose_fit.rig_fit import MINIMUM
from rootmatch.samplers.base import SampledTensor
from rootmatch.samplers.guided.sampler import Guided
from rootmatch.samplers.guided.stopping import TRUSTED, StoppingOptions, false_alarm_level
from rootmatch.samplers.guided.visibility import MISSED

LIMITS, LIMITS_OF_BOUNDED, LIMITS_OF_FRAME = (100, 16), (100, 8), (100, 3)
"""Hypotheses of each camera, those of the highest evidence, that are verified in all, and of all of them those kept, by
what they gather (benchmarks/rigs.py). Round values: of 40 scenes with four of ten detections right in each camera (σ 1,
seeds from 2000) three are right, with 30 one. A search that is bounded, as those for bodies are, keeps fewer, as they
are fitted with what other searches propose. With 30 verified it is as fast, and the pose of a small body of five
points, of which chance explains as many in one camera, was not among them (three actors before two cameras). As many
are narrowed from match to match: of wristbands and their mirror images 1,193 sightings are right, with three kept
1,173. A tracker's search of one camera goes on in others: with 5 kept its flights find the same
(benchmarks/flights.py, rig, 6 flights from 1100)."""
BUDGET = 3_000_000
"""Evaluations of the search in one camera, unless a `Guided` is given with its own."""
IN_PART = StoppingOptions(in_part=True)
LITTLE, PART, UNMET = 10_000, 4, 0.2
"""Of a search for a copy beside the best pose: evaluations in one camera, or such a part of those before it, if that is
more; and the odds, in view and not met, from which it goes on. Round values."""
CUT = 3
"""Cameras in which the budget ended a search for one of several bodies, though nothing was met, before the others are
left to the next search for it, which has more, among the detections that other bodies leave. A round value."""
SEARCHED = 0.75
"""Share of the time left at a deadline for the searches in single cameras, the same for each. A round value."""


def match_rig(task: MatchingTask, *, judging: bool) -> Finding:
    """The match of a task of a rig, searched without a prediction.

    `Finding.converged` says whether each camera's search ended before its budget. ``judging``: see `assess_image`.
    """
    bounded = LIMITS_OF_BOUNDED if task.search_camera is None else LIMITS_OF_FRAME
    model = make_detection_model(task)
    sampled, whole, unmet = _search_cameras(task, model, LIMITS if task.budget is None else bounded)
    if task.budget is None and sampled.missed <= TRUST.missed:
        sampled = _search_for_copy(task, model, sampled, unmet)
    found = allow_point_errors(assess_image(task, sampled, judging=judging), task, missed=sampled.missed)
    return copy_with(found, soft=one_hot(found.assignment, task.shape[1]), converged=whole)


def _search_for_copy(
    task: MatchingTask, model: DetectionModel, sampled: SampledTensor, unmet: Integers
) -> SampledTensor:
    """What a search met, with what is met where it did not look, among the detections that the best of it leaves.

    It ended as no pose explains more; which of two copies is asked for is not told by how much they show. How many
    detections are left tells how well one may be among them. ``unmet``: see `_search_cameras`.
    """
    verified = sampled.assignments
    assert verified is not None
    (left,) = np.nonzero(~used_mask(verified[:1], task.shape[1]).any(axis=0))
    counts = np.bincount(model.image_indices[left], minlength=len(unmet))
    unmet = np.minimum(counts, unmet)
    if not len(verified) or unmet.max() < MINIMUM - 1:
        return sampled
    hypotheses, evaluated = list[Integers](), sampled.evaluated
    with suppress(OutOfTime):
        _, found, _ = fit_assignments(model, verified[:1])
        if not (found.log_odds > 0.0).any():
            return sampled
        shown = ShownOfCopy.of(model, counts, int((verified[0] >= 0).sum()), float(found.visible.sum()))
        if shown.unmet_odds(unmet) <= UNMET:
            return sampled
        rest = task.subset(None, left)
        beside = make_detection_model(rest)
        guided = make_guided(budget=max(evaluated // PART, LITTLE), hypotheses=LIMITS[0], stopping=IN_PART)
        for minimum in (MINIMUM, MINIMUM - 1):
            for k in np.flatnonzero(unmet >= minimum).tolist():
                if shown.unmet_odds(unmet) <= UNMET:
                    break
                _, own, part = camera_task(rest, k, guided)
                if minimum == MINIMUM:
                    other = sample_once(part)
                    evaluated += other.evaluated
                    hypotheses += _in_all_cameras(rest, k, own, other.assignments)
                else:
                    hypotheses += (search_rig_triples(part, beside, k, own, guided) or ([], False))[0]
                unmet[k] = minimum - 1
        there, _ = _verify_hypotheses(beside, hypotheses, LIMITS_OF_BOUNDED, narrowing=False)
        verified = np.concatenate([verified, np.where(there >= 0, left[there], -1)])
        return sampled._replace(assignments=verified, evaluated=evaluated)
    return sampled


def _in_all_cameras(task: MatchingTask, k: int, own: Integers, found: Integers | None) -> list[Integers]:
    """Assignments (n,) of a camera's detections, of enough points, as those of a task's sightings."""
    n, hypotheses = task.shape[0], list[Integers]()
    for assignment in found if found is not None else []:
        if (assignment >= 0).sum() >= MINIMUM:
            one = np.full(task.rows, -1, np.int64)
            one[k * n : (k + 1) * n] = np.where(assignment >= 0, own[assignment], -1)
            hypotheses.append(one)
    return hypotheses


def _search_cameras(
    task: MatchingTask, model: DetectionModel, limits: tuple[int, int]
) -> tuple[SampledTensor, bool, Integers]:
    """Hyper-edges within the cameras, with the verified assignments that hypotheses of single cameras lead to.

    The second value says whether every camera's search ended before its budget; the third is the most sightings (C,) of
    a pose that was not met.
    """
    assert task.rig is not None
    n = task.shape[0]
    guided = task.options.sampler
    if not isinstance(guided, Guided):
        guided = make_guided(budget=task.budget or BUDGET, hypotheses=limits[0], stopping=IN_PART)
    hypotheses, evaluated, postponed, missed_by = list[Integers](), 0, False, np.ones(len(task.rig.cameras))
    tensors = [empty_tensor(task)]
    searching = task.deadline.part(SEARCHED)
    views = [k for k in range(len(task.rig.cameras)) if task.search_camera in (None, k)]
    parts = [camera_task(task, k, guided) for k in views]
    # otherwise a tracker's search goes on in the next frames: that takes less than narrowing here, and the tracker
    # knows when it has come to enough cameras to have missed nothing
    in_all, enough, cut = task.search_camera is None, None, 0
    unmet = np.minimum(np.bincount(model.image_indices, minlength=len(missed_by)), n)
    verified, log_odds = _verify_hypotheses(model, [], limits)
    for number, (k, own, part) in enumerate(parts):
        if len(own) < task.minimal or searching.passed():
            continue
        part = copy_with(part, deadline=searching.part(1.0 / (len(parts) - number)))
        if task.search_camera is not None:
            by_triples = search_rig_triples(part, model, k, own, guided)
            if by_triples is not None:
                hypotheses += by_triples[0]
                continue  # triples tell all: a search for four there meets nothing else
        if len(own) < MINIMUM:
            continue
        if postponed := in_all and task.budget is not None and cut >= CUT and not (log_odds > TRUSTED).any():
            break
        sampled, met = sample_once(part), len(hypotheses)
        evaluated += sampled.evaluated
        cut += sampled.evaluated >= guided.budget and sampled.missed > MISSED
        missed_by[k] = sampled.missed
        tensors.append(renumber_tensor(sampled.tensor, (np.arange(k * n, (k + 1) * n), own), task.row_shape))
        hypotheses += _in_all_cameras(task, k, own, sampled.assignments)
        unmet[k] = min(unmet[k], MINIMUM - 1)  # a pose that shows more here was met
        if in_all and number + 1 < len(parts):
            new = _verify_hypotheses(model, hypotheses[met:], limits, narrowing=False)
            verified, log_odds = _select_best(model, *_merge((verified, log_odds), new), limits[1])
            if _missed_probability(verified, missed_by) <= TRUST.missed:
                enough = _sufficient_assignments(task, model, verified, evaluated, int(unmet.sum()))
            if enough is not None:
                break
    all_triples = False
    if enough is not None:  # what its modes match, as what was verified was not narrowed
        verified = np.concatenate([enough, verified[: max(limits[1] - len(enough), 0)]])
    else:
        verified, log_odds = _verify_hypotheses(model, hypotheses, limits, narrowing=in_all)
        if in_all:
            enough = _sufficient_assignments(task, model, verified, evaluated, int(unmet.sum()))
    if in_all and enough is None and not postponed:
        met = len(hypotheses)
        for k, own, part in parts:
            if len(own) >= task.minimal and not searching.passed():
                part = copy_with(part, deadline=searching)
                led, every = search_rig_triples(part, model, k, own, guided) or ([], False)
                hypotheses += led
                all_triples |= every
                unmet[k] = min(unmet[k], MINIMUM - 2 if every else MINIMUM - 1)
        if len(hypotheses) > met:
            verified, _ = _merge((verified, log_odds), _verify_hypotheses(model, hypotheses[met:], limits))
    tensor = concatenate_tensors(tensors, task.row_shape, task.row_weights, task.options.max_hyperedges)
    missed = 0.0 if all_triples or not in_all else _missed_probability(verified, missed_by)
    return SampledTensor(tensor, evaluated, partial=True, assignments=verified, missed=missed), not cut, unmet


def _missed_probability(verified: Integers, missed_by: Floats) -> float:
    """Probability that a pose with as many sightings in each camera as the first assignment was missed in all.

    Of one that no camera shows four points of `is_met_by_search` judges, by the triples that were looked at.
    ``missed_by``: (C,) that probability in each camera, if it shows enough of them.
    """
    if not len(verified):
        return 1.0
    enough = (verified[0].reshape(len(missed_by), -1) >= 0).sum(axis=1) >= MINIMUM
    return float(missed_by[enough].prod()) if enough.any() else 0.0


def camera_task(task: MatchingTask, k: int, guided: Guided) -> tuple[int, Integers, MatchingTask]:
    """One camera, its detections (m,) among all, and the task of these."""
    assert task.rig is not None
    own = np.flatnonzero(task.camera_of == k)
    part = task.subset(None, own)
    part = copy_with(
        part,
        problem=task.problem.of_view(task.rig.cameras[k], task.rig.rotations[k]),  # type: ignore[attr-defined]
        points=copy_with(part.points, target=np.ascontiguousarray(part.points.target[:, :2])),
        # other minimal sets in each camera: what is missed in one is met in another
        options=copy_with(part.options, sampler=guided, seed=part.options.seed + k),
    )
    return k, own, part


def _sufficient_assignments(
    task: MatchingTask, model: DetectionModel, verified: Integers, evaluated: int, unmet: int
) -> Integers | None:
    """Those of the modes (K, rows) if the body was met, so that no pose explains as much that was not met; else None.

    ``unmet``: most sightings of such a pose, three in each camera that was searched. Triples take four times as long
    as all else (benchmarks/rigs.py, bodies).
    """
    if not len(verified) or unmet - task.minimal > np.count_nonzero(verified[0] >= 0):
        return None
    told = Candidate.of(task, list(verified)).alone()
    level = false_alarm_level(evaluated, StoppingOptions())
    if not len(told.probabilities) or not float(told.modes.log_mass[0]) > level:
        return None
    needless = is_search_needless(model, told, task.minimal, of_several=task.budget is not None, unmet=float(unmet))
    return told.modes.assignments if needless else None


def _merge(first: tuple[Integers, Floats], second: tuple[Integers, Floats]) -> tuple[Integers, Floats]:
    """Two lots of assignments (K, n) with their log-odds (K,) as one, the most probable first."""
    assignments, log_odds = (np.concatenate(each) for each in zip(first, second, strict=True))
    order = np.argsort(-log_odds, kind="stable")
    return assignments[order], log_odds[order]


def _verify_hypotheses(
    model: DetectionModel, hypotheses: list[Integers], limits: tuple[int, int], *, narrowing: bool = True
) -> tuple[Integers, Floats]:
    """Assignments (K, n) that the poses of hypotheses gather in all cameras, the most probable first; log-odds (K,).

    Poses of minimal sets, so that a match among many that is wrong is not taken along. What each gathers at once is
    fitted, and with ``narrowing`` the likeliest are narrowed as well: the right one may gather a few wrong detections,
    and fit worse.
    """
    if not hypotheses:
        return np.empty((0, model.shape[0]), np.int64), np.empty(0)
    maximum, kept = limits
    sets = solve_minimal_sets(model, np.array(hypotheses), model.shape[0]).alone
    led = gather_assignments(model, sets, minimum=MINIMUM, maximum=maximum)
    every, found, _ = refit_proposals(model, led)
    parts = [_select_best(model, every.assignments, found.log_odds, kept)]
    number = {pose.tobytes(): k for k, pose in enumerate(sets.rotation)}
    own = sets.take(np.array([number[pose.tobytes()] for pose in led.rotation], np.int64))
    if narrowing and (more := _narrow(model, own, kept)) is not None:
        every, found, _ = refit_proposals(model, more)
        parts.append(_select_best(model, every.assignments, found.log_odds, kept))
    return parts[0] if len(parts) == 1 else _merge(parts[0], parts[1])


def _select_best(
    model: DetectionModel, assignments: Integers, log_odds: Floats, maximum: int
) -> tuple[Integers, Floats]:
    """The assignments (K, n) of the highest log-odds, see `best_of_places`, and these (K,)."""
    first = best_of_places(used_mask(assignments, model.shape[1]), log_odds, maximum)
    return assignments[first], log_odds[first]


def _narrow(model: DetectionModel, sets: Proposals, maximum: int) -> Proposals | None:
    """What the poses of some minimal sets lead to where one match narrows the pose for the next; None for nothing.

    Three sightings of a small body in one camera leave several detections for a point in another one. Gathered all at
    once, a single wrong one among them spoils the fit. Up to ``maximum`` sets are tried, those that explain most as far
    as their poses are known, whatever they gather at once.
    """
    spread, at = weigh_poses(model, *sets)
    possible = np.flatnonzero(np.isfinite(spread.covariance).all(axis=(1, 2)))
    scores = score_predictions(model, at.take(possible), spread.step[possible], spread.covariance[possible])
    first = possible[np.argsort(-scores, kind="stable")[:maximum]]
    every = zip(sets.rotation[first], sets.position[first], spread.covariance[first], strict=True)
    there = [one for one in (propose_about(model, Gaussian(*each)) for each in every) if one is not None]
    return join_proposals(there) if there else None
