"""Diagnosis of an input that does not match: the usual mistakes, each tried and weighed by its evidence."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from rootmatch.cameras.brown import Brown
from rootmatch.cameras.kannala_brandt import KannalaBrandt
from rootmatch.cameras.pinhole import Camera
from rootmatch.cameras.rig import Rig
from rootmatch.cameras.unit_rays import UnitRays
from rootmatch.deadline import Deadline
from rootmatch.errors import InputError
from rootmatch.explain.decide import TRUST, Status
from rootmatch.explain.explain import explain
from rootmatch.explain.finding import Finding
from rootmatch.explain.goodness_of_fit import Misfit
from rootmatch.explain.task import MatchingTask
from rootmatch.problems.points import PointSets
from rootmatch.problems.similarity import Rigid, Similarity

FACTORS = (3.0, 10.0)
"""Factors by which σ may have been stated too small. Round values."""
NOISIER = {f"the noise is {factor:g} times as large": factor for factor in FACTORS}
"""The factor of each mistake of that kind."""
FEWEST_FREEDOM = 6
"""Degrees of freedom of a match that tell a factor on σ, those of four points in space: three stray points look like
noise as easily."""
COARSEST = 0.1
"""Noise of a set of points, over its size, from which it may be in another unit. A round value."""


@dataclass(frozen=True)
class Trial:
    """One possible mistake, and the match after correcting it.

    Parameters
    ----------
    mistake : str
        The mistake; empty for the input as given.
    remedy : str
        What to change.
    status : Status
    matched : int
        Number of matches.
    log_odds : float or None
        Log-odds of the match against clutter alone, see `rootmatch.Match.log_odds`.
    probability : float or None
        Probability that this is the mistake, among all that were tried, the input as given, and the absence of the
        object. All mistakes have the same prior probability, and together that of the input as given.
    borne_out : bool
        False if the noise is said to be larger, and the residuals of the match do not show it.
    """

    mistake: str
    remedy: str
    status: Status
    matched: int
    log_odds: float | None
    probability: float | None = None
    borne_out: bool = True

    def __str__(self) -> str:
        odds = "" if self.log_odds is None else f", log-odds {self.log_odds:.1f}"
        told = self.mistake or "as given"
        return f"{told}: {self.status.name.lower()}, {self.matched} points{odds}"


@dataclass(frozen=True)
class Diagnosis:
    """The trials, the best explanation first.

    Parameters
    ----------
    given : Trial
        The input as it was given.
    trials : tuple of Trial
        Each mistake that could be tried in time.
    left_out : int
        Number of mistakes for which there was no time.
    """

    given: Trial
    trials: tuple[Trial, ...]
    left_out: int = 0

    @property
    def fits(self) -> tuple[Trial, ...]:
        """Mistakes that would explain the points: their match is trusted and more probable than the input as given."""
        before = -math.inf if self.given.log_odds is None else self.given.log_odds
        trusted = [one for one in self.trials if one.status is Status.MATCHED and one.borne_out]
        return tuple(one for one in trusted if one.log_odds is None or one.log_odds > max(before, 0.0))

    def __str__(self) -> str:
        late = f"; no time for {self.left_out} more" if self.left_out else ""
        if not self.fits:
            return f"diagnosis: none of {len(self.trials)} usual mistakes explains the points{late} ({self.given})"
        lines = [f"diagnosis: {one}; {one.remedy}" for one in self.fits]
        return "\n".join([*lines, f"diagnosis: {self.given}{late}"])


def diagnosed(match: Any, judge: Callable[[Finding], Any], max_seconds: float) -> Diagnosis:
    """Try the usual mistakes; see `rootmatch.Match.diagnose`.

    Parameters
    ----------
    match : rootmatch.Match
        Of the input as it was given.
    judge : callable
        Makes the match of a finding; passed in because this package is a layer below.
    max_seconds : float
        Time limit for all trials together.
    """
    given = _trial("", "", match)
    task = match.task.without_priors()
    mistakes = list(_mistakes(task))
    deadline, trials = Deadline(max_seconds), []
    for k, (mistake, remedy, change) in enumerate(mistakes):
        seconds = deadline.left() / (len(mistakes) - k)  # time that one leaves is for the others
        if seconds <= 0.0:
            break
        options = replace(task.options, max_seconds=seconds, progress=None)
        try:
            found = judge(explain(replace(change(), options=options, deadline=Deadline(seconds))))
            trials.append(_trial(mistake, remedy, found))
        except InputError:  # such as pixels where the changed lens shows nothing
            trials.append(Trial(mistake, remedy, Status.UNTRUSTED, 0, None))
    weighed = _weighed(given, trials)
    ranked = sorted(weighed, key=lambda one: -math.inf if one.log_odds is None else one.log_odds, reverse=True)
    return Diagnosis(given, tuple(ranked), len(mistakes) - len(trials))


def _trial(mistake: str, remedy: str, match: Any) -> Trial:
    matched = int((match.assignment >= 0).sum())
    # for an untrusted match, they may take longer to compute than the match did
    known = match.finding.log_odds if match.status is Status.UNTRUSTED else match.log_odds
    borne_out = _is_borne_out(NOISIER[mistake], match.finding) if mistake in NOISIER else True
    return Trial(mistake, remedy, match.status, matched, known if matched else None, borne_out=borne_out)


def _is_borne_out(factor: float, found: Finding) -> bool:
    """Whether the residuals of a match with a larger σ would be rare with the σ that was given.

    With few matches, or points on a line, a larger σ may let a match be found that the given one fits as well.
    """
    if found.noise_factor is None:
        return True  # nothing tells
    if found.noise_dof < FEWEST_FREEDOM:
        return False
    sigma = factor * found.noise_factor
    return Misfit(sigma**2, sigma, found.noise_dof).chance < TRUST.noise_chance


def _weighed(given: Trial, trials: list[Trial]) -> list[Trial]:
    """The trials with their probabilities."""
    every = [given, *trials]
    if not trials:
        return []
    prior = [math.log(0.5)] + [math.log(0.5 / len(trials))] * len(trials)
    odds = [-math.inf if one.log_odds is None else one.log_odds + p for one, p in zip(every, prior, strict=True)]
    terms = np.array([0.0, *odds])  # nothing is to be found
    terms = np.exp(terms - terms.max())
    shares = (terms / terms.sum())[2:].tolist()
    return [replace(one, probability=share) for one, share in zip(trials, shares, strict=True)]


Change = Callable[[], MatchingTask]
Mistake = tuple[str, str, Change]


def _mistakes(task: MatchingTask) -> Iterator[Mistake]:
    """Possible mistakes, each with its remedy and the corrected task; the commonest first."""
    problem, points = task.problem, task.points

    def pointed(**changes: Any) -> Change:
        return lambda: replace(task, points=replace(points, **changes))

    def posed(**changes: Any) -> Change:
        return lambda: replace(task, problem=replace(problem, **changes))  # type: ignore[type-var]

    names = [name for name in ("camera", "camera2") if getattr(problem, name, None) is not None]
    cameras = {name: getattr(problem, name) for name in names}

    def filmed(change: Callable[[Camera], Camera]) -> Change:
        return posed(**{name: _changed(camera, change) for name, camera in cameras.items()})

    if isinstance(problem, Similarity):  # Rigid too
        yield from _of_point_sets(problem, task, pointed)
    else:
        yield from _of_axes(task, cameras, pointed)
    if points.normals is not None:
        yield "the normals point inwards", "negate nx, ny and nz", pointed(normals=-points.normals)
        yield "the normals are wrong", "leave them out", pointed(normals=None, view_cosine=None)
    if hasattr(problem, "vertical_world"):
        upside = tuple(-np.asarray(problem.vertical_world, float))
        remedy = "negate vertical_world or vertical_camera: both point down, or both up (an accelerometer measures up)"
        yield "one of the verticals is upside down", remedy, posed(vertical_world=upside)
    if hasattr(problem, "axis2"):
        upside = tuple(-np.asarray(problem.axis2, float))
        yield "one of the axes is reversed", "negate axis or axis2", posed(axis2=upside)
    yield from _of_lenses(cameras, filmed)
    if not task.estimates_noise:
        if any(isinstance(camera, UnitRays) for camera in cameras.values()):
            unit = math.radians(1.0)
            remedy = "give the noise of rays in radians: np.radians(...)"
            yield "the noise is in degrees", remedy, pointed(target_noise=unit * points.target_noise)
        for mistake, factor in NOISIER.items():
            yield mistake, f"give noise= {factor:g} times as large", pointed(**_noisier(points, factor))


def _of_point_sets(problem: Similarity, task: MatchingTask, pointed: Callable[..., Change]) -> Iterator[Mistake]:
    mirror = np.array([-1.0, 1.0, 1.0])[: task.points.source.shape[1]]
    remedy = "negate one coordinate of one of the sets"
    yield "one of the sets is left-handed", remedy, pointed(source=task.points.source * mirror)
    if isinstance(problem, Rigid):
        scaled = Similarity(problem.dimension)
        remedy = "use one unit, such as millimetres, or Similarity, which finds the scale"
        points = _with_noise_in_each_unit(task.points)
        yield "the sets have different units", remedy, lambda: replace(task, problem=scaled, points=points)


def _noisier(points: PointSets, factor: float) -> dict[str, Any]:
    """The noise of both sets, so many times as large."""
    known = points.target_covariance
    return {
        "source_noise": factor * points.source_noise,
        "target_noise": factor * points.target_noise,
        "target_covariance": None if known is None else factor**2 * known,
    }


def _with_noise_in_each_unit(points: PointSets) -> PointSets:
    """The noise of the set in whose unit it is, relative to the size of the set, for both sets.

    One number that is meant for sets of one unit is far too large for the set of the larger unit, or too small for the
    other one.
    """
    sizes = [float(np.linalg.norm(some - some.mean(axis=0), axis=1).mean()) for some in (points.source, points.target)]
    sigmas = points.source_noise, points.target_noise
    relative = [float(np.max(sigma)) / max(size, 1e-300) for sigma, size in zip(sigmas, sizes, strict=True)]
    sound = [one for one in relative if one < COARSEST] or [min(relative)]
    noises = [
        sigma if one in (0.0, max(sound)) else np.full_like(sigma, max(sound) * size)
        for sigma, one, size in zip(sigmas, relative, sizes, strict=True)
    ]
    return replace(points, source_noise=noises[0], target_noise=noises[1])


def _of_axes(task: MatchingTask, cameras: dict[str, Any], pointed: Callable[..., Change]) -> Iterator[Mistake]:
    """Axes of images and models; a pose cannot tell a mirrored image from a mirrored model."""
    points, camera = task.points, cameras.get("camera")
    flat = points.source.shape[1] == 2
    if isinstance(camera, Rig):
        mirrored = {"source": points.source * (-1.0, 1.0, 1.0)}
        if points.normals is not None:
            mirrored["normals"] = points.normals * (-1.0, 1.0, 1.0)
        yield "the model is left-handed", "negate one coordinate of points and normals", pointed(**mirrored)
        inverse = Rig([(own, np.array(R).T, -np.array(R).T @ np.array(t)) for own, R, t in camera.views], camera.sizes)
        remedy = "give each camera with x_camera = R x_rig + t: the inverse"
        yield "poses of the cameras map to the rig", remedy, lambda: _with_camera(task, inverse)
        return
    centres = [_centre(cameras.get("camera2") or camera, task), _centre(camera, task)]

    def mirrored_along(axis: int) -> Change:
        changed = {}
        for name, centre in zip(("target", "source") if flat else ("target",), centres, strict=False):
            changed[name] = getattr(points, name).copy()
            changed[name][:, axis] = 2.0 * centre[axis] - changed[name][:, axis]
        return pointed(**changed)

    remedy = "give y downwards (image height − y), or negate one coordinate of the model and of its normals"
    yield "y is measured upwards in the image, or the model is left-handed", remedy, mirrored_along(1)
    if hasattr(task.problem, "vertical_world"):  # which tells these two apart
        yield (
            "x is mirrored, or the model is left-handed",
            "mirror x, or one level axis of the model",
            mirrored_along(0),
        )
    if points.target.shape[1] == 2:
        swapped = {"target": points.target[:, ::-1].copy()}
        if flat:
            swapped["source"] = points.source[:, ::-1].copy()
        yield "x and y of the image are exchanged", "give columns x, y: np.array(...)[:, ::-1]", pointed(**swapped)


def _of_lenses(cameras: dict[str, Any], filmed: Callable[[Callable[[Camera], Camera]], Change]) -> Iterator[Mistake]:
    if not any(isinstance(camera, Camera | Rig) for camera in cameras.values()):
        return
    for factor, size in ((2.0, "half"), (0.5, "twice")):
        mistake = f"the camera was calibrated at {size} the size of the image"
        yield mistake, f"multiply fx, fy, cx and cy by {factor:g}", filmed(partial(_scaled, factor))
    lenses = [one.lens for camera in cameras.values() for one in getattr(camera, "cameras", (camera,))]
    if any(isinstance(lens, Brown) and len(lens.values) in (4, 5) for lens in lenses):
        remedy = "use Camera.from_opencv_fisheye(K, D)"
        yield "the lens' coefficients are those of a fisheye", remedy, filmed(_as_fisheye)
    if any(isinstance(lens, KannalaBrandt) for lens in lenses):
        yield "the lens' coefficients are Brown's", "use Camera.from_opencv(K, dist)", filmed(_as_brown)
    if any(lens is not None for lens in lenses):
        remedy = "give raw pixels, or leave the lens out"
        yield "the detections were undistorted already", remedy, filmed(lambda own: Camera(*own.numbers))
    remedy = "check the order: fx, fy, cx, cy"
    yield "cx and cy are exchanged", remedy, filmed(lambda own: Camera(own.fx, own.fy, own.cy, own.cx, own.lens))
    for half in (0.5, -0.5):
        remedy = f"add {half:g} to cx and cy: OpenCV counts the first pixel's centre as (0, 0), COLMAP as (0.5, 0.5)"
        yield "the principal point is off by half a pixel", remedy, filmed(partial(_shifted, half))


def _changed(camera: Any, change: Callable[[Camera], Camera]) -> Any:
    """A camera, or each camera of a rig, with a change; anything but a `Camera` stays as it is."""
    if isinstance(camera, Rig):
        return Rig([(_changed(own, change), R, t) for own, R, t in camera.views], camera.sizes)
    return change(camera) if isinstance(camera, Camera) else camera


def _with_camera(task: MatchingTask, camera: Any) -> MatchingTask:
    return replace(task, problem=replace(task.problem, camera=camera))  # type: ignore[type-var]


def _centre(camera: Any, task: MatchingTask) -> tuple[float, float]:
    """Principal point; the origin for rays, and the problem's centre for a camera of unknown focal length."""
    if isinstance(camera, Camera):
        return camera.cx, camera.cy
    x, y = getattr(task.problem, "centre", (0.0, 0.0))
    return float(x), float(y)


def _scaled(factor: float, camera: Camera) -> Camera:
    fx, fy, cx, cy = camera.numbers
    return Camera(factor * fx, factor * fy, factor * cx, factor * cy, camera.lens)


def _shifted(by: float, camera: Camera) -> Camera:
    return Camera(camera.fx, camera.fy, camera.cx + by, camera.cy + by, camera.lens)


def _as_fisheye(camera: Camera) -> Camera:
    return Camera(*camera.numbers, KannalaBrandt(camera.lens.values[:4])) if isinstance(camera.lens, Brown) else camera


def _as_brown(camera: Camera) -> Camera:
    return Camera(*camera.numbers, Brown(camera.lens.values)) if isinstance(camera.lens, KannalaBrandt) else camera
