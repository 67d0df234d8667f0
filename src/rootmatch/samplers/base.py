"""The sampler protocol: a sampler selects hyper-edges of a `SamplingTask` and returns a `SampledTensor`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.backends.strongest import Progress
from rootmatch.deadline import NEVER, Deadline
from rootmatch.hypergraph import enumeration
from rootmatch.hypergraph.affinity import Affinity
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems import residual_kinds
from rootmatch.problems.points import PointClouds, TwoViews


@dataclass(frozen=True, eq=False)
class SamplingTask:
    """What a sampler is given: the prepared points of a problem, and which correspondences are possible."""

    tables: Any
    """Tables of `Problem.prepare`, noise included; source points are best in the order of `farthest_point_order`."""
    kind: residual_kinds.Kind
    """Kind of residual; its type selects the kernel."""
    affinity: Affinity
    """Tells the weight of a residual, and the gate beyond which a hyper-edge is dropped."""
    shape: tuple[int, int]
    """Number of source and target points, (n, n')."""
    order: int
    """Correspondences of a hyper-edge, d: one more than a minimal set has."""
    seed: int = 0
    """Seed of everything random."""
    motions: int | Literal["auto"] = 1
    """Number of rigid motions to look for; "auto" for any number."""
    candidates: Bools | None = None
    """(n, n') possible correspondences, others are never tried; None for all."""
    progress: Progress | None = None
    """Called now and then with (done, total), in units of the sampler's own."""
    view_cosine: Floats | None = None
    """(n,) least cosine between normal and direction to the camera at which a point is visible, where given."""
    clouds: PointClouds | None = None
    """Both point sets, where the problem is the motion between two of one space."""
    deadline: Deadline = NEVER
    """Time at which the search returns what it has found."""
    views: TwoViews | None = None
    """Both images, where the problem is one of two views whose relative poses can be searched."""
    at_focal_lengths: Callable[[], list[Any]] | None = None
    """Tables of the same points for the kernels of a camera of known focal length, at each of some focal lengths, where
    the problem is one of a camera whose focal length is unknown."""
    without_vertical: Callable[[], Any] | None = None
    """Tables of the same points for the kernels of `P3P`, where the problem is one of a measured vertical."""
    problem: str = "the problem"
    """Name of the problem, for messages."""
    found_before: Integers | None = None
    """(K, n) assignments that are tried first, as one of them is probably right; None for none."""
    more_images: bool = False
    """Whether images of the same points follow, so that what all of them need is prepared at once."""

    @property
    def allowed(self) -> Bools:
        """The candidates as kernels take them: (n, n'), or (0, 0) where all are possible."""
        if self.candidates is None:
            return np.empty((0, 0), np.bool_)
        return np.ascontiguousarray(self.candidates, np.bool_)

    @property
    def sweep_cost(self) -> float:
        """What an exhaustive search costs, in hyper-edges: their number, but for a mask of few pairs."""
        return enumeration.sweep_cost(*self.shape, self.order, self.candidates)


class SampledTensor(NamedTuple):
    """The tensor of the hyper-edges that a sampler selected, and how it was sampled."""

    tensor: AffinityTensor
    """The selected hyper-edges whose residual is below the gate."""
    evaluated: int
    """Evaluations in all: for a search, minimal sets solved, points looked up, predictions and hyper-edges."""
    coverage: float | Callable[[], float] = 1.0
    """Fraction of the hyper-edges inside a correct assignment that were evaluated, 0 to 1, or what tells it."""
    chance_weight: float | Callable[[], float] | None = None
    """Mean weight of a random hyper-edge, where known, or what estimates it: few assessments ask for it."""
    conclusive: bool = True
    """False for a search that ended without a hypothesis beyond chance: it spent its budget or tried everything."""
    partial: bool = False
    """Whether only the correspondences of hypotheses were evaluated, so that a small motion may be missing."""
    assignments: Integers | None = None
    """(K, n) assignments of a search's hypotheses, the highest evidence first; −1 for unmatched, None without any."""
    missed: float = 0.0
    """Probability that a pose which explains as much as the best one was never met."""
    unmet: float = 0.0
    """The same of a body that is in view for certain and shows enough, as far as it was searched for."""
    repeated: bool = False
    """Whether a pose with other matches than the best one is beyond chance, by more than the odds of a copy."""

    @property
    def share(self) -> float:
        """The coverage, estimated if it is not known."""
        return self.coverage() if callable(self.coverage) else self.coverage

    @property
    def chance(self) -> float | None:
        """Mean weight of a random hyper-edge, estimated if need be; None where it is not known."""
        return self.chance_weight() if callable(self.chance_weight) else self.chance_weight


class Sampler(Protocol):
    """Selects hyper-edges and evaluates them, such as `Guided`; `match` takes any."""

    def __call__(self, task: SamplingTask) -> SampledTensor:
        """Tensor of the selected hyper-edges whose residual is below the gate."""
        ...
