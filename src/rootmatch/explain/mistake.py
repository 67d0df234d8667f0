"""A mistake that people make about an input; those about known poses, and about two point sets of one space."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import combinations, permutations, product
from typing import Any, NamedTuple

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.explain.prior_validation import Prior, prior_attributes
from rootmatch.explain.task import MatchingTask
from rootmatch.problems.points import PointSets
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.pose_prior import update_with_vertical
from rootmatch.problems.similarity import Rigid, Similarity

Change = Callable[[MatchingTask], MatchingTask]
"""Corrects a task, by its deadline."""
METRES = {"metres": 1.0, "feet": 0.3048, "inches": 0.0254, "centimetres": 1e-2, "millimetres": 1e-3}
"""Units of length, the largest first."""
METRIC = [(one, other) for short in ("millimetres", "centimetres") for one, other in permutations((short, "metres"))]
"""Units in which one thing may be given, and in which the others are."""
UNITS = [*METRIC, *product(("feet", "inches"), ("metres", "millimetres"))]
"""Units in which a model may be given before a rig, and in which the rig is."""
COARSEST = 0.1
"""Noise of a set of points, over its size, from which it may be in another unit. A round value."""
FLAT = 1e-9
"""Height of a set, over its size, that is a rounding error."""
NEAR = 0.05
"""Relative deviation from their ratio within which units are named: less than half of the least gap between two."""
HANDED, HANDED_MODEL = "one of the sets is left-handed", "the model is left-handed"
REVERSED = (
    "negate one coordinate of one of the sets: an axis was reversed when it was written (LPS and RAS differ in "
    "two axes, which is only a rotation)"
)
UNIT = "the sets have different units"


def ratio_of_units(one: str, other: str) -> float:
    """How many times a unit of length is as large as another one."""
    return METRES[one] / METRES[other]


def make_change(**changes: Any) -> Change:
    """Other values of some attributes of a task, which is then tried without what is known of the pose."""
    return lambda task: replace(task.without_priors(), **changes)


def scale_noise(points: PointSets, source: float, target: float) -> PointSets:
    """Points whose noise is so many times as large, that of each set."""
    covariances = [
        None if known is None else factor**2 * known
        for known, factor in ((points.source_covariance, source), (points.target_covariance, target))
    ]
    of_model = points.target_noise**2 - points.detection_noise**2  # which no noise of detections enlarges
    return replace(
        points,
        source_noise=source * points.source_noise,
        target_noise=np.sqrt((target * points.detection_noise) ** 2 + of_model),
        noise_alone=None if points.noise_alone is None else target * points.noise_alone,
        source_covariance=covariances[0],
        target_covariance=covariances[1],
    )


def mirror_source(points: PointSets, axis: Floats) -> PointSets:
    """The same with a source that is mirrored along a unit axis (k,), with its normals."""
    mirror = np.eye(len(axis)) - 2.0 * np.outer(axis, axis)
    normals = None if points.normals is None else points.normals @ mirror
    spread = None if points.source_covariance is None else mirror @ points.source_covariance @ mirror
    return replace(points, source=points.source @ mirror, normals=normals, source_covariance=spread)


class Mistake(NamedTuple):
    """What may be wrong, what to do about it, and how a task is corrected."""

    name: str
    remedy: str
    change: Change
    if_nothing_fits: bool = False
    """Whether it is tried only if no mistake before it explains the points: two at once, or the same in another way."""
    complete: Callable[[Mistake, Any], Mistake] | None = None
    """Adds to the name what the trusted match of the corrected task found, such as a scale."""
    fitted: int = 0
    """Number of values that the change fitted to the points, which is no prediction of them."""
    rivals: tuple[Change, ...] = ()
    """Changes of the same size that mean nothing: what fits as well with one of them tells of no mistake."""


def list_prior_mistakes(task: MatchingTask) -> Iterator[Mistake]:
    """Mistakes about what is known of the poses of a task."""
    if not task.has_prior:
        return
    remedy = "give the pose that takes the points to the target, x' = R x + t: `pose.inverse()`"
    yield from _change_priors(task, "the prior is the inverse of the pose", remedy, _invert_prior)
    for wrong, right in METRIC:
        name = f"the position of the prior is in {wrong}, the points are in {right}"
        change = partial(_scale_prior, ratio_of_units(wrong, right))
        yield from _change_priors(task, name, "use one unit for points and prior", change)
    remedy = "check its frame and its σ, or leave `prior=` out"
    yield Mistake("what is known of the pose is wrong", remedy, MatchingTask.without_priors, if_nothing_fits=True)


def _change_priors(
    task: MatchingTask, name: str, remedy: str, change: Callable[[Prior], Prior | None]
) -> Iterator[Mistake]:
    """The mistake of all that is known of poses, if any of it can be changed so."""
    one: Prior | None = task.prior_pose or task.known
    each = {label: new for label, known in task.priors.items() if (new := change(known)) is not None}
    attributes = prior_attributes(each if one is None else change(one))
    if any(attributes.values()):
        yield Mistake(name, remedy, make_change(**attributes))


def _invert_prior(known: Prior) -> Prior | None:
    """What is known if the inverse was given; None if that tells nothing."""
    if isinstance(known, Pose):
        return known.inverse()
    if known.rotation is None:
        return None
    R, covariance = (np.asarray(part, np.float64) for part in known.rotation)
    if known.place is None:
        return replace(known, rotation=(R.T, R.T @ covariance @ R))
    both = np.zeros((6, 6))
    both[:3, :3], both[3:, 3:] = covariance, known.place[1]
    pose = Pose(R, known.place[0], both).inverse()
    return pose if known.vertical is None else update_with_vertical(pose, *known.vertical)  # type: ignore[arg-type]


def _scale_prior(factor: float, known: Prior) -> Prior | None:
    """What is known with another unit of its position; None if it has none."""
    if isinstance(known, Pose):
        assert known.covariance is not None
        sizes = np.ones(len(known.covariance))
        sizes[3:6] = factor
        return replace(known, t=factor * known.t, covariance=known.covariance * sizes * sizes[:, None])
    if known.place is None:
        return None
    t, covariance = known.place
    return replace(known, position=(factor * t, factor**2 * covariance))


def list_point_set_mistakes(problem: Similarity, given: PointSets) -> Iterator[Mistake]:
    """Mistakes about the points of `Rigid` or `Similarity`."""
    mirrored, handed = mirror_source(given, np.eye(given.source.shape[1])[0]), not _is_flat(given)
    if handed:
        yield Mistake(HANDED, REVERSED, make_change(points=mirrored))
    if not isinstance(problem, Rigid):
        return
    free, remedy = Similarity(problem.dimension), "use one unit, or Similarity(), which finds the scale"
    for is_mirrored in (False, True)[: 1 + handed]:
        name, how = (f"{HANDED}, and {UNIT}", f"{REVERSED}; {remedy}") if is_mirrored else (UNIT, remedy)
        for k, (points, is_own) in enumerate(_unit_noises(mirrored if is_mirrored else given)):
            told = how if is_own else f"{how}; give the noise of each set in its own unit"
            change = make_change(problem=free, points=points)
            yield Mistake(name, told, change, if_nothing_fits=is_mirrored or k > 0, complete=_with_scale)


def _is_flat(points: PointSets) -> bool:
    """Whether the source lies in a plane of its space, but for its noise: such a set is its own mirror image."""
    source = points.source
    heights = np.linalg.svd(source - source.mean(axis=0), compute_uv=False)
    off = float(heights[-1]) / math.sqrt(len(source))
    return off <= max(float(np.max(points.source_noise)), FLAT * float(heights[0]))


def _with_scale(mistake: Mistake, match: Any) -> Mistake:
    """A mistake about units with the factor that was found, or about the scale if it is that of no two units.

    Of several bodies, the median of those that are trusted.
    """
    found = [match] if match.bodies is None else [one for one in match.bodies.values() if one]
    scale = float(np.median([one.pose.scale for one in found]))
    factor = max(scale, 1.0 / scale)
    larger, smaller = ("target", "source") if scale > 1.0 else ("source", "target")
    units = [names for names in combinations(METRES, 2) if abs(math.log(factor / ratio_of_units(*names))) < NEAR]
    if units:
        told = f"the {larger} is {factor:.4g} times the {smaller} ({' and '.join(units[0])}?)"
        return mistake._replace(name=f"{mistake.name}: {told}")
    remedy = mistake.remedy.replace("use one unit, or", "check the scale of both sets, or use")
    return mistake._replace(name=mistake.name.replace(UNIT, f"a scale of {scale:.4g} fits"), remedy=remedy)


def _unit_noises(points: PointSets) -> list[tuple[PointSets, bool]]:
    """The noise of each set as if given in its own unit (True), and as if both were in that of one set; least first.

    Where it is that of an exact set, or is far too large for its set, it is not meant so.
    """
    sizes = [float(np.linalg.norm(some - some.mean(axis=0), axis=1).mean()) for some in (points.source, points.target)]
    ratio = max(sizes[1], 1e-300) / max(sizes[0], 1e-300)
    every: dict[float, tuple[PointSets, bool]] = {}
    for factors in ((1.0, 1.0), (1.0, ratio), (1.0 / ratio, 1.0)):
        changed = scale_noise(points, *factors)
        sigmas = changed.source_noise, changed.target_noise
        relative = max(float(np.max(sigma)) / max(size, 1e-300) for sigma, size in zip(sigmas, sizes, strict=True))
        every.setdefault(relative, (changed, factors == (1.0, 1.0)))
    sound = [relative for relative in every if relative < COARSEST] or [min(every)]
    return [every[relative] for relative in sorted(sound)]


def format_scaled(noise: Any, factor: float) -> str:
    """The argument for a number or two, so many times as large; how many times that is, of more."""
    if isinstance(noise, tuple | list) and all(isinstance(one, int | float) for one in noise):
        return f"`noise=({', '.join(f'{factor * one:.3g}' for one in noise)})`"
    return (
        f"`noise={factor * noise:.3g}`" if isinstance(noise, int | float) else f"a `noise=` {factor:.2g} times as large"
    )
