"""What people get wrong about two point sets of one space: the handedness, the unit, the scale."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from rootmatch.explain.mistake import METRES, Mistake, make_change, ratio_of_units, scale_noise
from rootmatch.problems.points import PointSets
from rootmatch.problems.similarity import Rigid, Similarity

COARSEST = 0.1
"""Noise of a set of points, over its size, from which it may be in another unit. A round value."""
FLAT = 1e-9
"""Height of a set, over its size, that is a rounding error."""
NEAR = 0.05
"""Relative deviation from their ratio within which units are named: less than half of the least gap between two."""
HANDED = "one of the sets is left-handed"
REVERSED = (
    "negate one coordinate of one of the sets: one axis was reversed when it was written "
    "(LPS and RAS differ in two axes, which is a rotation and matches)"
)
UNIT = "the sets have different units"


def list_point_set_mistakes(problem: Similarity, given: PointSets) -> Iterator[Mistake]:
    """Mistakes about the points of `Rigid` or `Similarity`."""
    mirrored = np.array([-1.0, 1.0, 1.0])[: given.source.shape[1]] * given.source
    handed = not _is_flat(given)
    if handed:
        yield Mistake(HANDED, REVERSED, make_change(points=replace(given, source=mirrored)))
    if not isinstance(problem, Rigid):
        return
    free, remedy = Similarity(problem.dimension), "use one unit, or Similarity(), which finds the scale"
    for is_mirrored in (False, True)[: 1 + handed]:
        source = mirrored if is_mirrored else given.source
        name, how = (f"{HANDED}, and {UNIT}", f"{REVERSED}; {remedy}") if is_mirrored else (UNIT, remedy)
        for k, (points, is_own) in enumerate(_unit_noises(replace(given, source=source))):
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
