"""Which points of one body correspond to those of another that is like it: a copy, a mirror image, or one of a family.

Bodies of a family share most of their points. Where one of them is, another one may be nearly as well, and no search
need have met that.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rootmatch.arrays import Floats, Integers, cache_by_identity, cache_by_values
from rootmatch.explain.body_labels import SAME_SHAPE, twin_points
from rootmatch.explain.task import MatchingTask
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.exact_shapes import Copies
from rootmatch.model.exchanged import Places
from rootmatch.model.near_symmetries import find_symmetries
from rootmatch.model.proposals import Proposals, look_alikes
from rootmatch.problems.noise import mean_deviation
from rootmatch.problems.points import PointClouds, distances
from rootmatch.problems.pose_fit.point_set_fit import fit_point_sets
from rootmatch.problems.pose_fit.reference_point import body_radius
from rootmatch.samplers.point_sets.congruent import GATE, congruent_labellings, is_small
from rootmatch.samplers.point_sets.motions import fit_motions

MINIMUM, SHARE = 4, 0.5
"""Fewest points that bodies of a family share, as three look like any others, and the least share of the smaller one's.
A round value."""
NEARNESS = 0.02, 0.2, 1.0
"""Parts of `SAME_SHAPE` within which they do: where some points of a body are elsewhere, the others are mostly where
they were, and a looser motion would fit all of them badly. Round values."""
OF_BODY = "points", "normals", "view_cosine", "source_covariance", "rate", "resolution", "allowed", "log_weights"
"""What a model of an image has of its body."""
MAX_POINTS = 16
"""Number of points beyond which a body is compared with its copies and mirror images alone: ten milliseconds."""


WAYS, MIN_CHANCE = 4, 1e-4
"""Ways in which bodies are tried in each other's places if their points have errors, and the least chance of points as
far apart as theirs. Round values."""


@cache_by_identity(256)
@cache_by_values(256)
def likenesses(first: Floats, second: Floats) -> tuple[Integers, ...]:
    """For each way in which two bodies are alike, the point (n,) of the second for each of the first; −1 for none.

    They (n, 3), (m, 3) are alike up to `SAME_SHAPE` times the size of the first.
    """
    twin = twin_points(first, second)
    if twin is not None:
        return (twin,)
    if max(len(first), len(second)) > MAX_POINTS:
        return ()
    minimum = max(MINIMUM, SHARE * min(len(first), len(second)))
    proper, mirrored = list[Integers](), list[Integers]()
    for part in NEARNESS:  # with points that agree as nearly as so many do
        # a distance agrees within GATE of the deviations of both of its ends
        variance = 0.5 * (part * SAME_SHAPE * float(distances(first).max()) / GATE) ** 2
        noise = np.full(len(first), variance), np.full(len(second), variance)
        found = congruent_labellings(PointClouds(first, second, *noise, scaled=False, mirror=False), False)
        for known, every in (proper, found.proper), (mirrored, found.mirrored):
            known += [one for one in every[:1] if not known and np.count_nonzero(one >= 0) >= minimum]
    return (*proper, *mirrored)


def ways_alike(first: MatchingTask, second: MatchingTask) -> list[tuple[Integers, Places | None]]:
    """The ways in which a second body may stand where a first one does.

    Of each: the row of the second one's assignment for each of the first (1, C n), as `look_alikes` takes it; and
    `relative_place`.
    """
    source, other = first.points.source, second.points.source
    return [
        (second.sighting_rows(image)[None], relative_place(source, other, image)) for image in likenesses(source, other)
    ]


def look_alike_by_errors(
    places: Proposals, first: tuple[MatchingTask, DetectionModel], second: tuple[MatchingTask, DetectionModel]
) -> list[Proposals]:
    """Poses of a second body in places of a first one, in each way in which they are alike by their points' errors.

    Each body by its task and its model; empty if the points of neither have errors.
    """
    points = [task.points for task, _ in (first, second)]
    if all(one.source_covariance is None for one in points):
        return []
    deviations = [
        np.zeros(len(one.source)) if one.source_covariance is None else mean_deviation(one.source_covariance)
        for one in points
    ]
    (_, model), (task, own) = first, second
    ways = _likenesses_by_errors(points[0].source, points[1].source, *deviations)
    return [look_alikes(places, model.points, own.points, task.sighting_rows(way)[None]) for way in ways]


@cache_by_values(256)
def _likenesses_by_errors(first: Floats, second: Floats, deviations: Floats, others: Floats) -> Integers:
    """Ways (T, n) in which bodies are alike as far as their points are known, the nearest first; see `likenesses`.

    ``deviations`` (n,), ``others`` (m,): standard deviation of a coordinate of each of their points.
    """
    from scipy.special import gammaincc  # slow to import

    clouds = PointClouds(first, second, deviations**2, others**2, scaled=False, mirror=False)
    every = congruent_labellings(clouds, False).proper if is_small(clouds) else np.empty((0, len(first)), np.int64)
    matched = (every >= 0).sum(axis=1)
    every = every[matched >= max(MINIMUM, SHARE * min(len(first), len(second)))]
    if not len(every):
        return np.empty((0, len(first)), np.int64)
    fit = fit_point_sets(clouds, every, False)
    ways = np.lexsort((fit.chi2, -(every >= 0).sum(axis=1)))
    return np.asarray(every[ways[gammaincc(0.5 * fit.dof, 0.5 * fit.chi2)[ways] >= MIN_CHANCE][:WAYS]])


def find_copies(bodies: Sequence[tuple[Floats, DetectionModel]]) -> list[Copies] | None:
    """For each body (points (n, 3), model) whose points have errors, those of the others that may be copies of it.

    None if the points of none have errors.
    """
    measured = [one for one in bodies if one[1].source_covariance is not None]
    if not measured:
        return None
    found: list[Copies] = []
    for points, model in bodies:
        others = [one for one in measured if one[1] is not model and model.source_covariance is not None]
        pairs = [(other, twin_points(points, own)) for own, other in others]
        found.append([(other, image) for other, image in pairs if image is not None])
    return found


def first_exact_copies(models: Sequence[DetectionModel]) -> list[int]:
    """For each model of one image the first that weighs every pose as it does: of one body, of which as much is known.

    Where a body is predicted, only its own model does.
    """
    found = [0]
    for k, model in enumerate(models[1:], start=1):
        found.append(next((first for first in dict.fromkeys(found) if _weigh_alike(models[first], model)), k))
    return found


def _weigh_alike(first: DetectionModel, second: DetectionModel) -> bool:
    """Whether two models of one image are of the same points, and of the same knowledge without a prediction."""
    if not all(np.array_equal(getattr(first, name), getattr(second, name)) for name in OF_BODY):
        return False
    known = first.prior.for_kernels
    return known is not None and not len(known[0][0]) and _is_equal(known, second.prior.for_kernels)


def _is_equal(first: Any, second: Any) -> bool:
    """Whether the numbers of two nested tuples are equal."""
    if not isinstance(first, tuple) or not isinstance(second, tuple):
        return np.array_equal(first, second)
    return len(first) == len(second) and all(map(_is_equal, first, second))


@cache_by_identity(256)
@cache_by_values(256)
def relative_place(first: Floats, second: Floats, image: Integers) -> Places | None:
    """How a second body lies where a first one does if they are alike by an ``image`` of `likenesses`.

    None for a mirror image or a copy: of copies no image tells which one it is, as their names are a convention.
    """
    own, radius = np.flatnonzero(image >= 0), body_radius(second)
    is_copy = len(own) == len(first) == len(second)
    laid = None if is_copy else align_points(second[image[own]], first[own], radius)
    if laid is None:
        return None
    R, t, off = laid
    error = float((off**2).mean())
    return Places(R, R @ second.mean(axis=0) + t - first.mean(axis=0), error * np.repeat([radius**-2.0, 1.0], 3))


def align_points(points: Floats, others: Floats, radius: float) -> tuple[Floats, Floats, Floats] | None:
    """The motion (R, t) that takes points (m, 3) onto others, and by how much (m, 3) it misses these.

    None if it misses one by more than bodies of a shape and this radius may differ, as of a mirror image.
    """
    motion = fit_motions(points[None], others[None], scaled=False, mirror=False)
    R, t = motion.linear[0], motion.shift[0]
    off = points @ R.T + t - others
    return None if np.abs(off).max() > SAME_SHAPE * 2.0 * radius else (R, t, off)


def symmetry_images(task: MatchingTask, mirrored: Sequence[bool] = (False, True)) -> list[Integers]:
    """Row of an assignment at the place of each in the near symmetries of a body: motions, reflections, or both."""
    points, known = task.points, task.points.source_covariance
    found = [one for kind in mirrored for one in find_symmetries(points.source, points.normals, kind, covariance=known)]
    images = {one.image.tobytes(): one.image for one in found}.values()
    return [task.sighting_rows(image) for image in images]
