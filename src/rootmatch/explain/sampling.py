"""Sampling: select the hyper-edges of a task, evaluate them on a backend, and make the affinity tensor.

While variants of a task of a rig are tried, what was found in each camera is kept: most mistakes about a rig are about
where its cameras are, or in which unit, and what each camera shows by itself is the same before and after.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from rootmatch.backends import cpu, selection
from rootmatch.backends.dask import Cluster
from rootmatch.deadline import Deadline, OutOfTime
from rootmatch.errors import InputError, quote_value
from rootmatch.explain.image_hypotheses import make_detection_model
from rootmatch.explain.task import RESERVE, SAMPLED, MatchingTask
from rootmatch.explain.validation import check_size
from rootmatch.hypergraph.affinity import NOISE_KINDS
from rootmatch.hypergraph.deferred_tensor import DeferredTensor, keep_strongest, renumber_tensor
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.model.evidence import max_log_evidence
from rootmatch.problems import residual_kinds
from rootmatch.problems.capabilities import Capability
from rootmatch.problems.p3p import P3P
from rootmatch.problems.residual_dispatch import has_single
from rootmatch.problems.up2p import UP2P
from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.completion import Completion
from rootmatch.samplers.exhaustive import exhaustive_tensor
from rootmatch.samplers.guided.sampler import Guided, is_quick, pays, searches_focal_lengths
from rootmatch.samplers.limits import LIMITS
from rootmatch.samplers.point_sets.congruent import is_small
from rootmatch.samplers.random import random_tensor

PAPER_SAMPLES = 100_000
"""Random hyper-edges drawn unless said otherwise, as in the paper."""
INDEXED = 0.5
"""Share of a solver's deadline for its pass over all hyper-edges."""
SECONDS_PER_HYPEREDGE = 1e-6
"""Of that, at most (benchmarks/solvers.py)."""
RELATIVE = 1e-9
"""Difference of two models, in parts of their size, that is rounding."""
OF_IMAGE = "target", "target_noise", "target_covariance", "normals", "view_cosine"
"""What tells beside the points whether two searches of one camera are the same."""
MAX_MORE = 3
"""Most detections beyond a minimal set that may be too few for any pose: more hardly ever are. A round value."""


def sample(task: MatchingTask) -> SampledTensor:
    """The tensor of the hyper-edges that are evaluated, source points in the caller's order.

    Raises `InputError` if there are too many, or options do not go together or are not available.
    """
    try:
        with task.deadline.part(SAMPLED, RESERVE).enforce():
            sampled, backend = _sample_tensor(task)
    except OutOfTime:
        nothing = AffinityTensor.unchecked(np.empty((0, task.problem.order), np.int32), np.empty(0), task.shape)
        sampled, backend = SampledTensor(nothing, 0, conclusive=False, partial=True, missed=1.0, unmet=1.0), cpu
    tensor = sampled.tensor
    if task.problem.small_baseline > 0.0:
        tensor = _weigh_baseline(task, tensor)
    assignments = sampled.assignments
    if assignments is not None:
        assignments = np.ascontiguousarray(assignments[:, np.argsort(task.permutation)])
    if isinstance(tensor, DeferredTensor) and not selection.is_device(backend):
        made = tensor
        tensor = DeferredTensor.of(lambda: _restore_order(task, made), task.shape, task.weights)
    else:
        tensor = selection.place_tensor(_restore_order(task, tensor), backend)
    return sampled._replace(tensor=tensor, assignments=assignments)


def make_sweep(task: MatchingTask, sampled: SampledTensor) -> MatchingTask | None:
    """The task with all hyper-edges, if a quick search led to an untrusted match and no budget is set; else None."""
    if not sampled.partial or task.budget is not None or not _is_searched_first(task) or task.deadline.passed():
        return None
    return replace(task, options=replace(task.options, sampler="exhaustive"))


def keep_affordable(tensor: AffinityTensor, deadline: Deadline) -> AffinityTensor:
    """The strongest hyper-edges of a tensor, as many as a solver can process by its deadline."""
    return keep_strongest(tensor, deadline.part(INDEXED).cut(tensor.size, SECONDS_PER_HYPEREDGE))


