"""The tracker: bodies are searched for at first, then each pose predicts the next one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.backends import selection
from rootmatch.backends.strongest import Progress
from rootmatch.deadline import Deadline
from rootmatch.errors import InputError
from rootmatch.explain.bodies import Choice, SearchPart
from rootmatch.explain.body_labels import Label
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.match_options import SamplerName
from rootmatch.explain.predicted_poses import check_contradiction
from rootmatch.explain.prior_validation import Prior, Rivals, check_followed, check_predicted
from rootmatch.explain.validation import join_camera_noise
from rootmatch.frozen import copy_with
from rootmatch.hypergraph.affinity import Residual
from rootmatch.matcher import Matcher
from rootmatch.model.near_symmetries import find_symmetries
from rootmatch.problems.base import Problem
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.shared_errors import with_whole_covariance
from rootmatch.result import Match, report
from rootmatch.samplers.base import Sampler
from rootmatch.solvers import Solver
from rootmatch.tracking import identical_bodies, search_schedule
from rootmatch.tracking.followed_body import FollowedBody, TrackingOptions, TrackingState
from rootmatch.tracking.noise_scale import InexactPoints, NoiseScale, is_frame_of_row, scale_noise_by
from rootmatch.tracking.turns import Turns

__all__ = ["Tracker", "TrackingOptions", "TrackingState"]

TRACKING = TrackingOptions()
TURNS = 3
"""Number of near symmetries of a body that are tried. A round value."""


class Tracker:
    """`rootmatch.match` for the frames of a sequence, in which each frame predicts the next.

    The first frame is matched as by `rootmatch.Matcher`. From then on, a Kalman filter of its motion predicts each pose
    with its covariance, and the prediction is the prior of the next match: a frame takes a few milliseconds. A body
    that is not found is still predicted for a while. Then it is lost and searched for: each frame looks for one body,
    in one camera of a rig. `rootmatch.warmup` compiles kernels beforehand. Threads that share a tracker take turns.

    Parameters
    ----------
    source : (n, 3) array, in any frame and unit; (n, 2) in a plane.
    problem : Problem
        `P3P` or `UP2P`, also of a `Rig` (if the camera tilts, with a `PosePrior` in each frame), `Rigid` or
        `Similarity`, whose scale, one for each body, is constant but for `MotionOptions.scale_drift`.
    noise : float, (n',) or (n', 2, 2) array
        Standard deviation of a pixel coordinate, in pixels, or covariances, of a rig also by camera; `update` can
        override it. For `Rigid` and `Similarity` as in `rootmatch.match`.
    tracking : TrackingOptions
        Frame rate, how long a body may be missing, and how fast bodies may move.
    normals, view_angle, detection_rate, resolution, min_probability, bodies, source_noise
        What is known about the scene in every frame, as for `rootmatch.match`.
    seed, max_seconds, progress, sampler, samples, residual, rho, solver, backend, scheduler, max_hyperedges, \
