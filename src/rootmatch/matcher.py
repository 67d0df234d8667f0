"""Match frame after frame against one set of source points, as a tracker does."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.arrays import as_points
from rootmatch.backends import selection
from rootmatch.backends.strongest import Progress
from rootmatch.deadline import NEVER, Deadline
from rootmatch.errors import UnseenPixelError
from rootmatch.explain.bodies import Choice
from rootmatch.explain.body_findings import find_no_body
from rootmatch.explain.body_labels import Label, check_bodies
from rootmatch.explain.explain import explain
from rootmatch.explain.finding import Finding
from rootmatch.explain.match_options import MatchOptions, SamplerName
from rootmatch.explain.prior_validation import NONE, Prior, Rivals, check_predicted
from rootmatch.explain.task import MatchingTask
from rootmatch.explain.validation import check_problem
from rootmatch.hypergraph.affinity import Residual
from rootmatch.model.widened_prediction import FREEDOM
from rootmatch.problems.base import Problem
from rootmatch.problems.checks import find_repeated
from rootmatch.problems.noise import check_source_noise
from rootmatch.problems.points import PointSets
from rootmatch.result import Match, report
from rootmatch.samplers.base import Sampler
from rootmatch.solvers import Solver


class Matcher:
    """`rootmatch.match` for many images of the same source points.

    The source is checked once: five markers against eight detections take a few milliseconds. Kernels are compiled when
    a frame first needs them. If no frame may wait for that, call `rootmatch.warmup` before the first one.

    Parameters
    ----------
    source : (n, 3) or (n, 2) array
        Points in space in any frame and unit, or pixels of the first image.
    problem : Problem
    noise : float, (n',) or (n', 2, 2) array
        Standard deviation of a pixel coordinate, in pixels, or covariances, of a rig also by camera; `match` can
        override it.
    normals, view_angle, detection_rate, resolution, min_probability, bodies, motions, source_noise
        What is known about the scene in every frame, as for `rootmatch.match`. Candidates and predicted poses belong to
        one frame: pass them to `match`.
    seed, max_seconds, progress, sampler, samples, residual, rho, solver, preset, backend, scheduler, \