def _sample_tensor(task: MatchingTask) -> tuple[SampledTensor, Any]:
    """The sampled tensor, and the backend that can contract it."""
    options, sampling = task.options, task.sampling_task
    single = has_single(task.tables, sampling.kind)
    if options.backend == "cuda-float32":
        Capability.SINGLE_PRECISION.require(single, task.problem.name)
    sampler, fallback = choose_sampler(task)
    searched = 0
    if callable(sampler):
        sampled = sampler(sampling)
        if not isinstance(sampled, SampledTensor):
            raise InputError(
                f"sampler: {sampler!r} returned {type(sampled).__name__}; a sampler returns a "
                "rootmatch.samplers.base.SampledTensor"
            )
        _check_tensor(sampler, sampled.tensor, sampling)
        if sampled.conclusive or not fallback or sampling.deadline.passed():
            return sampled, selection.choose_backend(options.backend, 0.0, single)
        searched = sampled.evaluated
    sizes = sampling.tables, sampling.kind, sampling.affinity, sampling.shape, sampling.order
    run: Any = {name: getattr(sampling, name) for name in ("candidates", "progress", "deadline")}
    if sampler == "random":
        samples = PAPER_SAMPLES if options.samples is None else int(options.samples)
        maximum = LIMITS.random if options.max_evaluations is None else options.max_evaluations
        if samples > maximum:
            raise InputError(
                f"samples: {samples:.3g} given, above the limit of {maximum:.3g}; give fewer, or raise max_evaluations="
            )
        backend = _choose_backend(task, samples, single)
        tensor, evaluated = random_tensor(*sizes, samples=samples, seed=sampling.seed, backend=backend, **run)
        # hyper-edges that were not drawn are not assumed to agree: a score counts as found
        return SampledTensor(tensor, evaluated), backend
    backend = _choose_backend(task, sampling.sweep_cost, single)
    maximum = LIMITS.exhaustive_on_device if selection.is_device(backend) else LIMITS.exhaustive
    maximum = maximum if options.max_evaluations is None else options.max_evaluations
    check_size(task.shape, sampling.sweep_cost, maximum)
    tensor, evaluated = exhaustive_tensor(*sizes, max_hyperedges=options.max_hyperedges, backend=backend, **run)
    return SampledTensor(tensor, evaluated + searched), backend


def _check_tensor(sampler: Any, tensor: Any, sampling: SamplingTask) -> None:
    """Refuse a caller's tensor of other points, or of another order; those of this package may be deferred."""
    if isinstance(tensor, DeferredTensor):
        return
    given = (tensor.shape, tensor.order) if isinstance(tensor, AffinityTensor) else (type(tensor).__name__, "none")
    if given != (sampling.shape, sampling.order):
        raise InputError(
            f"sampler: {quote_value(sampler)} returned a tensor of shape {given[0]} and order {given[1]}; give an "
            f"AffinityTensor of shape {sampling.shape} and order {sampling.order}, as the task has"
        )


