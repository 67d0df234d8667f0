"""Bodies of a family may have been taken for each other: in space each is also expected in the other's place at times.

Two bodies that share most of their points explain each other's detections nearly as well, and a prediction counts for
whatever was followed. So nothing else notices that a frame which showed little told them the wrong way round. Before
cameras the prior of every frame has these places: see `rootmatch.model.exchanged`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.explain.body_labels import BodyLabels, Label
from rootmatch.explain.likeness import align_points, likenesses
from rootmatch.problems.pose_fit.reference_point import body_radius
from rootmatch.tracking.followed_body import FollowedBody


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
