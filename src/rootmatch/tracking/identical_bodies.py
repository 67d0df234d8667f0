"""Identical bodies keep the names that they got when they were first seen.

Which of two identical tools is the first one is a convention that no image tells: a frame shows a tool here and a tool
there, and is ambiguous for either. From frame to frame they differ, as each has a motion. So each place that a frame
shows for certain is given to one body of the group, and no other body of the group follows it.

Bodies of a family, which share most of their points, may have been taken for each other: they explain each other's
detections nearly as well, and a prediction counts for whatever was followed. So nothing else notices that a frame which
showed little told them the wrong way round. In space each is also expected in the other's place at times; before
cameras the prior of every frame has these places: see `rootmatch.model.exchanged`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.explain.body_labels import SAME_SHAPE, BodyLabels, Label, twin_points
from rootmatch.explain.finding import Finding, mode_pose
from rootmatch.explain.likeness import align_points, likenesses
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.reference_point import body_radius
from rootmatch.tracking.followed_body import FollowedBody
from rootmatch.tracking.followed_pose import FollowedPose
from rootmatch.tracking.in_plane import motion_in_space
from rootmatch.tracking.motion_filter import ALIKE, MotionFilter

Groups = Sequence[Sequence[Label]]

DECIDED = 0.9
"""Share of a followed pose from which it is where the body is. A round value."""


def find_identical_bodies(labels: BodyLabels, points: Floats, normals: Floats | None) -> Groups:
    """Groups of bodies with the same points, in any order, and the same normals; of all points (n, 3)."""
    groups: list[list[Label]] = []
    of: dict[Label, Integers] = {name: labels.points_of(k) for k, name in enumerate(labels.names)}
    for name in labels.names:
        group = next((one for one in groups if _is_same(points, normals, of[one[0]], of[name])), None)
        if group is None:
            groups.append(group := [])
        group.append(name)
    return [group for group in groups if len(group) > 1]


def name_places(
    groups: Groups,
    bodies: Mapping[Label | None, FollowedBody],
    parts: Mapping[Label | None, Finding],
    time: float,
) -> None:
    """Let bodies of each group follow the places that a frame shows for certain, one each.

    ``bodies``, ``parts``: the bodies with what they follow after the frame, and its findings.
    """
    for group in groups:
        beliefs = {label: bodies[label].belief for label in group}
        radius = body_radius(beliefs[group[0]].source)
        free = {label: one for label, one in beliefs.items() if not one or one.shares[0] < DECIDED}
        taken = [_current_pose(one.best) for label, one in beliefs.items() if label not in free]
        for place in _places([parts[label] for label in group], radius):
            if not free or any(_is_same_place(place, other, radius) for other in taken):
                continue
            # the one that the frame has there, so that nobody sees the names change
            there = [label for label in free if (pose := parts[label].pose) and _is_same_place(pose, place, radius)]
            belief = free.pop(there[0] if there else next(iter(free)))
            known = [one for one in belief.poses if _is_same_place(_current_pose(one.filter), place, radius)]
            belief.poses = known or [FollowedPose(MotionFilter(belief.source, place, time, belief.motion))]
            taken.append(place)
        for belief in free.values():
            every = [(one, _current_pose(one.filter)) for one in belief.poses]
            belief.poses = [one for one, at in every if not any(_is_same_place(at, there, radius) for there in taken)]


def _places(found: Sequence[Finding], radius: float) -> Iterator[Pose]:
    """Poses that one body or another of a group has for certain, the most certain ones first."""
    minimum, every = found[0].facts.min_probability, list[tuple[float, Pose]]()
    for one in found:
        if one.posterior is not None and one.model is not None:
            modes = one.posterior.modes
            every += [(float(p), mode_pose(one.model, modes, k)) for k, p in enumerate(one.posterior.probabilities)]
        elif one.labellings is not None:
            likely = one.labellings.probabilities >= 1.0 - minimum
            chances = one.labellings.probabilities[likely].tolist()
            poses = one.task.problem.poses(one.task.points, one.labellings.assignments[likely])
            every += [(p, pose) for p, pose in zip(chances, poses, strict=True) if pose is not None]
    sums: list[tuple[float, Pose]] = []
    for chance, pose in sorted(every, key=lambda one: -one[0]):
        same = [k for k, (_, other) in enumerate(sums) if _is_same_place(pose, other, radius)]
        if same:
            sums[same[0]] = sums[same[0]][0] + chance, sums[same[0]][1]
        else:
            sums.append((chance, pose))
    return (pose for chance, pose in sorted(sums, key=lambda one: -one[0]) if chance >= minimum)


def _current_pose(followed: MotionFilter) -> Pose:
    """The pose that is followed, at the time of the last frame that showed it."""
    return followed.predicted(followed.time)


def _is_same_place(first: Pose, second: Pose, radius: float) -> bool:
    """Whether two poses are of one body: no two are so near each other."""
    (turn, place), (other, there) = (motion_in_space(one.R, one.t) for one in (first, second))
    return bool((turn * other).sum() > ALIKE) and float(np.linalg.norm(place - there)) <= radius * first.scale


def _is_same(points: Floats, normals: Floats | None, first: Integers, second: Integers) -> bool:
    """Whether two bodies have the same points, and the same normals, in one frame: not turned, and no mirror images."""
    order = twin_points(points[first], points[second])
    if order is None:
        return False
    second = second[order]
    same = bool(np.abs(points[first] - points[second]).max() <= SAME_SHAPE * body_radius(points[first]))
    if normals is not None:
        unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        same &= bool(np.abs(unit[first] - unit[second]).max() <= SAME_SHAPE)
    return same


class Likeness(NamedTuple):
    """A motion x' = R x + t that takes many points of one body onto those of another."""

    label: Label
    other: Label
    rotation: Floats
    shift: Floats


def family_likenesses(labels: BodyLabels, points: Floats, identical: Sequence[Sequence[Label]]) -> list[Likeness]:
    """The motions between bodies of a family, of all points (n, 3); the names of identical ones are a convention."""
    of = {name: points[labels.points_of(k)] for k, name in enumerate(labels.names)}
    found = []
    for label, other in permutations(labels.names, 2):
        if any(label in group and other in group for group in identical):
            continue
        for image in likenesses(of[label], of[other]):
            own = np.flatnonzero(image >= 0)
            laid = align_points(of[label][own], of[other][image[own]], body_radius(of[other]))
            if laid is not None:
                found.append(Likeness(label, other, *laid[:2]))
    return found


def expect_exchanged(alike: Sequence[Likeness], bodies: Mapping[Label | None, FollowedBody]) -> None:
    """Expect each body of a family that is followed also where another one is."""
    places = {one.other: bodies[one.other].belief.best for one in alike if bodies[one.other].belief}
    for one in alike:
        body = bodies[one.label].belief
        if body and one.other in places:
            body.add_place(places[one.other].of_body(one.rotation, one.shift, body.source))


def know_others(alike: Sequence[Likeness], bodies: Mapping[Label | None, FollowedBody]) -> None:
    """Tell each body where it is in the places in which others of its family are followed."""
    for body in bodies.values():
        body.belief.others = ()
    for one in alike:
        belief, other = bodies[one.label].belief, bodies[one.other].belief
        if other:
            belief.others = *belief.others, other.best.of_body(one.rotation, one.shift, belief.source)
