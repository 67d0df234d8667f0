"""What people get wrong about a pose that they know: its direction, its unit, all of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import permutations

import numpy as np

from rootmatch.explain.mistake import Mistake, make_change, ratio_of_units
from rootmatch.explain.prior_validation import Prior, prior_attributes
from rootmatch.explain.task import MatchingTask
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.pose_prior import update_with_vertical

METRIC = [(one, other) for short in ("millimetres", "centimetres") for one, other in permutations((short, "metres"))]
"""Units in which one thing may be given, and in which the others are."""


def list_prior_mistakes(task: MatchingTask) -> Iterator[Mistake]:
    """Mistakes about what is known of the poses of a task."""
    if not task.has_prior:
        return
    remedy = "give x' = R x + t, points to target: pose.inverse()"
    yield from _change_priors(task, "the prior is the inverse of the pose", remedy, _invert_prior)
    for wrong, right in METRIC:
        name = f"the position of the prior is in {wrong}, the points are in {right}"
        change = partial(_scale_prior, ratio_of_units(wrong, right))
        yield from _change_priors(task, name, "use one unit for points and prior", change)
    remedy = "check its frame and its σ, or leave prior= out"
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
