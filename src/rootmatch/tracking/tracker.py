"""The tracker: bodies are searched for at first, then each pose predicts the next one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.backends import selection
from rootmatch.backends.strongest import Progress
from rootmatch.deadline import Deadline
from rootmatch.errors import InputError
from rootmatch.explain.body_labels import Label
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.match_options import SamplerName
from rootmatch.explain.near_symmetries import near_symmetries
from rootmatch.explain.predicted_assignment import Found
from rootmatch.hypergraph.affinity import Residual
from rootmatch.matcher import Matcher
from rootmatch.problems.base import Problem
from rootmatch.problems.capabilities import Capability
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.result import Match, report
from rootmatch.samplers.base import Sampler
from rootmatch.solvers import Solver
from rootmatch.tracking.followed_body import FollowedBody, TrackingOptions, TrackingState
from rootmatch.tracking.rival_poses import decided
from rootmatch.tracking.searched_poses import challengers, searched

__all__ = ["Tracker", "TrackingOptions", "TrackingState"]

TRACKING = TrackingOptions()
TURNS = 3
"""Number of near symmetries of a body that are tried. A round value."""


class Tracker:
    """`rootmatch.match` for the frames of a sequence, each of which predicts the next.

    The first frame is matched as by `rootmatch.Matcher`. From then on, a constant-velocity Kalman filter predicts a
    pose with its covariance, which is the prior of the next match: a frame takes about a millisecond. A body that is
    not found is still predicted for a while; then it counts as lost and is searched for. Kernels are compiled when a
    frame first needs them; if no frame may wait, call `rootmatch.warmup` before the first one.

    Parameters
    ----------
    source : (n, 3) array
        Points in space in any frame and unit.
    problem : Problem
        `P3P`, also of a `Rig`, or `UP2P`.
    noise : float or (n',) array
        Standard deviation of a pixel coordinate, in pixels; `update` can override it.
    tracking : TrackingOptions
        Frame rate, how long a body may be missing, and how fast bodies may move.
    normals, view_angle, detection_rate, min_probability, bodies, source_noise
        What is known about the scene in every frame, as for `rootmatch.match`.
    seed, max_seconds, progress, sampler, samples, residual, rho, solver, backend, scheduler, max_hyperedges, \
max_evaluations
        Of the searches, as for `rootmatch.match`.

    Attributes
    ----------
    state : TrackingState
        LOST, COASTING or TRACKING; with several bodies, the best of their states. `states` has all of them.

    Raises
    ------
    InputError
        If the arguments cannot be used.
    """

    def __init__(
        self,
        source: ArrayLike,
        problem: Problem,
        *,
        noise: ArrayLike = 1.0,
        tracking: TrackingOptions = TRACKING,
        normals: ArrayLike | None = None,
        view_angle: ArrayLike | None = None,
        detection_rate: float | None = None,
        min_probability: float | None = None,
        bodies: ArrayLike | None = None,
        source_noise: ArrayLike | None = None,
        seed: int = 0,
        max_seconds: float | None = None,
        progress: Progress | None = None,
        sampler: SamplerName | Sampler | None = None,
        samples: int | None = None,
        residual: str | Residual | None = None,
        rho: float | None = None,
        solver: str | Solver | None = None,
        backend: selection.Name = "auto",
        scheduler: str | None = None,
        max_hyperedges: int = 5_000_000,
        max_evaluations: int | None = None,
    ) -> None:
        if isinstance(noise, str):
            raise InputError(f"noise: {noise!r} given; a tracker needs a number of pixels; a Matcher can estimate it")
        self.matcher = Matcher(
            source,
            problem,
            noise=noise,
            normals=normals,
            view_angle=view_angle,
            detection_rate=detection_rate,
            min_probability=min_probability,
            bodies=bodies,
            source_noise=source_noise,
            seed=seed,
            max_seconds=max_seconds,
            progress=progress,
            sampler=sampler,
            samples=samples,
            residual=residual,
            rho=rho,
            solver=solver,
            backend=backend,
            scheduler=scheduler,
            max_hyperedges=max_hyperedges,
            max_evaluations=max_evaluations,
        )
        Capability.PRIOR.require(problem.takes_prior, problem.name)
        self.tracking = tracking
        self.time: float | None = None
        self.labels = self.matcher.labels
        self._frame = 0
        self._bodies: dict[Label | None, FollowedBody] = {}
        if self.labels is None:
            turns = near_symmetries(self.matcher.source, self.matcher.normals, TURNS)
            self._bodies[None] = FollowedBody(self.matcher.source, tracking, turns)
        else:
            for k, label in enumerate(self.labels.names):
                self._bodies[label] = FollowedBody(self.matcher.source[self.labels.points_of(k)], tracking)

    @property
    def state(self) -> TrackingState:
        """Whether the body, or any of several, is being followed."""
        order = list(TrackingState)
        return max(self.states.values(), key=order.index)

    @property
    def states(self) -> dict[Label | None, TrackingState]:
        """The state of each body by its label (None for a single body)."""
        return {label: body.state for label, body in self._bodies.items()}

    def predicted(self, time: float | None = None) -> dict[Label | None, Pose]:
        """Predicted poses of the bodies that are not lost, by label (None for a single one).

        Parameters
        ----------
        time : float, optional
            Seconds; that of the next frame by default.
        """
        if self.time is None:
            return {}
        when = self.time + self.tracking.interval if time is None else time
        return {
            label: body.rivals[0].filter.predicted(when)
            for label, body in self._bodies.items()
            if body.state is not TrackingState.LOST
        }

    def reset(self) -> None:
        """Forget all poses: the next frame is searched."""
        self.time, self._frame = None, 0
        for body in self._bodies.values():
            body.forget()

    def update(
        self,
        target: ArrayLike,
        *,
        time: float | None = None,
        prior: Pose | Mapping[Label, Pose] | None = None,
        noise: ArrayLike | None = None,
        candidates: ArrayLike | None = None,
        max_seconds: float | None = None,
    ) -> Match:
        """The match of the next frame.

        Parameters
        ----------
        target : (n', 2) array
            Pixels (x right, y down), in any order, including clutter; n' may change from frame to frame and may be 0.
            For a `Rig`, ``(pixels, index)`` or rows of x, y and the index of the camera.
        time : float, optional
            Seconds, later than the previous frame; by default one interval later.
        prior : Pose or dict, optional
            A better prediction than the tracker's own, for example from an inertial sensor.
        noise : float or (n',) array, optional
            Of this frame.
        candidates : (n, n') array, optional
            Possible correspondences of this frame, or their prior weights; see `rootmatch.match`.
        max_seconds : float, optional
            Bounds the search of this frame.

        Returns
        -------
        Match
            Untrusted if nothing is found. `Match.fused_pose` is the pose of detections and prediction together.

        Raises
        ------
        InputError
            If the frame is not later than the previous one, or as `rootmatch.Matcher.match`.
        """
        started = perf_counter()
        when = self._time(time)
        self._frame += 1
        deadline = Deadline(self.matcher.options.max_seconds if max_seconds is None else max_seconds, started=started)
        if self.labels is not None:
            found = self._match_bodies(target, when, prior, noise, deadline=deadline, candidates=candidates)
        elif prior is not None:
            found = self.matcher.follow(target, prior, noise, deadline, budget=self._budget, candidates=candidates)
            self._bodies[None].take(found, True, when)
        else:
            found = self._match_one(target, when, noise, deadline, candidates)
        self.time = when
        return report(found, seconds=perf_counter() - started, stopped_early=deadline.stopped_early)

    @property
    def _budget(self) -> int | None:
        """Evaluations of a search; None for the first frame, which is limited only as `rootmatch.match` is."""
        return None if self.time is None else self.tracking.search_budget

    def _match_one(
        self,
        target: ArrayLike,
        when: float,
        noise: ArrayLike | None,
        deadline: Deadline,
        candidates: ArrayLike | None,
    ) -> Finding:
        """The finding of a frame with one body: from its predictions, and by a search if none holds."""
        body = self._bodies[None]

        def search() -> Finding:
            return self.matcher.follow(target, None, noise, deadline, budget=self._budget, candidates=candidates)

        def follow(pose: Pose) -> tuple[Finding, Found | None]:
            return self.matcher.tried(target, pose, noise, candidates)

        if not body.rivals:
            found = search()
            body.start(found, when)
            return found
        shape = None if body.settled else body.shape
        after = decided(body.rivals, follow, when, shape)
        detections = after.match.task.shape[1]
        if after.found is not None:
            body.hold(after, detections)
            if body.misses(after.found, detections - self.matcher.problem.order) and body.late(self._frame):
                other = search()
                if other.status is not Status.UNTRUSTED:
                    body.settled = False
                    body.rivals += challengers(other, after.match, after.left[0], body.shape, when)
                return replace(after.match, evaluated=other.evaluated)
            return after.match
        worth = body.worth_a_search(detections)
        body.rivals = after.left
        body.miss(when)
        if not worth:
            body.presume(when)
            return after.match
        found = search()
        if found.status is Status.UNTRUSTED:
            body.presume(when)
            # the result about the prediction is more likely than the result of the search
            return replace(after.match, evaluated=found.evaluated) if (after.match.assignment >= 0).any() else found
        if not body.rivals:
            body.start(found, when)
            return found
        after = searched(found, body.rivals, body.shape, when, after.match.assignment)
        body.hold(after, detections)
        return after.match

    def _match_bodies(
        self,
        target: ArrayLike,
        when: float,
        prior: Pose | Mapping[Label, Pose] | None,
        noise: ArrayLike | None,
        *,
        deadline: Deadline,
        candidates: ArrayLike | None,
    ) -> Finding:
        """The finding of a frame with several bodies."""
        given = {label: pose for label, pose in self.predicted(when).items() if label is not None}
        if isinstance(prior, Mapping):
            given |= prior
        elif prior is not None:
            raise InputError("prior: one pose given with bodies=; give a dict from the label of a body to its pose")
        lost = self.time is None or any(body.state is not TrackingState.TRACKING for body in self._bodies.values())
        searching = lost and (self._frame - 1) % self.tracking.search_every == 0
        found = self.matcher.follow(
            target, given, noise, deadline, searching=searching, budget=self._budget, candidates=candidates
        )
        assert found.parts is not None
        for label, body in self._bodies.items():
            body.take(found.parts[label], label in given, when)  # type: ignore[index]
        return found

    def _time(self, time: float | None) -> float:
        if time is None:
            return 0.0 if self.time is None else self.time + self.tracking.interval
        if not isinstance(time, int | float | np.number) or not math.isfinite(time):
            raise InputError(f"time: {time!r} given; give seconds")
        if self.time is not None and time <= self.time:
            raise InputError(f"time: {time:g} s given after {self.time:g} s; give frames in order, or reset() first")
        return float(time)
