"""The guided sampler: search, then the hyper-edges among the correspondences of its hypotheses, evaluated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rootmatch.deadline import checkpoint
from rootmatch.problems.capabilities import Capability
from rootmatch.problems.points import PointClouds
from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.guided.candidate_hyperedges import sample_clusters
from rootmatch.samplers.guided.dispatch import has_hypotheses
from rootmatch.samplers.guided.focal_search import search_focal_lengths
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.refinement import verify_known
from rootmatch.samplers.guided.rivals import missed_rival_probability
from rootmatch.samplers.guided.search import Search
from rootmatch.samplers.guided.visible_search import choose_search
from rootmatch.samplers.limits import LIMITS
from rootmatch.samplers.point_sets.motion_search import MotionSearch
from rootmatch.samplers.two_views.pose_search import PoseSearch

VAGUE = 0.5
"""Noise of a vertical times the width of the detections, over the noise of one, from which triples are searched first,
and pairs only if nothing is beyond chance. With .6 half of all right pairs of a railway's masts are, with 1.7 a tenth,
and with 5.8 none (masts 50 m apart, seeds from 1000). A round value."""

SEARCHED, RESERVE, REFINED = 0.8, 0.2, 0.5
"""Shares of the time that is left at a deadline: of the search, all but so many seconds, and then of its second
sets."""
SECONDS_PER_PAIR = 1e-8
"""Of detections, that it takes at least to lay out the tables of a search."""
SEARCHED_VIEWS, RESERVE_OF_VIEWS, SEARCHED_SETS = 0.6, 0.3, 0.7
"""The share of a search of two views, all but so many seconds, and that of a search of two point sets."""
EDGES_OF_VIEWS = 60_000
"""Most hyper-edges of two views that are evaluated."""
CHANCE_SAMPLES = 100_000
"""Random hyper-edges of point sets that estimate the mean weight by chance: few agree in three constraints."""


def task_by_triples(task: SamplingTask) -> SamplingTask | None:
    """The task for a search by triples, if one by pairs may miss an object as wide as all detections; else None.

    An error of a vague vertical turns what a pair predicts about it, the more the farther away. A wide object then
    shows better where the vertical is than it was measured.
    """
    if task.without_vertical is None or task.motions != 1:
        return None
    rays = task.tables.rays
    width2 = float(((rays - rays.mean(axis=1, keepdims=True)) ** 2).sum(axis=0).mean())
    if float(task.tables.tilt_variance[0]) * width2 <= VAGUE**2 * float(np.median(task.tables.variance)):
        return None
    return replace(task, tables=task.without_vertical(), order=task.order + 1)


def pays(task: SamplingTask) -> bool:
    """Whether a guided search is possible and cheaper than an exhaustive sweep."""
    maximum = LIMITS.guided if task.motions == 1 else LIMITS.guided_multi_motion
    searched = task.clouds is not None or task.views is not None
    possible = searched or has_hypotheses(task.tables)
    return searches_focal_lengths(task) or (possible and task.sweep_cost > maximum)


def searches_focal_lengths(task: SamplingTask) -> bool:
    """Whether a camera of unknown focal length is searched at known ones, which finds all that a sweep would.

    Of 80 scenes with six of up to 14 points seen, all were trusted and right after the search alone, and 75 where a
    sweep took its place if it had found nothing beyond chance (`benchmarks/zoom.py`, hidden points, seeds from 1000).
    """
    return task.at_focal_lengths is not None and task.motions == 1


def is_quick(task: SamplingTask) -> bool:
    """Whether a search by poses is quicker than a sweep that is cheap itself, and may follow if need be."""
    by_poses = task.clouds is None and task.views is None and has_hypotheses(task.tables)
    return task.motions == 1 and by_poses and LIMITS.swept < task.sweep_cost <= LIMITS.guided


@dataclass(frozen=True)
class Guided(GuidedOptions):
    """Guided search: a sampler for `rootmatch.match` that evaluates the hyper-edges which hypotheses support.

    Its parameters are those of `rootmatch.samplers.guided.options.GuidedOptions`; a value outside its range raises
    `InputError`. The search forms hypotheses from minimal sets and tests them on the other points.
    """

    def __call__(self, task: SamplingTask) -> SampledTensor:
        """Tensor of the hyper-edges among the correspondences that hypotheses name.

        Parameters
        ----------
        task : SamplingTask
            Its seed is that of the order in which minimal sets are tried, and of the selection of hyper-edges where
            there are too many. With one motion the search ends when one hypothesis is beyond chance, with more when as
            many are. Progress is reported between batches as (evaluations, budget).

        Raises
        ------
        InputError
            If the problem's minimal sets make no hypotheses.
        """
        if task.clouds is not None:
            return sample_point_sets(task, task.clouds, self)
        if task.views is not None:
            return sample_two_views(task, self)
        if task.at_focal_lengths is not None and searches_focal_lengths(task):
            return search_focal_lengths(task, task.at_focal_lengths, self)
        Capability.GUIDED.require(has_hypotheses(task.tables), task.problem)
        by_triples = task_by_triples(task)
        search = self._run_search(task, by_triples or task)
        assignments = search.assignments() if search.single else None
        if by_triples is not None and assignments is not None and not search.is_beyond_chance():
            evaluated, search = search.evaluated, self._run_search(task, task)
            search.evaluated += evaluated
            assignments = np.concatenate([search.assignments(), assignments])
        if task.progress is not None:
            task.progress(self.budget, self.budget)  # most searches end long before
        clusters = search.clusters()

        # where a conclusive search knows no rivals a pose may decide alone, and nobody asks for hyper-edges
        alone = search.single and search.conclusive and len(clusters.evidence) == 1
        return sample_clusters(
            task, lambda: clusters, self, search.rng, search.evaluated,
            later=alone,
            deadline=task.deadline,
            conclusive=search.conclusive,
            assignments=assignments,
            missed=missed_rival_probability(search, search.missed),
            unmet=search.missed,
        )  # fmt: skip

    def _run_search(self, task: SamplingTask, searched: SamplingTask) -> Search:
        """The search of a task, at its end; ``searched``: the same by the same minimal sets, or by others."""
        checkpoint(SECONDS_PER_PAIR * searched.shape[1] ** 2)
        search = choose_search(searched, self, task.deadline.part(SEARCHED, RESERVE))
        with search.deadline.within():
            if task.found_before is not None:
                verify_known(search, task.found_before)
            search.run()
        with task.deadline.part(REFINED).within():
            search.refine()
        return search


def sample_two_views(task: SamplingTask, options: GuidedOptions) -> SampledTensor:
    """Tensor of the hyper-edges among the correspondences that relative poses name; see `Guided`."""
    deadline = task.deadline.part(SEARCHED_VIEWS, RESERVE_OF_VIEWS).at_most(options.max_seconds)
    search = PoseSearch(task, deadline, options.budget)
    with deadline.within():
        search.run()
    single, few = task.motions == 1, replace(options, edges=min(options.edges, EDGES_OF_VIEWS))
    return sample_clusters(
        task, search.clusters, few, search.rng, search.evaluated,
        # the poses are judged by themselves, and nobody may ask for hyper-edges
        later=single and bool(search.hypotheses),
        conclusive=search.conclusive,
        missed=search.missed if single else 0.0,
        repeated=single and search.repeated,
        assignments=search.assignments() if single else None,
    )  # fmt: skip


def sample_point_sets(task: SamplingTask, clouds: PointClouds, options: GuidedOptions) -> SampledTensor:
    """Tensor of the hyper-edges among the correspondences that motions name; see `Guided`."""
    deadline = task.deadline.part(SEARCHED_SETS).at_most(options.max_seconds)
    search = MotionSearch(task, clouds, deadline)
    with deadline.within():
        search.run(options.budget)
    sampled = sample_clusters(
        task, search.clusters, options, search.rng, search.evaluated,
        later=task.motions == 1,
        chance_samples=CHANCE_SAMPLES,
        conclusive=search.conclusive,
        assignments=search.assignments() if task.motions == 1 else None,
        missed=search.missed,
    )  # fmt: skip
    return sampled._replace(evaluated=sampled.evaluated + CHANCE_SAMPLES)
