"""Where further points are visible, by one solution of a P3P triple: the prediction and its covariance.

At a root of the quartic of abc the triple's position in the camera frame is known, and with it that of every other
source point: its coordinates in the triple's own frame do not change. The covariance of the predicted bearing follows
from the noise of the three bearings through the implicit derivative of the depths. The joint residual compares the
prediction with a detection, one hyper-edge at a time, in slabs, or in lists; the guided search predicts all points.
"""

from __future__ import annotations

import numpy as np

from rootmatch.algebra.vector import (
    add_vectors,
    column,
    column4,
    combination,
    cross,
    difference,
    dot,
    scale_vector,
    tangent_basis,
)
from rootmatch.jit.decorators import scalar
from rootmatch.problems.limits import UNINFORMATIVE, VAGUE2


@scalar
def source_frame(a, b, c):  # type: ignore[no-untyped-def]
    """Three source points as a frame: origin, e, f, e × f over its square, and the inverse Gram matrix of e and f."""
    e, f = difference(b, a), difference(c, a)
    normal = cross(e, f)
    inverse = 1.0 / dot(normal, normal)
    return a, e, f, scale_vector(inverse, normal), dot(e, e) * inverse, dot(f, f) * inverse, dot(e, f) * inverse


@scalar
def source_coordinates(source, vector):  # type: ignore[no-untyped-def]
    """Coordinates α, β, γ of a vector from the frame's origin: α e + β f + γ e × f."""
    _, e, f, normal, ee, ff, ef = source
    by_e, by_f = dot(e, vector), dot(f, vector)
    return ff * by_e - ef * by_f, ee * by_f - ef * by_e, dot(normal, vector)


@scalar
def point_in_camera(coordinates, e, f):  # type: ignore[no-untyped-def]
    """The vector α e + β f + γ e × f."""
    alpha, beta, gamma = coordinates
    return add_vectors(combination(alpha, e, beta, f), scale_vector(gamma, cross(e, f)))


@scalar
def camera_triangle(ab2, hab, x, y, rays):  # type: ignore[no-untyped-def]
    """Depths of a triple along its bearings at a solution x = b/a, y = c/a, and the vectors e and f from a to b and c.

    ``ab2``: squared distance of the source points a and b; ``hab``: versine of the angle between their bearings.
    """
    a, b, c = rays
    depth = np.sqrt(ab2 / ((x - 1.0) * (x - 1.0) + 2.0 * hab * x))
    origin = scale_vector(depth, a)
    e, f = difference(scale_vector(depth * x, b), origin), difference(scale_vector(depth * y, c), origin)
    return (depth, depth * x, depth * y), e, f


@scalar
def camera_frame(ab2, hab, x, y, rays):  # type: ignore[no-untyped-def]
    """The triple in the camera frame at one solution, and the inverse of the depths' derivative.

    Returns the depths, the vectors from a to b and to c, and the rows of M⁻¹, where M dλ is the change of the three
    squared distances (halved) with the depths λ.
    """
    a, b, c = rays
    depths, e, f = camera_triangle(ab2, hab, x, y, rays)
    g = difference(f, e)
    # rows: ab (−e·a, e·b, 0), ca (−f·a, 0, f·c), bc (0, −g·b, g·c)
    ea, eb, fa, fc, gb, gc = -dot(e, a), dot(e, b), -dot(f, a), dot(f, c), -dot(g, b), dot(g, c)
    inverse = -1.0 / (ea * fc * gb + eb * fa * gc)
    return (
        depths, e, f,
        (-fc * gb * inverse, -eb * gc * inverse, eb * fc * inverse),
        (-fa * gc * inverse, ea * gc * inverse, -ea * fc * inverse),
        (fa * gb * inverse, -ea * gb * inverse, -eb * fa * inverse),
    )  # fmt: skip


@scalar
def partials(p, coordinates, frame, rays):  # type: ignore[no-untyped-def]
    """Partials in the three bearings of the component along p of a point with source coordinates α, β, γ."""
    a, b, c = rays
    depths, e, f, row0, row1, row2 = frame
    alpha, beta, gamma = coordinates
    # the point is a + α e + β f + γ e × f
    u = combination(alpha, p, gamma, cross(f, p))
    v = combination(beta, p, gamma, cross(p, e))
    w = difference(difference(p, u), v)
    # depths follow the bearings so that the three distances stay: multipliers μ = M⁻ᵀ (u_k · partial_k)
    qa, qb, qc = dot(w, a), dot(u, b), dot(v, c)
    m0, m1, m2 = add_vectors(combination(qa, row0, qb, row1), scale_vector(qc, row2))
    g = difference(f, e)
    return (
        scale_vector(depths[0], add_vectors(w, combination(m0, e, m1, f))),
        scale_vector(depths[1], add_vectors(u, combination(-m0, e, m2, g))),
        scale_vector(depths[2], difference(v, combination(m1, f, m2, g))),
    )


