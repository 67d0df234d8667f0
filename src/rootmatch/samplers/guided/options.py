"""Options of the guided search; those of each of its algorithms stand beside the algorithm."""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.jit.threads import threads_worth
from rootmatch.options import Options, option
from rootmatch.samplers.guided.detection_grid import GridOptions
from rootmatch.samplers.guided.hypothesis_clustering import ClusteringOptions
from rootmatch.samplers.guided.local_options import LocalOptions
from rootmatch.samplers.guided.minimal_sets import MinimalSetOptions
from rootmatch.samplers.guided.sequential_test import SequentialTestOptions
from rootmatch.samplers.guided.stopping import StoppingOptions
from rootmatch.samplers.guided.verification import VerificationOptions
from rootmatch.samplers.guided.visibility import VisibilityOptions
from rootmatch.samplers.point_sets.options import PointSetOptions
from rootmatch.samplers.two_views.options import TwoViewOptions

__all__ = [
    "BatchOptions",
    "ClusteringOptions",
    "GridOptions",
    "GuidedOptions",
    "LocalOptions",
    "MinimalSetOptions",
    "PointSetOptions",
    "RefinementOptions",
    "SequentialTestOptions",
    "StoppingOptions",
    "TwoViewOptions",
    "VerificationOptions",
    "VisibilityOptions",
]


