"""Visibility of a body's points by their normals, compiled."""

from __future__ import annotations

import math

from rootmatch.jit.decorators import part
from rootmatch.model.visibility import BARELY, EDGE, EDGES, FULLY, LOGISTIC, SLACK, UNSEEN

MIN_SPREAD = 1e-6
"""Spread of a cosine below which it counts as exact."""
MAX_BEYOND = 500.0
"""Exponent beyond which a visibility is nothing in any case."""
SURE = 1.0 - 1e-15
"""Visibility above which a point of a blob counts as that: its logarithm of not being seen stays finite."""


@part
def facing_terms(cosine, view_cosine, tilt, pose, point):  # type: ignore[no-untyped-def]
    """What the visibility of a point by its normal is made of at the first view angle, and how that leads to the next.

    With view angles whose cosines c_k are equally far apart, the odds that the point faces away are
    exp(−s (c − c_k)), so from one to the next they grow by a constant factor.

    ``cosine`` (K, n) and ``view_cosine`` (n,), empty where unknown; ``tilt``: the pose's deviation in direction, rad.

    Returns
    -------
    float, float, float
        Those odds, that factor, and the visibility that is left beyond the edge.
    """
    if cosine.shape[0] == 0 or math.isnan(cosine[pose, point]):
        return 0.0, 1.0, BARELY
    c, edge, limit, between = (
        cosine[pose, point],
        view_angle_cosine(0),
        -SLACK,
        view_angle_cosine(1) - view_angle_cosine(0),
    )
    if view_cosine.shape[0] > 0:
        edge, limit, between = view_cosine[point], view_cosine[point] - SLACK, 0.0
    spread = math.sqrt(1.0 - min(c * c, 1.0)) * tilt
    slope = LOGISTIC / math.sqrt(EDGE * EDGE + spread * spread)
    beyond = min(LOGISTIC * (limit - c) / max(spread, MIN_SPREAD), MAX_BEYOND)
    return math.exp(-slope * (c - edge)), math.exp(slope * between), BARELY / (1.0 + math.exp(beyond))


@part
def visibility_by_normal(away, barely):  # type: ignore[no-untyped-def]
    """Visibility of a point by its normal, see `facing_terms`."""
    return max(barely + (1.0 - BARELY) / (1.0 + away), UNSEEN)


@part
def count_view_angles(cosine, view_cosine):  # type: ignore[no-untyped-def]
    """Number of view angles over which a mean is taken: one where it is given, or no normals are."""
    return 1 if view_cosine.shape[0] > 0 or cosine.shape[0] == 0 else EDGES


@part
def view_angle_cosine(k):  # type: ignore[no-untyped-def]
    """The cosine of one of the `EDGES` equally probable view angles."""
    return FULLY * (k + 0.5) / EDGES


@part
def fill_visibility_of_pose(k, expected, cosine, view_cosine, tilt, visible):  # type: ignore[no-untyped-def]
    """Visibility (n,) of the points in the k-th pose, into ``visible``: the mean over view angles if none is given.

    ``expected`` (n,); otherwise as `facing_terms`.
    """
    edges = count_view_angles(cosine, view_cosine)
    for i in range(visible.shape[0]):
        away, factor, barely = facing_terms(cosine, view_cosine, tilt, k, i)
        total = 0.0
        for _ in range(edges):
            total += visibility_by_normal(away, barely)
            away *= factor
        visible[i] = expected[i] * total / edges


@part
def merge_blob_visibility(blob, shown, hidden):  # type: ignore[no-untyped-def]
    """The chance that any point of a blob shows at its first point, next to none at the others, in place.

    ``hidden`` (n,): scratch.
    """
    for point in range(blob.shape[0]):
        hidden[point] = 0.0
    for point in range(blob.shape[0]):
        hidden[blob[point]] += math.log1p(-min(shown[point], SURE))
    for point in range(blob.shape[0]):
        shown[point] = -math.expm1(hidden[point]) if blob[point] == point else UNSEEN