max_hyperedges, max_evaluations
        As for `rootmatch.match`.

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
        detection_rate: float | None = None,
        resolution: float | None = None,
        min_probability: float | None = None,
        bodies: ArrayLike | None = None,
        motions: int | Literal["auto"] = 1,
        source_noise: ArrayLike | None = None,
        seed: int = 0,
        max_seconds: float | None = None,
        progress: Progress | None = None,
        sampler: SamplerName | Sampler | None = None,
        samples: int | None = None,
        residual: str | Residual | None = None,
        rho: float | None = None,
        solver: str | Solver | None = None,
        preset: Literal["paper"] | None = None,
        backend: selection.Name = "auto",
        scheduler: str | None = None,
        max_hyperedges: int = 5_000_000,
        max_evaluations: int | None = None,
    ) -> None:
        check_problem(problem)
        problem = problem.for_points(source)
        self.checked = problem.check_source(source, normals, view_angle, distinct=bodies is None)
        self.source, self.normals, _ = self.checked
        self.problem = problem
        self.noise = noise if isinstance(noise, str | int | float) else copy.deepcopy(noise)
        self.labels = None if bodies is None else check_bodies(bodies, self.source, problem.order)
        self.source_noise = None if source_noise is None else check_source_noise(source_noise, self.source)
        self.options = MatchOptions.among(locals())

    def match(
        self,
        target: ArrayLike,
        *,
        noise: ArrayLike | Literal["auto"] | None = None,
        candidates: ArrayLike | None = None,
        prior: Prior | Mapping[Label, Prior] | None = None,
        max_seconds: float | None = None,
    ) -> Match:
        """The match of one frame.

        Parameters
        ----------
        target : (n', 2) array
            Pixels (x right, y down), in any order, including clutter; n' may change from frame to frame. For a `Rig` as
            in `rootmatch.match`.
        noise : float, (n',) or (n', 2, 2) array, or "auto", optional
            Of this frame.
        candidates : (n, n') array, optional
            Possible correspondences or prior weights, for example from the previous frame.
        prior : Pose, PosePrior or dict, optional
            Predicted pose of this frame, or partial knowledge of it, see `rootmatch.match`; `rootmatch.Tracker` makes
            predictions.
        max_seconds : float, optional
            Of this frame; see `rootmatch.match`.

        Returns
        -------
        Match
            Empty and untrusted, with the reason as its advice, if there are too few detections for one hyper-edge, if a
            detection occurs twice (where the target is an image: if all are the same), or if one lies where the lens
            model shows nothing. A loop over frames need not treat such frames separately.

        Raises
        ------
        InputError
            As `rootmatch.match`.
        """
        started = time.perf_counter()
        problem = self.problem
        if prior is not None:
            problem, prior = check_predicted(prior, self.labels, problem)
        options = self.options if max_seconds is None else replace(self.options, max_seconds=max_seconds)
        deadline = Deadline(options.max_seconds, started=started)
        found = self.explained(
            target, noise=noise, candidates=candidates, prior=prior, options=options, deadline=deadline,
            problem=problem,
        )  # fmt: skip
        return report(found, seconds=time.perf_counter() - started, stopped_early=deadline.stopped_early)

    def explained(
        self,
        target: ArrayLike,
        *,
        noise: ArrayLike | Literal["auto"] | None = None,
        candidates: ArrayLike | None = None,
        prior: Prior | Mapping[Label, Prior] | None = None,
        options: MatchOptions | None = None,
        problem: Problem | None = None,
        deadline: Deadline = NEVER,
        budget: int | None = None,
        rivals: Mapping[Label | None, Rivals] | None = None,
        present: Mapping[Label | None, float] | None = None,
        searching: bool | Choice = True,
        more_images: bool = False,
        source_noise: float | None = None,
        log_inexact: tuple[float, ...] = (),
    ) -> Finding:
        """The finding of a frame; ``options``, ``problem`` and ``source_noise`` in the place of the matcher's own.

        What is not explained here is an attribute of `MatchingTask`, or an argument of `match`.

        Parameters
        ----------
        rivals, present : dict, optional
            By the label of a body, None for a single one: what else its pose may be than that of ``prior``, and the
            probability that it is in view, before the frame is seen.
        searching : bool or callable
            False: nothing is looked for elsewhere than about the predicted poses. A function of the finding about those
            says what to look for.
        """
        options = options or self.options
        detections = as_points(self.problem.joined(target), self.problem.target_dimension, "target")
        predicted = prior is not None and self.problem.takes_prior and (self.labels is None or searching is not True)
        reason = self._detection_fault(detections, 1 if predicted else self.problem.order)
        if reason is not None:
            return self._empty_finding(detections, reason)
        told: dict[str, Any] = {"more_images": more_images, "log_inexact": log_inexact}
        if rivals is not None:
            others = {label: poses for label, poses in rivals.items() if label is not None}
            told |= {"rivals": rivals.get(None, NONE), "rivals_of": others, "prior_freedom": FREEDOM}
        if present:
            of_bodies = {label: chance for label, chance in present.items() if label is not None}
            told |= {"present": present.get(None), "present_of": of_bodies}
        if budget is not None and options.scheduler is None:
            told["budget"] = budget
        task = MatchingTask.of(
            problem or self.problem,
            self.checked,
            detections,
            noise=self.noise if noise is None else noise,
            candidates=candidates,
            bodies=self.labels,
            prior=prior,
            source_noise=self.source_noise if source_noise is None else source_noise,
            options=options,
            deadline=deadline,
            **told,
        )
        try:
            return explain(task, searching)
        except UnseenPixelError as error:
            return self._empty_finding(detections, str(error))

    def _detection_fault(self, detections: NDArray[np.float64], minimum: int) -> str | None:
        """Fault of a frame's detections that any detector may cause; None if there is none."""
        if detections.size == 0:
            return f"no detections given, at least {self.problem.order} needed by {self.problem.name}"
        if detections.ndim != 2 or detections.shape[1] != self.problem.target_dimension:
            return None  # no frame: `rootmatch.match` says what it is
        if len(detections) < minimum:
            given = f"{len(detections)} detection{'s' * (len(detections) > 1)} given"
            return f"{given}, at least {self.problem.order} needed by {self.problem.name}"
        if self.problem.takes_prior:
            one = len(detections) > 1 and not np.count_nonzero(detections != detections[0])
            return f"all {len(detections)} detections are the same" if one else None
        same = find_repeated(detections)
        return None if same is None else f"detections {same[0]} and {same[1]} are the same; keep one of them"

    def _empty_finding(self, detections: NDArray[np.float64], reason: str) -> Finding:
        """The finding of a frame that cannot be matched; of several bodies that of each."""
        detections = detections.reshape(-1, self.problem.target_dimension)
        n, n_target = len(self.source), len(detections)
        noise = math.nan if isinstance(self.noise, str) else self.noise
        points = PointSets(self.source, detections, np.full(n, math.nan), np.full(n_target, math.nan), self.normals)
        weigh = self.options.affinity(self.problem, False)
        task = MatchingTask(self.problem, points, weigh, self.options, noise=noise, bodies=self.labels)
        return find_no_body(task, reason)