def choose_sampler(task: MatchingTask) -> tuple[Any, bool]:
    """The sampler of a task, "exhaustive" and "random" by name, and whether a sweep follows if it finds nothing."""
    options, sampling = task.options, task.sampling_task
    sampler: Any = options.chosen_sampler
    if options.scheduler is not None:
        return _choose_for_workers(sampler, options.backend), False
    automatic = sampler == "auto"
    by_poses, clouds = _is_decided_by_poses(task), sampling.clouds
    # The model of views or of large point sets judges what a search proposes, however few the hyper-edges are: the
    # score of all of them names worse assignments. Of 79 pairs of a robot on a floor with seven points and more in both
    # images 45 were trusted then, and 74 with the search, none wrong (seeds from 1000).
    proposes = by_poses and (sampling.views is not None or (clouds is not None and not is_small(clouds)))
    if automatic and task.budget is not None:
        searched = pays(sampling) or is_quick(sampling) or proposes
        return (make_guided(budget=task.budget) if searched else "exhaustive"), False
    affordable = LIMITS.affordable
    if options.max_evaluations is not None:
        affordable = min(affordable, options.max_evaluations)
    fallback = automatic and options.motions == 1 and sampling.sweep_cost <= affordable
    # to the model of two point sets other hyper-edges tell nothing
    fallback = fallback and not searches_focal_lengths(sampling) and not (by_poses and clouds is not None)
    if automatic and options.motions != 1 and Completion().pays(sampling):
        return Completion(), fallback
    if (fallback and _is_searched_first(task)) or (automatic and proposes):
        sampler = "guided"
    elif automatic and pays(sampling):
        on_device = options.backend in selection.ON_CARD and sampling.sweep_cost <= LIMITS.cheap_on_device
        sampler = "exhaustive" if on_device else "guided"
    bounds = {"budget": max(int(sampling.sweep_cost) // LIMITS.per_searched, LIMITS.quick)} if fallback else {}
    return (make_guided(**bounds) if sampler == "guided" else sampler), fallback


@lru_cache(maxsize=32)
def make_guided(**options: Any) -> Guided:
    """The guided search with some options: frame after frame the same, and checking them takes 0.1 ms."""
    return Guided(**options)


def _is_searched_first(task: MatchingTask) -> bool:
    """Whether a quick search precedes a sweep that is itself cheap: yes if poses judge the result."""
    options = task.options
    default = options.chosen_sampler == "auto" and options.solver is None and options.scheduler is None
    in_noise = task.affinity.residual.kind in NOISE_KINDS
    return default and in_noise and options.backend not in selection.ON_CARD and is_quick(task.sampling_task)


def _is_decided_by_poses(task: MatchingTask) -> bool:
    """Whether poses judge the result, where a search can find them."""
    options = task.options
    default = options.solver is None and options.backend not in selection.ON_CARD
    return default and task.affinity.residual.kind in NOISE_KINDS and options.motions == 1


def _choose_for_workers(sampler: Any, backend: selection.Name) -> str:
    """Which hyper-edges go to a cluster's workers: all, or random ones."""
    if backend in selection.ON_CARD:
        raise InputError(f'scheduler: its workers compute on CPUs; leave backend="{backend}" out, or go without it')
    if sampler == "random":
        return "random"
    if sampler in ("auto", "exhaustive"):
        return "exhaustive"
    raise InputError('scheduler: a guided search runs in one process; use sampler="exhaustive" or "random"')


def _choose_backend(task: MatchingTask, count: float, single: bool) -> Any:
    """The backend for so many hyper-edges."""
    if task.options.scheduler is None:
        return selection.choose_backend(task.options.backend, count, single)
    return Cluster(task.options.scheduler, partial(task.problem.tables, task.ordered_points))


def _weigh_baseline(task: MatchingTask, tensor: AffinityTensor) -> AffinityTensor:
    """The tensor with the prior of views from nearly one position."""
    source, target = np.divmod(tensor.indices.astype(np.int64), task.shape[1])
    raw = cpu.residuals(task.tables, residual_kinds.QR(), source, target)
    weights = tensor.weights * np.exp(-raw / task.problem.small_baseline)
    keep = weights >= math.exp(-0.5 * task.affinity.gate**2)
    return AffinityTensor.unchecked(tensor.indices[keep], weights[keep], tensor.shape)


def _restore_order(task: MatchingTask, tensor: AffinityTensor) -> AffinityTensor:
    """The tensor as the caller has it: its strongest hyper-edges by the points' order, and the prior of candidates."""
    kept = keep_strongest(tensor, task.options.max_hyperedges)
    return renumber_tensor(kept, (task.permutation, np.arange(tensor.shape[1])), tensor.shape, task.weights)


def sample_once(task: MatchingTask) -> SampledTensor:
    """As `sample`; what was found for the same image, points of the same shape and the same options, if it is kept."""
    if task.kept_searches is None:
        return sample(task)
    for other, found in task.kept_searches:
        if _is_same_search(task, other):
            return found
    found = sample(task)
    task.kept_searches.append((task, found))
    return found


def _is_same_search(first: MatchingTask, second: MatchingTask) -> bool:
    """Whether two tasks of one camera differ in the unit of the points alone, which no minimal set tells."""
    own, other = first.points, second.points
    if any(one.has_prior or one.points.source_covariance is not None for one in (first, second)):
        return False
    size = float(np.abs(own.source).max())
    unit = size / float(np.abs(other.source).max())
    return (
        own.source.shape == other.source.shape
        and bool((np.abs(own.source - unit * other.source) <= RELATIVE * size).all())
        and all(np.array_equal(getattr(own, name), getattr(other, name)) for name in OF_IMAGE)
        and all(np.array_equal(getattr(first, name), getattr(second, name)) for name in ("allowed", "weights"))
        and (first.options.seed, first.budget) == (second.options.seed, second.budget)
        and bool(first.problem == second.problem)
    )


def are_too_few(task: MatchingTask, log_share: float = 0.0) -> bool:
    """Whether chance is expected to bring a pose that is as good as any that the detections can tell.

    Every minimal set of points and detections has a pose, and the evidence of a pose comes by chance at most once in as
    many trials as it says. So what a search finds is not believed, the right pose or another. ``log_share``: logarithm
    of the prior probability of the poses that are searched.
    """
    (n, n_target), minimal = task.shape, task.minimal
    alone = task.rig is None and task.bodies is None and not task.has_prior and task.weights is None
    # with normals most sets cannot be seen together, and nobody has counted the others
    if not alone or task.points.normals is not None or not isinstance(task.problem, P3P | UP2P):
        return False
    if not minimal < min(n, n_target) <= minimal + MAX_MORE or task.options.packs_motions:
        return False
    share = 1.0 if task.allowed is None else float(np.mean(task.allowed))
    if share == 0.0:
        return False
    sets = math.log(math.comb(n, minimal)) + math.log(math.perm(n_target, minimal)) + minimal * math.log(share)
    return max_log_evidence(make_detection_model(task), minimal) + log_share < sets
