"""Match frame after frame against one set of source points, as a tracker does."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.bodies import match_bodies
from rootmatch.cameras.rig import rig_of
from rootmatch.deadline import Deadline
from rootmatch.errors import InputError, UnseenPixelError
from rootmatch.hypergraph import enumeration
from rootmatch.match import solve
from rootmatch.pipeline.body_labels import Label, check_bodies
from rootmatch.pipeline.prior import Found
from rootmatch.pipeline.rig_task import copies_task, is_rig
from rootmatch.pipeline.task import OPTIONS, MatchingTask, MatchOptions
from rootmatch.pipeline.validation import check_problem
from rootmatch.predicted import UNCONFIRMED, empty_match, tried
from rootmatch.problems.base import Problem
from rootmatch.problems.capabilities import Capability
from rootmatch.problems.checks import as_points, check_normals, check_points, check_view_angle, repeated
from rootmatch.problems.points import PointSets
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.result import Match
from rootmatch.rigs import shown
from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.guided.sampler import Guided, pays
from rootmatch.samplers.small_sweep import SMALL, SmallSweep


@dataclass(frozen=True)
class BoundedSearch:
    """A sampler that spends a bounded number of evaluations, or sweeps where that is cheaper."""

    budget: int
    sweep: SmallSweep

    def __call__(self, task: SamplingTask) -> SampledTensor:
        """See `rootmatch.samplers.base.Sampler`."""
        return Guided(budget=self.budget)(task) if pays(task) else self.sweep(task)


class Matcher:
    """`rootmatch.match` for many images of the same source points.

    The source is checked once, the enumerations of a small problem are kept from frame to frame, and nothing waits for
    other threads where one is enough: five markers against eight detections take a few milliseconds. Kernels are
    compiled when a frame first needs them: call `rootmatch.warmup` before the first frame where none may wait.

    Parameters
    ----------
    source : (n, 3) or (n, 2) array
        Points in space in any frame and unit, or pixels of the first image.
    problem : Problem
    noise : float or (n',) array
        Standard deviation of a pixel coordinate, in pixels, unless `match` is given another.
    **options
        Of `rootmatch.match`: normals, view_angle, bodies, seed, residual, solver, hyperedges, motions, and so on.

    Raises
    ------
    InputError
        If the source cannot be used.
    """

    def __init__(
        self,
        source: ArrayLike,
        problem: Problem,
        *,
        noise: ArrayLike | Literal["auto"] = 1.0,
        normals: ArrayLike | None = None,
        view_angle: ArrayLike | None = None,
        bodies: ArrayLike | None = None,
        **options: Any,
    ) -> None:
        for name in options:
            if name in ("target", "candidates", "prior"):
                raise InputError(f"Matcher: {name} belongs to a frame; give it to match()")
            if name not in OPTIONS:
                raise InputError(f"Matcher: no option {name!r}; the options are {', '.join(sorted(OPTIONS))}")
        check_problem(problem)
        problem = problem.for_points(source)
        alone = bodies is None
        self.source = check_points(source, problem.source_dimension, "source", problem.order, distinct=alone).copy()
        self.problem = problem
        self.noise = noise
        if normals is not None:
            Capability.NORMALS.require(problem.takes_normals, problem.name)
        self.normals = None if normals is None else check_normals(normals, len(self.source)).copy()
        check_view_angle(view_angle, normals, len(self.source))
        self.view_angle = view_angle
        if bodies is not None:
            check_bodies(bodies, self.source, problem.order)
        self.bodies = bodies
        self.options = MatchOptions(**options)
        self._sweep = SmallSweep()

    def match(
        self,
        target: ArrayLike,
        *,
        noise: ArrayLike | Literal["auto"] | None = None,
        candidates: ArrayLike | None = None,
        prior: Pose | Mapping[Label, Pose] | None = None,
        max_seconds: float | None = None,
    ) -> Match:
        """The match of one frame.

        Parameters
        ----------
        target : (n', 2) array
            Pixels, in any order, clutter among them; n' may change from frame to frame.
        noise : float, (n',) array or "auto", optional
            Of this frame.
        candidates : (n, n') array, optional
            Possible correspondences or prior weights, say from the frame before.
        prior : Pose or dict, optional
            Predicted pose of this frame, see `rootmatch.match`; `rootmatch.Tracker` makes them.
        max_seconds : float, optional
            Of this frame; see `rootmatch.match`.

        Returns
        -------
        Match
            Empty, untrusted, and with the reason as its advice where there are too few detections for one hyper-edge,
            one comes twice, or one lies where the lens model shows nothing: a loop over frames goes on.

        Raises
        ------
        InputError
            As `rootmatch.match`.
        """
        started = time.perf_counter()
        detections = as_points(self.problem.joined(target), self.problem.target_dimension, "target")
        fault = self._fault(detections, 1 if prior is not None and self.bodies is None else self.problem.order)
        if fault is not None:
            return self._empty(detections, fault, started)
        options = self.options if max_seconds is None else replace(self.options, max_seconds=max_seconds)
        task = MatchingTask.of(
            self.problem,
            self.source,
            target,
            noise=self.noise if noise is None else noise,
            normals=self.normals,
            view_angle=self.view_angle,
            candidates=candidates,
            bodies=self.bodies,
            prior=prior,
            options=options,
            deadline=Deadline(options.max_seconds, started=started),
        )
        if self.bodies is None and self._sweeps(task):
            task = replace(task, options=replace(options, hyperedges=self._sweep))
        try:
            return solve(task, started)
        except UnseenPixelError as error:
            return self._empty(detections, str(error), started)

    def follow(
        self,
        target: ArrayLike,
        prior: Pose | Mapping[Label, Pose] | None,
        noise: ArrayLike | None = None,
        max_seconds: float | None = None,
        searching: bool = True,
        budget: int | None = None,
    ) -> Match:
        """`match` for a tracker, which may bound its search.

        Unless ``searching``, a prediction that does not decide leaves an empty match. ``budget``: evaluations of a
        guided search.
        """
        if searching:
            before = self.options
            if budget is not None and before.sampler == "auto" and before.scheduler is None:
                # a rig searches each of its cameras
                of_rig = rig_of(self.problem) is not None
                bounded = Guided(budget=budget) if of_rig else BoundedSearch(budget, self._sweep)
                self.options = replace(before, hyperedges=bounded)
            try:
                return self.match(target, noise=noise, prior=prior, max_seconds=max_seconds)
            finally:
                self.options = before
        if self.bodies is None:
            assert isinstance(prior, Pose)
            return self.tried(target, prior, noise)[0]
        return self._of_frame(target, prior, noise, lambda task: _as_copies(task, _bodies_not_searched))

    def tried(self, target: ArrayLike, prior: Pose, noise: ArrayLike | None = None) -> tuple[Match, Found | None]:
        """What a predicted pose of the only body finds, and its match, which is untrusted unless that is believed."""
        known: list[Found | None] = [None]

        def find(task: MatchingTask) -> Match:
            match, known[0] = tried(task)
            return match

        return self._of_frame(target, prior, noise, lambda task: _as_copies(task, find)), known[0]

    def _of_frame(
        self,
        target: ArrayLike,
        prior: Pose | Mapping[Label, Pose] | None,
        noise: ArrayLike | None,
        find: Callable[[MatchingTask], Match],
    ) -> Match:
        """The match of a frame that is not searched."""
        started = time.perf_counter()
        detections = as_points(self.problem.joined(target), self.problem.target_dimension, "target")
        fault = self._fault(detections, 1)
        if fault is not None:
            return self._empty(detections, fault, started)
        task = MatchingTask.of(
            self.problem,
            self.source,
            target,
            noise=self.noise if noise is None else noise,
            normals=self.normals,
            view_angle=self.view_angle,
            bodies=self.bodies,
            prior=prior,
            options=self.options,
        )
        try:
            found = find(task)
        except UnseenPixelError as error:
            return self._empty(detections, str(error), started)
        return replace(found, seconds=time.perf_counter() - started)

    def _fault(self, detections: NDArray[np.float64], least: int) -> str | None:
        """What is wrong with the detections of a frame that may come of any detector; None where nothing is."""
        if detections.size == 0:
            return f"no detections given, at least {self.problem.order} needed for one hyper-edge"
        if detections.ndim != 2 or detections.shape[1] != self.problem.target_dimension:
            return None  # no frame: `rootmatch.match` says what it is
        if len(detections) < least:
            return f"{len(detections)} detections given, at least {self.problem.order} needed for one hyper-edge"
        same = repeated(detections)
        return None if same is None else f"detections {same[0]} and {same[1]} are the same; keep one of them"

    def _empty(self, detections: NDArray[np.float64], fault: str, started: float) -> Match:
        """The match of such a frame."""
        detections = detections.reshape(-1, self.problem.target_dimension)
        n, n_target = len(self.source), len(detections)
        noise = math.nan if isinstance(self.noise, str) else self.noise
        points = PointSets(self.source, detections, np.full(n, math.nan), np.full(n_target, math.nan), self.normals)
        task = MatchingTask(self.problem, points, self.options.affinity(self.problem), self.options, noise=noise)
        found = _as_copies(task, lambda task: empty_match(task, fault))
        return replace(found, seconds=time.perf_counter() - started)

    def _sweeps(self, task: MatchingTask) -> bool:
        """Whether all hyper-edges of a frame are few enough for the calling thread alone."""
        if is_rig(task):
            return False  # cameras are swept one by one
        count = enumeration.exhaustive_count(*task.shape, self.problem.order)
        return self.options.sampler == "auto" and self.options.scheduler is None and count <= SMALL


def _as_copies(task: MatchingTask, find: Callable[[MatchingTask], Match]) -> Match:
    """What is found, of a rig for the copies of its points."""
    return shown(find(copies_task(task))) if is_rig(task) else find(task)


def _not_searched(task: MatchingTask) -> Match:
    return empty_match(task, UNCONFIRMED)


def _bodies_not_searched(task: MatchingTask) -> Match:
    return match_bodies(task, _not_searched)
