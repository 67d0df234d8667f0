"""From tables to a tensor: which hyper-edges are looked at, and what evaluates them."""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

from rootmatch.backends import selection
from rootmatch.backends.dask import Cluster
from rootmatch.backends.strongest import Backend
from rootmatch.errors import InputError
from rootmatch.hypergraph import enumeration as edges
from rootmatch.pipeline import validation
from rootmatch.problems.residual_dispatch import has_single
from rootmatch.samplers.base import SampledTensor, Sampler, SamplingTask
from rootmatch.samplers.completion import Completion
from rootmatch.samplers.exhaustive import exhaustive_tensor
from rootmatch.samplers.guided.sampler import Guided, pays
from rootmatch.samplers.random import random_tensor

Way = Literal["auto", "exhaustive", "random", "guided"]
WAYS: tuple[Way, ...] = ("auto", "exhaustive", "random", "guided")
PAPER_SAMPLES = 100_000
"""Random hyper-edges that are drawn unless told otherwise, as in the paper."""
EXHAUSTIVE_LIMIT, LIMIT_ON_DEVICE = 4_000_000_000, 100_000_000_000
"""Hyper-edges that are evaluated without asking: about a minute on two cores, and on a card."""
AFFORDABLE, PER_SEARCHED = 500_000_000, 20
"""Hyper-edges up to which all are looked at after all, some seconds of two cores, where a search has found nothing that
stands out in a twentieth of the evaluations, which take up to half the time: those of a sweep are far cheaper."""
CHEAP_ON_DEVICE = 1_000_000_000
"""Hyper-edges up to which a card has looked at all of them before a search has found its first."""


class Built(NamedTuple):
    """A tensor, and where it can be contracted."""

    weighed: SampledTensor
    backend: Backend


def build(
    request: SamplingTask,
    *,
    way: Way | Sampler = "auto",
    samples: int | None = None,
    backend: selection.Name = "auto",
    cluster: Cluster | None = None,
    max_hyperedges: int = 5_000_000,
    limit: int | None = None,
) -> Built:
    """Tensor of the hyper-edges that are looked at.

    Parameters
    ----------
    request : SamplingTask
    way : str or Sampler
        See `rootmatch.match`, where all that follows is explained too.
    samples, backend, max_hyperedges, limit
    cluster : Cluster, optional
        Workers that evaluate in the place of this process.

    Raises
    ------
    InputError
        If it is too much, or what is asked for does not go together or is not there.
    """
    n, n_target = request.shape
    count = request.hyperedge_count
    chosen: Any = way
    single = has_single(request.tables, request.kind)
    searched = 0
    if cluster is not None:
        chosen = _for_workers(way, backend)
    elif way == "auto" and request.motions != 1 and Completion().pays(request):
        chosen = Completion()
    elif way == "auto" and pays(request):
        chosen = "exhaustive" if backend in selection.ON_CARD and count <= CHEAP_ON_DEVICE else "guided"
    affordable = AFFORDABLE if limit is None else min(AFFORDABLE, limit)
    after_all = way == "auto" and request.motions == 1 and count <= affordable
    if chosen == "guided":
        chosen = Guided(budget=max(int(count) // PER_SEARCHED, 1)) if after_all else Guided()
    if callable(chosen):
        here = selection.chosen(backend, 0.0, single)
        weighed = chosen(request)
        if weighed.conclusive or not after_all:
            return Built(weighed, here)
        searched = weighed.evaluated
    if chosen == "random":
        count = PAPER_SAMPLES if samples is None else int(samples)
    evaluator = selection.chosen(backend, count, single) if cluster is None else cluster
    asked = request.tables, request.kind, request.affinity, request.shape, request.order
    if chosen == "random":
        tensor, evaluated = random_tensor(
            *asked, int(count), request.seed,
            candidates=request.candidates, backend=evaluator, progress=request.progress,
        )  # fmt: skip
        # a random sample sees each hyper-edge with this probability
        share = -math.expm1(-evaluated / edges.exhaustive_count(n, n_target, request.order))
        return Built(SampledTensor(tensor, evaluated, share), evaluator)
    most = LIMIT_ON_DEVICE if selection.is_device(evaluator) else EXHAUSTIVE_LIMIT
    validation.check_size(n, n_target, count, most if limit is None else limit)
    tensor, evaluated = exhaustive_tensor(
        *asked,
        max_hyperedges=max_hyperedges, candidates=request.candidates, backend=evaluator, progress=request.progress,
    )  # fmt: skip
    return Built(SampledTensor(tensor, evaluated + searched), evaluator)


def _for_workers(way: Way | Sampler, backend: selection.Name) -> Way:
    """Which hyper-edges go to a cluster's workers: all, or random ones."""
    if backend in selection.ON_CARD:
        raise InputError(
            f'scheduler: its workers compute on processors; leave backend="{backend}" out, or go without it'
        )
    if way == "random":
        return way
    if way in ("auto", "exhaustive"):
        return "exhaustive"
    raise InputError('scheduler: a guided search runs in one process; use hyperedges="exhaustive" or "random"')