max_evaluations
        Of the searches, as for `rootmatch.match`.

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
        resolution: float | None = None,
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
        given = {name: one for name, one in list(locals().items()) if name not in ("self", "tracking")}
        if isinstance(noise, str):
            raise InputError(
                f"noise: {noise!r} given; a tracker needs a number of pixels; `match` or a Matcher can estimate it"
            )
        check_followed(problem, source)
        self.matcher = Matcher(**given)
        self._of_images = self.matcher.problem.takes_prior  # between two point sets one posterior weighs everything
        self.tracking, self._turns, self._steps = tracking, Turns(), list[float]()
        self.labels, self._bodies = self.matcher.labels, dict[Label | None, FollowedBody]()
        points, normals = self.matcher.source, self.matcher.normals
        each: dict[Label | None, NDArray[np.int64]] = {None: np.arange(len(points))}
        self._identical, self._alike = list[Sequence[Label]](), list[identical_bodies.Likeness]()
        if self.labels is not None:
            self._identical = [*identical_bodies.find_identical_bodies(self.labels, points, normals)]
            self._alike = identical_bodies.family_likenesses(self.labels, points, self._identical)
            each = {label: self.labels.points_of(k) for k, label in enumerate(self.labels.names)}
        for label, own in each.items():
            facing = None if normals is None else normals[own]
            near = find_symmetries(points[own], facing)[:TURNS] if self._of_images else ()
            turns = [(one.rotation, one.shift) for one in near]
            self._bodies[label] = FollowedBody(points[own], tracking, turns)
        self.reset()

    def __repr__(self) -> str:
        told = ", ".join(state.name if k is None else f"{k}: {state.name}" for k, state in self.states.items())
        return f"Tracker({type(self.matcher.problem).__name__}, {len(self.matcher.source)} points, {told})"

    @property
    def state(self) -> TrackingState:
        """Whether the body, or any of several, is being followed."""
        return max(self.states.values(), key=list(TrackingState).index)

    @property
    def states(self) -> dict[Label | None, TrackingState]:
        """The state of each body by its label (None for a single body)."""
        return {label: body.state for label, body in self._bodies.items()}

    @property
    def noise_factor(self) -> float:
        """Ratio (1 or more) of the noise that the frames so far suggest to the stated one; σ is multiplied by it.

        A rig whose calibration is off by a pixel looks like noise of that size, so a factor of 2 or more is a warning.
        """
        return self._noise.factor

    def predicted(self, time: float | None = None) -> dict[Label | None, Pose]:
        """Predicted poses of the bodies that are not lost, by label (None for a single one).

        Parameters
        ----------
        time : float, optional
            Seconds, not before the last frame; that of the next frame by default.

        Raises
        ------
        InputError
            If the time is before the last frame.
        """
        with self._turns:
            when = self._time(time)
            if self.time is None:
                return {}
            if when < self.time:
                raise InputError(f"time: {when:g} s given, before the last frame at {self.time:g} s; give a later time")
            return {
                label: with_whole_covariance(body.belief.best.predicted(when))
                for label, body in self._bodies.items()
                if body.state is not TrackingState.LOST
            }

    def reset(self) -> None:
        """Forget all poses: the next frame is searched."""
        with self._turns:
            self.time: float | None = None
            self._frame = self._cut = 0  # of frames, and of those in a row whose search was cut short
            self._noise, self._inexact = NoiseScale(), InexactPoints()
            for body in self._bodies.values():
                body.forget()

    def update(
        self,
        target: ArrayLike,
        *,
        time: float | None = None,
        prior: Prior | Mapping[Label, Prior] | None = None,
        noise: ArrayLike | None = None,
        candidates: ArrayLike | None = None,
        max_seconds: float | None = None,
    ) -> Match:
        """The match of the next frame.

        Parameters
        ----------
        target : (n', 2) array
            Pixels (x right, y down), in any order, including clutter; n' may change from frame to frame and may be 0.
            For a `Rig` as in `rootmatch.match`. For `Rigid` and `Similarity`, (n', 3) points, or (n', 2).
        time : float, optional
            Seconds, later than the previous frame; by default one interval later. Where most of the first steps are
            longer than a second, an `InputWarning` says once that these may be milliseconds.
        prior : Pose, PosePrior or dict, optional
            A pose replaces the tracker's own prediction. Partial knowledge, for example from an inertial sensor, is
            combined with that prediction, and narrows the search for a body that is lost. With ``bodies``, a dict from
            labels to either.
        noise : float, (n',) or (n', 2, 2) array, optional
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
            If the frame is not later than the last one, or as `rootmatch.Matcher.match`; the tracker stays as it was.
        """
        started = perf_counter()
        deadline = Deadline(self.matcher.options.max_seconds if max_seconds is None else max_seconds, started=started)
        given, problem = dict[Label | None, Prior](), self.matcher.problem
        if prior is not None:
            problem, prior = check_predicted(prior, self.labels, problem)
            given.update(prior.items() if isinstance(prior, Mapping) else {None: prior}.items())
        with self._turns:
            when, before = self._time(time), self.time
            if before is not None and when <= before:
                raise InputError(f"time: {when:g} s given after {before:g} s; give frames in order, or reset() first")
            self._frame += 1
            try:
                found = self._find(target, when, given, noise, deadline=deadline, candidates=candidates, own=problem)
            except InputError:
                self._frame -= 1
                raise
            self.time = when
            if before is not None and time is not None:
                search_schedule.warn_of_time_unit(self._steps, when - before)
        return report(found, seconds=perf_counter() - started, stopped_early=deadline.stopped_early)

    def _find(
        self,
        target: ArrayLike,
        when: float,
        given: dict[Label | None, Prior],
        noise: ArrayLike | None,
        *,
        deadline: Deadline,
        candidates: ArrayLike | None,
        own: Problem,
    ) -> Finding:
        """The finding of a frame: about the predicted poses, and by a search if they do not hold."""
        poses, rivals, frame = dict[Label | None, Prior](), dict[Label | None, Rivals](), self._frame
        for label, body in self._bodies.items():
            told = given.get(label)
            if body.belief and not isinstance(told, Pose):
                pose, others = body.predicted(when, None if self.labels is None else frame)
                if told is not None:
                    pose, others = told.with_prediction(pose), others.with_knowledge(told)
                poses[label], rivals[label] = pose, others
            elif told is not None:
                poses[label] = told
        present = {label: chance for label, body in self._bodies.items() if (chance := body.present(when)) is not None}
        factor = self.noise_factor
        stated = join_camera_noise(self.matcher.problem.rig, self.matcher.noise if noise is None else noise, target)
        # the first frame is limited only as `rootmatch.match` is
        step = None if self.time is None else when - self.time
        budget = None if step is None else search_schedule.frame_budget(self.tracking.search_budget, step)

        def explained(searching: bool | Choice, factor: float = factor) -> Finding:
            noise = stated if factor == 1.0 else scale_noise_by(stated, factor)
            options = search_schedule.reorder_draws(self.matcher.options, self._cut)
            prior = poses.get(None) if self.labels is None else {k: one for k, one in poses.items() if k is not None}
            return self.matcher.explained(
                target, noise=noise, candidates=candidates, prior=prior, deadline=deadline, budget=budget,
                problem=own, present=present, searching=searching, options=options,
                rivals=rivals, more_images=True, source_noise=self._inexact.error, log_inexact=self._inexact.log_odds,
            )  # fmt: skip

        searched: set[Label | None] = set(self._bodies)
        if not self._of_images or (self.time is None and not any(isinstance(one, Pose) for one in poses.values())):
            found = explained(True)
        elif self.labels is not None or self.matcher.problem.rig is not None:
            found = explained(lambda near: search_schedule.choose_next_part(self._bodies, self._parts(near), frame))
            searched = search_schedule.ended_searches(self._bodies, self._parts(found), frame)
        elif not poses and not self._noise.waiting:
            found = explained(True)
        else:
            searched = set()

            def choice(near: Finding) -> SearchPart | None:
                body = self._bodies[None]
                if self._noise.waiting or not body.needs_search(near, frame):
                    return None
                searched.add(None)
                return SearchPart(0, None, body.has_new_detections(near), body.search_share(near))

            found = explained(choice)
        for label, told in given.items():
            if isinstance(told, Pose):
                self._bodies[label].keep_best(when)
        parts = self._parts(found)
        parts = {one: self._bodies[one].checked(part, when, frame, one in searched) for one, part in parts.items()}
        matched = all(part.status is Status.MATCHED for part in parts.values())
        self._cut = 0 if matched else self._cut + (found.is_cut or deadline.stopped_early)
        changed = False
        if self._of_images:
            doubted, alone = self._noise.is_doubted, self.labels is None and self.time is not None
            lost = not poses and alone and (is_frame_of_row(frame, self.tracking.search_every) or doubted)  # a search
            asked = [None] if lost else search_schedule.bodies_found_lately(self._bodies, poses, frame, doubted=doubted)
            changed = self._noise.compare(
                self._parts(found), self._noise.waiting or asked, factor,
                lambda f: self._parts(explained(not poses, f)), later=self.labels is None and bool(searched),
            )  # fmt: skip
        identical_bodies.know_others(self._alike, self._bodies)
        left = search_schedule.remaining_counts(parts)
        for label, part in parts.items():
            self._bodies[label].take(part, when, frame, label in searched)
            self._bodies[label].belief.room = when, left[label]
            self._noise.take(part, factor)
            if changed:
                self._bodies[label].acquit()
        self._inexact.take(parts.get(None), self._noise.stays)
        identical_bodies.name_places(self._identical, self._bodies, parts, when)
        if not self._of_images and frame % self.tracking.search_every == 0:
            identical_bodies.expect_exchanged(self._alike, self._bodies)
        parts = {label: check_contradiction(part, given.get(label)) for label, part in parts.items()}
        if factor > 1.0:
            parts = {label: copy_with(part, sequence_factor=factor) for label, part in parts.items()}
        limit = 0.5 * self.tracking.motion.max_scale
        fast = [label for label, body in self._bodies.items() if body.belief and body.belief.best.factor >= limit]
        parts |= {label: copy_with(parts[label], motion_factor=limit) for label in fast}
        return parts[None] if found.parts is None else copy_with(found, parts={one: parts[one] for one in found.parts})

    def _parts(self, found: Finding) -> dict[Label | None, Finding]:
        """The finding of each body by its label (None for a single body)."""
        return {None: found} if found.parts is None else dict(found.parts.items())

    def _time(self, time: float | None) -> float:
        """A time as given; by default that of the next frame."""
        if time is None:
            return 0.0 if self.time is None else self.time + self.tracking.interval
        if not isinstance(time, int | float | np.number) or not math.isfinite(time):
            raise InputError(f"time: {time!r} given; give seconds")
        return float(time)