@scalar
def prediction(source, frame, rays, variances, point):  # type: ignore[no-untyped-def]
    """Predicted bearing of a source point, two axes orthogonal to it, and the covariance along them in radians².

    Three vectors, and s11, s12, s22.
    """
    va, vb, vc = variances
    coordinates = source_coordinates(source, difference(point, source[0]))
    bearing = add_vectors(scale_vector(frame[0][0], rays[0]), point_in_camera(coordinates, frame[1], frame[2]))
    inverse = 1.0 / np.sqrt(dot(bearing, bearing))
    bearing = scale_vector(inverse, bearing)
    p, q = tangent_basis(bearing[0], bearing[1], bearing[2])
    u, v, w = partials(scale_vector(inverse, p), coordinates, frame, rays)
    k, l, m = partials(scale_vector(inverse, q), coordinates, frame, rays)  # noqa: E741
    s11 = va * dot(u, u) + vb * dot(v, v) + vc * dot(w, w)
    s12 = va * dot(u, k) + vb * dot(v, l) + vc * dot(w, m)
    s22 = va * dot(k, k) + vb * dot(l, l) + vc * dot(m, m)
    return bearing, p, q, (s11, s12, s22)


@scalar
def squared_deviation(predicted, ray, v):  # type: ignore[no-untyped-def]
    """χ² of a bearing of variance v about a prediction; UNINFORMATIVE² behind the camera or if too vague."""
    bearing, p, q, (s11, s12, s22) = predicted
    f, g = dot(p, ray), dot(q, ray)
    a, b = s11 + v, s22 + v
    determinant = a * b - s12 * s12
    chi2 = (f * f * b - 2.0 * f * g * s12 + g * g * a) / determinant
    known = (a + b < VAGUE2) and (dot(bearing, ray) > 0.0) and (chi2 >= 0.0)
    return chi2 if known else UNINFORMATIVE * UNINFORMATIVE


@scalar
def facing_away(source, frame, normal, ray):  # type: ignore[no-untyped-def]
    """Positive where a source point's normal, rotated as the triple is, is beyond its view angle for a unit bearing."""
    return dot(point_in_camera(source_coordinates(source, normal), frame[1], frame[2]), ray) + normal[3]


@scalar
def is_triple_visible(source, frame, normals, rays):  # type: ignore[no-untyped-def]
    """Whether none of the triple's own points faces away."""
    return (
        (facing_away(source, frame, normals[0], rays[0]) <= 0.0)
        & (facing_away(source, frame, normals[1], rays[1]) <= 0.0)
        & (facing_away(source, frame, normals[2], rays[2]) <= 0.0)
    )


@scalar
def triple_from_tables(t, i, j):  # type: ignore[no-untyped-def]
    """A triple as the tables have it: |ab|², the versine of a and b, source frame, normals, bearings, variances."""
    p, m, u, v = t.points, t.normals, t.rays, t.variance
    return (
        t.distance2[i[0], i[1]],
        t.versine[j[0], j[1]],
        source_frame(column(p, i[0]), column(p, i[1]), column(p, i[2])),
        (column4(m, i[0]), column4(m, i[1]), column4(m, i[2])),
        (column(u, j[0]), column(u, j[1]), column(u, j[2])),
        (v[j[0]], v[j[1]], v[j[2]]),
    )


@scalar
def store_prediction(predicted, rows, k):  # type: ignore[no-untyped-def]
    """Write a prediction to rows 0 to 11 of column k."""
    (
        (rows[0, k], rows[1, k], rows[2, k]), (rows[3, k], rows[4, k], rows[5, k]),
        (rows[6, k], rows[7, k], rows[8, k]), (rows[9, k], rows[10, k], rows[11, k]),
    ) = predicted  # fmt: skip


@scalar
def load_prediction(rows, k):  # type: ignore[no-untyped-def]
    """The prediction that `store_prediction` wrote."""
    return (
        (rows[0, k], rows[1, k], rows[2, k]), (rows[3, k], rows[4, k], rows[5, k]),
        (rows[6, k], rows[7, k], rows[8, k]), (rows[9, k], rows[10, k], rows[11, k]),
    )  # fmt: skip
