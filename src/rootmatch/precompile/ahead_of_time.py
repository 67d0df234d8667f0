"""`rootmatch.warmup`: compile what a matcher or a tracker of some problem may need before its first frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from rootmatch.algebra.rotation import one_rotation_matrix
from rootmatch.arrays import Floats
from rootmatch.backends.strongest import Progress
from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.rig import Rig
from rootmatch.errors import InputError
from rootmatch.explain.validation import check_problem
from rootmatch.matcher import Matcher
from rootmatch.precompile.scenes import Sample, sample
from rootmatch.problems import PROBLEMS
from rootmatch.problems.base import Problem
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.samplers.guided.sampler import Guided
from rootmatch.tracking.tracker import Tracker

Step = Callable[[], object]
SIGMA, SIGMA_RADIANS = 0.5, 5e-4
"""Noise of the simulated detections, in pixels and in radians."""
VAGUE = 20.0
"""Factor of that noise with which an image is dense."""
DISTANCE = 5.0
"""Distance of the simulated body from the camera, over its radius."""
SMALL, LARGE, DENSE = 12, 60, 120
"""Points up to which few detections make a quick sweep; of a body whose neighbours are matched first; of a body whose
image is dense."""
BUDGET = 100_000
"""Evaluations of a search: all its kernels are met long before."""
WIDEST = 1.3
"""Focal lengths from its middle to which an image may extend: 52° without distortion, 74° of an equidistant fisheye. A
round value."""
LONGEST = 2.0
"""Seconds that a frame may be searched that loads kernels for others. A round value."""


def warmup(
    problem: Problem, source: ArrayLike | None = None, *, progress: Progress | None = None, **options: Any
) -> None:
    """Compile the kernels that a `Matcher` or `Tracker` of a problem may need, so that no frame waits for a compiler.

    What is compiled depends on the problem and on how a search proceeds, not on the points. This function therefore
    matches and tracks a few made-up bodies through everything that can happen: clutter, occlusion, a wrong prediction,
    few points, a body that looks the same from two sides. Compiled code is kept on disk: without prebuilt kernels, the
    first call on a machine takes up to several minutes; later calls take a few seconds per process.

    Call it before the first frame of any application that must not pause. `Matcher` and `Tracker` do not call it,
    because a process with a single image would wait for kernels that it never needs.

    Parameters
    ----------
    problem : Problem
    source : (n, 3) or (n, 2) array, optional
        The points that will be matched, in addition to the made-up ones. Needed with ``bodies`` or ``normals``.
    progress : callable, optional
        Called with (done, total) after each step.
    **options
        Of the `Matcher` or `Tracker`.

    Raises
    ------
    InputError
        If the arguments cannot be used, or no scenes of the problem are known, as for a problem of your own: match a
        few of its images instead.
    """
    check_problem(problem)
    if source is None and options.keys() & {"normals", "bodies", "view_angle"}:
        raise InputError("warmup: normals, view_angle and bodies describe source points; give source as well")
    steps = list(_camera_steps(problem, source, options) if problem.takes_prior else _scene_steps(problem, options))
    if progress is not None:
        progress(0, len(steps))
    for done, step in enumerate(steps):
        step()
        if progress is not None:
            progress(done + 1, len(steps))


def load_tracker(problem: Problem, source: Floats, **options: Any) -> None:
    """Load what the first frames of a `Tracker` need: of points that are seen well, in less than a second.

    Where kernels are not on disk, they are compiled, as the first frame would.

    Parameters
    ----------
    problem : Problem
        One that a tracker takes.
    source : (n, 3) array
    **options
        Of the `Tracker`, without the noise.
    """
    facing = options.get("normals"), options.get("view_angle")
    view = _View(problem, source, facing) if problem.takes_prior else None
    size = float(np.ptp(source, axis=0).max())
    sigma = 1e-3 * size if view is None else view.sigma
    tracker, rng = Tracker(source, problem, noise=sigma, **options), np.random.default_rng(0)
    for number in range(3):  # one is searched, others are predicted
        moved = source + rng.normal(0.0, sigma, source.shape)
        image = moved if view is None else view.frame(number, len(source), 2)
        found = tracker.update(image, max_seconds=LONGEST)
        _ = found.confidence, found.pose


def _scene_steps(problem: Problem, options: dict[str, Any]) -> Iterator[Step]:
    """Matches of a problem without a prediction."""
    if problem.name not in PROBLEMS:
        raise InputError(f"warmup: no scenes of {problem.name} are known; match a few of its images instead")
    scene = sample(problem.name)
    for kept in (len(scene.source), problem.order + 1):
        yield partial(_match_scene, scene, kept, options)
    yield partial(_match_scene, _add_clutter(scene), len(scene.source), options)


def _match_scene(scene: Sample, kept: int, options: dict[str, Any]) -> None:
    """A frame of a scene, read as a user may."""
    matcher = Matcher(scene.source[:kept], scene.problem, noise=scene.noise, **options)
    found = matcher.match(scene.target)
    _ = found.score, found.confidence, found.pose


def _add_clutter(scene: Sample) -> Sample:
    """A scene whose hyper-edges are too many for a sweep."""
    rng = np.random.default_rng(0)
    low, high = scene.target.min(axis=0), scene.target.max(axis=0)
    clutter = rng.uniform(low, high, (60, scene.target.shape[1]))
    return Sample(scene.source, np.concatenate([scene.target, clutter]), scene.problem, scene.noise)


@dataclass(frozen=True, eq=False)
class Body:
    """Points (n, 3), and the options that belong to them."""

    points: Floats
    options: dict[str, Any]


def _camera_steps(problem: Problem, source: ArrayLike | None, options: dict[str, Any]) -> Iterator[Step]:
    """Flights of bodies before the camera of a problem."""
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(LARGE, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    half = ball[:5] * [0.8, 1.0, 1.0] + [0.5, 0.0, 0.0]
    clone = np.concatenate([half, half * [-1.0, 1.0, -1.0], ball[5:7]])
    of_points: dict[str, Any] = {key: options[key] for key in ("normals", "view_angle", "bodies") if key in options}
    others = {key: value for key, value in options.items() if key not in of_points}
    bodies = [Body(ball[:7], others), Body(clone, others), Body(ball, others)]
    if source is None or "normals" in of_points:
        bodies.append(Body(ball[:20], {**others, "normals": ball[:20]}))
    if source is not None:
        bodies.append(Body(np.asarray(source, np.float64), {**others, **of_points}))
    for body in bodies:
        yield partial(_fly, problem, body)
        yield partial(_search_frames, problem, body)
    if problem.rig is None:
        yield partial(_match_dense_image, problem, Body(rng.normal(size=(DENSE, 3)), others))


def _search_frames(problem: Problem, body: Body) -> None:
    """Matches of frames by themselves: all points, few, and crowded ones."""
    view = _View(problem, body.points)
    n = len(body.points)
    for shown, clutter in ((n, 2), (n, 60)) if n > SMALL else ((n, 2), (6, 1), (n, 60)):
        options = {"sampler": Guided(budget=BUDGET), **body.options} if clutter > 2 else body.options
        matcher = Matcher(body.points, problem, noise=view.sigma, **options)
        found = matcher.match(view.frame(0, shown, clutter))
        _ = found.score, found.confidence, found.pose
    matcher.match(view.frame(0, n, 60, wide=True))
    elsewhere = body.points.copy()  # of another body, which is alike
    half = elsewhere[n // 2 :]
    half += 0.02 * view.radius * np.random.default_rng(0).normal(size=half.shape)
    matcher.match(_View(problem, elsewhere).frame(0, n, 2))


def _match_dense_image(problem: Problem, body: Body) -> None:
    """A match of an image that is dense for its noise."""
    view = _View(problem, body.points)
    Matcher(body.points, problem, noise=VAGUE * view.sigma, **body.options).match(view.frame(0, len(body.points), 2))


def _fly(problem: Problem, body: Body) -> None:
    """A flight with every kind of loss."""
    view, n = _View(problem, body.points), len(body.points)
    tracker = Tracker(body.points, problem, noise=view.sigma, **{"sampler": Guided(budget=BUDGET), **body.options})
    kinds = [(0, n, 2), (1, n, 2), (2, n, 2), (3, 4, 1), (4, 3, 0), (5, 0, 3), (6, 0, 3)]
    kinds += [(7, 2, 0), (8, n, 30)]  # two points leave much of the pose open
    kinds += [(100 + k, n, 4) for k in range(4)]  # as if it had jumped
    kinds += [(104 + k, max(n // 2, 4), 25) for k in range(4)]
    for number, shown, clutter in kinds:
        found = tracker.update(view.frame(number, shown, clutter))
        _ = found.confidence, found.pose
    if "bodies" not in body.options:
        R, t = view.pose(kinds[-1][0])
        wrong = Pose(R, t + 0.5 * view.radius, 1e-4 * np.eye(6))
        tracker.update(view.frame(108, n, 4), prior=wrong)
    tracker.reset()
    tracker.update(view.frame(200, max(n // 2, 4), 8))


class _View:
    """Images of a body that moves before a camera, or a rig, of a problem.

    ``facing``: normals (n, 3) and the angle in radians from which points are not seen; none by default.
    """

    def __init__(self, problem: Problem, points: Floats, facing: tuple[Any, Any] = (None, None)) -> None:
        self.points, (self.normals, angle) = points, facing
        self.cosine = np.cos(0.5 * np.pi if angle is None else np.asarray(angle, np.float64))
        self.centre = points.mean(axis=0)
        self.radius = float(np.linalg.norm(points - self.centre, axis=1).max())
        camera = problem.camera  # type: ignore[attr-defined]
        self.rig = isinstance(camera, Rig)
        self.cameras = [(camera, np.eye(3), np.zeros(3))]
        if isinstance(camera, Rig):
            self.cameras = list(zip(camera.cameras, camera.rotations, camera.translations, strict=True))
        self.of_rays = problem.noise_is_angular
        self.sigma = SIGMA_RADIANS if self.of_rays else SIGMA
        self.axis = np.array(getattr(problem, "vertical_world", (0.3, 1.0, 0.2)), np.float64)
        self.axis /= np.linalg.norm(self.axis)
        self.upright = Rotation.align_vectors(getattr(problem, "vertical_camera", self.axis), self.axis)[0].as_matrix()

    def pose(self, number: int) -> tuple[Floats, Floats]:
        """Rotation (3, 3) and translation (3,) of the body in a frame."""
        R = self.upright @ one_rotation_matrix(self.axis * 0.02 * number)
        _, rotation, translation = self.cameras[0]
        ahead = np.array([0.002 * number, 0.0, DISTANCE]) * self.radius
        return R, rotation.T @ (ahead - translation) - R @ self.centre

    def frame(self, number: int, shown: int, clutter: int, *, wide: bool = False) -> Any:
        """Detections of a frame: points in each camera, and clutter about them, or wherever it sees.

        ``clutter`` is of all cameras together: a rig of many would be searched for minutes otherwise.
        """
        rng, (R, t) = np.random.default_rng(number), self.pose(number)
        rows, index = [], []
        for k, (camera, turn, move) in enumerate(self.cameras):
            places = (self.points @ R.T + t) @ turn.T + move
            seen = camera.sees(places)
            if self.normals is not None:
                outward = np.asarray(self.normals, np.float64) @ R.T @ turn.T
                away = -(outward * places).sum(axis=1)
                seen &= away > self.cosine * np.linalg.norm(outward, axis=1) * np.linalg.norm(places, axis=1)
            seen = np.flatnonzero(seen)[:shown]
            with np.errstate(all="ignore"):
                pixels = places / places[:, 2:] if self.of_rays else camera.project(places)
            known = pixels[np.isfinite(pixels).all(axis=1) & camera.sees(places)]
            noisy = pixels[seen] + self.sigma * rng.normal(size=(len(seen), pixels.shape[1]))
            low, high = (known.min(axis=0), known.max(axis=0)) if len(known) else np.zeros((2, pixels.shape[1]))
            many = -(-clutter // len(self.cameras)) if len(known) else 0
            if wide:
                more = self._scatter_directions(camera, rng.normal(size=(2 * many, 3)))
            else:
                more = rng.uniform(low - 9 * self.sigma, high + 9 * self.sigma, (many, pixels.shape[1]))
            rows.append(np.concatenate([noisy, more]))
            index.append(np.full(len(rows[-1]), k))
        target = np.concatenate(rows)
        if self.of_rays:
            return target / np.linalg.norm(target, axis=1, keepdims=True)
        return (target, np.concatenate(index)) if self.rig else target

    def _scatter_directions(self, camera: CameraModel, directions: Floats) -> Floats:
        """Those of some directions (k, 3) that an image can show; that of a wide lens shows more than 60°."""
        if self.of_rays:
            return directions
        with np.errstate(all="ignore"):
            middle, beside = camera.project(np.array([[0.0, 0.0, 1.0], [0.01, 0.0, 1.0]]))
            away = camera.project(directions)
            near = np.linalg.norm(away - middle, axis=1) < WIDEST * np.linalg.norm(beside - middle) / 0.01
        return np.asarray(away[near & camera.sees(directions)])
