"""Visibility of a body's points by their normals, compiled."""

from __future__ import annotations

import math

from rootmatch.jit.decorators import part
from rootmatch.model.visibility import BARELY, EDGE, EDGES, FULLY, LOGISTIC, SLACK, UNSEEN

LEAST_SPREAD = 1e-6
"""Spread of a cosine below which it counts as exact."""
MOST_BEYOND = 500.0
"""Exponent beyond which a visibility is nothing in any case."""
SURE = 1.0 - 1e-15
"""Visibility above which a point of a blob counts as that: its logarithm of not being seen stays finite."""


@part
def shown_by_normal(c, edge, limit, tilt):  # type: ignore[no-untyped-def]
    """Visibility of a point whose normal has the cosine ``c``, for a view angle of cosine ``edge``.

    Beyond ``limit`` nothing is seen; ``tilt``: the pose's deviation in direction, rad.
    """
    spread = math.sqrt(1.0 - min(c * c, 1.0)) * tilt
    facing = 1.0 / (1.0 + math.exp(-LOGISTIC * (c - edge) / math.sqrt(EDGE * EDGE + spread * spread)))
    beyond = min(LOGISTIC * (limit - c) / max(spread, LEAST_SPREAD), MOST_BEYOND)
    return max(BARELY / (1.0 + math.exp(beyond)) + (1.0 - BARELY) * facing, UNSEEN)


@part
def shown_of(expected, cosine, view_cosine, tilt, edge, i, out):  # type: ignore[no-untyped-def]
    """Visibility (n,) of the points in one pose, into ``out``; ``tilt``: its direction's deviation, rad.

    ``expected`` (n,), ``cosine`` (K, n) and ``view_cosine`` (n,), the latter two empty where unknown; ``i``: the pose;
    ``edge``: cosine of the view angle of all points if that is not given.
    """
    for point in range(expected.shape[0]):
        value = 1.0
        if cosine.shape[0] > 0 and not math.isnan(cosine[i, point]):
            if view_cosine.shape[0] > 0:
                own = view_cosine[point]
                value = shown_by_normal(cosine[i, point], own, own - SLACK, tilt)
            else:
                value = shown_by_normal(cosine[i, point], edge, -SLACK, tilt)
        out[point] = expected[point] * value


@part
def edge_of(k):  # type: ignore[no-untyped-def]
    """The cosine of one of the `EDGES` equally probable view angles."""
    return FULLY * (k + 0.5) / EDGES


@part
def see_one(k, expected, cosine, view_cosine, tilt, shown, visible):  # type: ignore[no-untyped-def]
    """Visibility (n,) of the points in the k-th pose, into ``visible``: the mean over view angles if none is given.

    Otherwise as `shown_of`; ``shown`` (n,): scratch.
    """
    edges = 1 if view_cosine.shape[0] > 0 or cosine.shape[0] == 0 else EDGES
    for i in range(shown.shape[0]):
        visible[i] = 0.0
    for edge in range(edges):
        shown_of(expected, cosine, view_cosine, tilt, edge_of(edge), k, shown)
        for i in range(shown.shape[0]):
            visible[i] += shown[i] / edges


@part
def shown_of_blobs(blob, shown, hidden):  # type: ignore[no-untyped-def]
    """The chance that any point of a blob shows at its first point, next to none at the others, in place.

    ``hidden`` (n,): scratch.
    """
    for point in range(blob.shape[0]):
        hidden[point] = 0.0
    for point in range(blob.shape[0]):
        hidden[blob[point]] += math.log1p(-min(shown[point], SURE))
    for point in range(blob.shape[0]):
        shown[point] = -math.expm1(hidden[point]) if blob[point] == point else UNSEEN