@dataclass(frozen=True)
class BatchOptions(Options):
    """How the work of a search is divided; its cost is measured in benchmarks/guided.py and benchmarks/matches.py."""

    first: int = option(8_000, least=1)
    """Minimal sets solved before the first look at what was found; each batch is twice the one before. Not tuned."""
    start: int = option(2_000, least=1)
    """Minimal sets solved before the first look, for one motion without normals. Not tuned."""
    growth: float = option(0.25, above=0.0)
    """Minimal sets of its next batch over all before, if that is more than the last: the right set comes at a random
    time, and a batch is finished first. A tenth to a half fewer evaluations than batches of 8,000 and twice the one
    before (benchmarks/matches.py, 20 seeds)."""
    largest: int = option(400_000, least=1)
    """Minimal sets of the largest batch. A round value, not tuned."""
    chunks: int = option(8, least=1)
    """Parts of a batch, whatever the number of threads, so that the result does not depend on it. Not tuned."""
    least_kept_per_chunk: int = option(8, least=1)
    """Survivors of the sequential test that a chunk keeps at the least. A round value, not tuned."""
    chunk_surplus: float = option(2.0, least=1.0)
    """A chunk keeps so many times its equal share of the survivors that are verified: some chunks have more of the
    best. A round value, not tuned."""
    sets_per_thread: int = option(4_000, least=1)
    """Minimal sets that are worth waking a thread for, about half a millisecond. Changes no result."""
    least_verified: int = option(32, least=1)
    """Survivors of a batch that are verified, at least, for one motion. A round value, not tuned."""
    sets_per_verified: int = option(500, least=1)
    """Minimal sets solved for each further one, for one motion. A round value, not tuned."""
    sets_per_verified_with_normals: int = option(2_000, least=1)
    """Minimal sets, those not solved for their shape among them, for each further one where normals tell more. A round
    value."""
    least_verified_of_many: int = option(1_024, least=1)
    """Survivors that are verified with several motions, whose few points hardly stand out before. Not tuned."""
    sets_per_verified_of_many: int = option(20, least=1)
    """Minimal sets solved for each further one, with several motions. A round value, not tuned."""
    fair_part: float = option(0.5, least=0.0, most=1.0)
    """Fraction of the ratio of a batch's best survivor, for one motion, below which others are not verified where that
    one is beyond chance. A round value; that nothing else is found: benchmarks/record.py."""
    remembered: int = option(4_000, least=1)
    """Hypotheses that are kept from batch to batch. A round value, not tuned."""
    most_batches: int = option(16, least=1)
    """Batches whose hypotheses are kept apart until they are joined and the weakest forgotten. A round value."""

    def kept_of(self, solved: int, single: bool) -> tuple[int, int, int]:
        """Survivors to verify, survivors that a chunk keeps, and threads, for ``solved`` minimal sets."""
        if single:
            # of a batch smaller than the first one of other searches, as many in proportion
            least = min(self.least_verified, solved * self.least_verified // self.first + 1)
            most = max(least, solved // self.sets_per_verified)
        else:
            most = max(self.least_verified_of_many, solved // self.sets_per_verified_of_many)
        keep = max(self.least_kept_per_chunk, int(most * self.chunk_surplus / self.chunks))
        return most, keep, threads_worth(solved // self.sets_per_thread)


@dataclass(frozen=True)
class RefinementOptions(Options):
    """How the best clusters are refined; what is found is measured in benchmarks/guided.py."""

    clusters: int = option(8, least=1)
    """Clusters that are solved anew from their own correspondences, at least, when none is beyond chance. Not tuned."""
    cluster_part: float = option(0.25, least=0.0, most=1.0)
    """Fraction of the clusters that is solved anew then, if that is more. A round value, not tuned."""
    sets: int = option(8, least=1)
    """Minimal sets solved anew of each cluster. A round value, not tuned."""
    sure_sets: int = option(4, least=1)
    """Minimal sets solved anew of a cluster beyond chance, for one motion of few points without normals: it mostly
    grows no more. Half of `sets`; it finds the same matches in benchmarks/record.py and benchmarks/matches.py."""
    rival: float = option(0.9, above=0.0, most=1.0)
    """Fraction of the detections of the best hypothesis that a rival, as probable as it is, explains at least. A round
    value."""
    rival_lacks: int = option(3, least=0)
    """Most detections of the best hypothesis that a rival may lack, however many there are: of a hundred, ten fewer are
    never as probable. A round value."""
    rival_missed: float = option(0.08, above=0.0, most=1.0)
    """Probability of having missed such a rival at which none is looked for any more, where all points are seen: two
    minimal sets in every arrangement of those detections. Of an object that shows a k-th of its points, its k-th power:
    with less of it, four in six shuffles of a headset without normals were another side. A round value;
    `tests/test_guided.py` has such objects."""
    rival_ratio: float = option(0.25, least=0.0, most=1.0)
    """Fraction of the likelihood ratio of the best hypothesis, in the same sequential test, that a rival has at least
    to be verified. A round value, half of `rival_evidence`, as a minimal set may predict worse than another."""
    lag: float = option(15.0, above=0.0)
    """Evidence below the highest at which an assignment is not fitted any more: on the development seeds of
    benchmarks/constellations.py what turned out the most probable lagged by at most 7."""
    rival_evidence: float = option(0.5, least=0.0, most=1.0)
    """Fraction of the highest evidence from which another hypothesis is a rival. A round value, not tuned."""


@dataclass(frozen=True)
class GuidedOptions(Options):
    """How hard the guided search looks for hypotheses.

    Parameters
    ----------
    budget : int
        Most evaluations: minimal sets solved and points looked up. A search that finds something beyond chance ends
        long before; one that does not, ends here or when every minimal set was tried. Half a minute of two cores;
        not tuned.
    max_seconds : float, optional
        Time after which no new batch begins. What is found then depends on the machine.
    groups : int
        Most clusters of hypotheses whose hyper-edges are evaluated. A round value, not tuned.
    gate : float
        Distance from a prediction, in σ, within which a detection counts while minimal sets are tried; wide, as it
        also covers the errors of the minimal set. A round value; what is found: benchmarks/guided.py.
    subsets : int
        Most d-subsets of source points whose hyper-edges are evaluated; a seeded selection of more: every point of a
        hundred is still in 150 to 200 of them. A round value; the accuracy with it: benchmarks/matches.py.
    edges : int
        Most hyper-edges that are evaluated, those of the strongest clusters. A round value, not tuned.
    surplus : float
        Drawn d-subsets for each that is used, as some are drawn twice or repeat a point. A round value.
    hypotheses : int
        Most assignments that are handed on beside the hyper-edges, to be fitted by a pose each. A round value.
    chance_samples : int
        Random hyper-edges that estimate the mean weight by chance. Evaluated in half a millisecond; not tuned.
    stopping, test, sets, verification, clustering, refinement, batches, grid, visibility, local
        Options of the parts; see their classes.
    point_sets : PointSetOptions
        Options of the search between two point sets of one space, which takes the place of all parts above.
    views : TwoViewOptions
        Options of the search between two views, which takes the place of all parts above.
    """

    budget: int = option(500_000_000, above=0)
    max_seconds: float | None = option(None, least=0.0)
    groups: int = option(1000, above=0)
    gate: float = option(8.0, above=0.0)
    subsets: int = option(5_000, above=0)
    edges: int = option(300_000, above=0)
    surplus: float = option(1.5, least=1.0)
    hypotheses: int = option(200, least=1)
    chance_samples: int = option(4096, above=0)
    stopping: StoppingOptions = option(StoppingOptions())
    test: SequentialTestOptions = option(SequentialTestOptions())
    sets: MinimalSetOptions = option(MinimalSetOptions())
    verification: VerificationOptions = option(VerificationOptions())
    clustering: ClusteringOptions = option(ClusteringOptions())
    refinement: RefinementOptions = option(RefinementOptions())
    batches: BatchOptions = option(BatchOptions())
    grid: GridOptions = option(GridOptions())
    visibility: VisibilityOptions = option(VisibilityOptions())
    local: LocalOptions = option(LocalOptions())
    point_sets: PointSetOptions = option(PointSetOptions())
    views: TwoViewOptions = option(TwoViewOptions())
