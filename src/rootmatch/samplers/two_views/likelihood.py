"""Likelihood ratio of a correspondence between two views, given their relative pose, against clutter.

A detection deviates across its epipolar line by noise. Along the line it tells a distance: λ' p = λ u + b t has the
inverse distance b / λ = (p · (t − k u)) / (p · (u − k t)), k = t · u. The points of one scene have inverse distances of
one order of magnitude, so these are log-logistic about a scale that belongs to the pose.
"""

from __future__ import annotations

import math

from rootmatch.algebra.vector import cross, dot, rotate_vector_about_y
from rootmatch.jit.decorators import kernel, scalar

SUPPORT = 8.0
"""(1 − z² / 8)⁴ stands for exp(−z² / 2), without the exponential and with an end: at 2.8 σ."""
NORMALISED = 0.380617
"""Over its integral, Γ(5.5) / (√(8π) Γ(5)). By construction."""
BEHIND2 = 4.0
"""A point may lie behind a camera by so many variances of its parallax (2 σ): it may be at infinity. Not tuned."""
BLUNT = 2.5066
"""√(2π): no density along the line is higher than that of the noise. By construction."""


@scalar
def epipolar_line(t, u):  # type: ignore[no-untyped-def]
    """What a source bearing u, rotated into the second view, says of every detection, for the unit baseline t.

    Returns the unit normal of the epipolar plane, the vectors whose products with a detection are its parallax and how
    far it lies ahead, and the sine of the angle between u and t.
    """
    k = dot(t, u)
    sine = math.sqrt(max(1.0 - k * k, 1e-12))
    n = cross(t, u)
    f = 1.0 / sine
    normal = (f * n[0], f * n[1], f * n[2])
    across = (t[0] - k * u[0], t[1] - k * u[1], t[2] - k * u[2])
    forward = (u[0] - k * t[0], u[1] - k * t[1], u[2] - k * t[2])
    return normal, across, forward, sine


@scalar
def depth_along_line(across, forward, x, y, z, sine, own):  # type: ignore[no-untyped-def]
    """Whether a detection may be in front of both cameras, its inverse distance, and the parallax behind it.

    The parallax, times the sine of the angle to the baseline, is never below its noise of variance ``own``.
    """
    parallax = across[0] * x + across[1] * y + across[2] * z
    ahead = forward[0] * x + forward[1] * y + forward[2] * z
    noise = own * sine * sine
    size = math.sqrt(parallax * parallax + noise)
    front = (ahead > 0.0) & ((parallax > 0.0) | (parallax * parallax < BEHIND2 * noise))
    return front, size / ahead, parallax, ahead


@scalar
def likelihood_ratio(normal, across, forward, sine, x, y, z, own, blur, inverse_scale, inverse_density):  # type: ignore[no-untyped-def]
    """Density of a detection of this point over that of clutter.

    Parameters
    ----------
    own : float
        Variance of both bearings, radians².
    blur : float
        What the error of the pose adds to it across the line.
    inverse_scale : float
        Over the scale of the inverse distances.
    inverse_density : float
        Over the detections in a steradian.
    """
    e = normal[0] * x + normal[1] * y + normal[2] * z
    front, size, _, ahead = depth_along_line(across, forward, x, y, z, sine, own)
    weight = 1.0 / (own + blur)
    g = max(1.0 - e * e * weight / SUPPORT, 0.0)
    g = g * g
    root = math.sqrt(weight)
    r = size * inverse_scale
    r2 = r * r
    below = 1.0 + r2 * r2
    # d(inverse distance) / d(angle along the line) = sin³ / ahead²
    h = 4.0 * r2 * r * inverse_scale * sine * sine * sine / (below * below * ahead * ahead)
    h = h / (1.0 + BLUNT * h * math.sqrt(own))
    return g * g * root * h * (NORMALISED * inverse_density) if front else 0.0


@kernel
def point_ratio(c, s, t, q, own, views, blur, inverse_scale, inverse_density, possible, columns):  # type: ignore[no-untyped-def]
    """Sum of the likelihood ratios of a source bearing q with every detection, each added to its column as well.

    ``own`` is the variance of the source bearing, ``possible`` (n',) 1 or 0.
    """
    normal, across, forward, sine = epipolar_line(t, rotate_vector_about_y(c, s, q))
    target, variance = views.target, views.target_variance
    x, y, z = target[0], target[1], target[2]
    total = 0.0
    for k in range(columns.shape[0]):
        ratio = possible[k] * likelihood_ratio(
            normal, across, forward, sine, x[k], y[k], z[k], own + variance[k], blur, inverse_scale, inverse_density[k]
        )
        columns[k] += ratio
        total += ratio
    return total
