"""The equation of a pair of correspondences in an upright camera, and its two solutions.

World and camera are rotated so that their verticals are the y axis. Two correspondences then bind the rotation θ about
it: f = n · R(θ) Δ = α cos θ + β sin θ + γ = 0 with n = u₁ × u₂ and Δ = X₂ − X₁, a quadratic in x = tan(θ/2) (Kukelova
et al. 2011; paper, section "up2p").
"""

from __future__ import annotations

import numpy as np

from rootmatch.algebra.vector import cross, dot, rotate_vector_about_y
from rootmatch.jit.decorators import scalar


@scalar
def sinusoid(d, a, b):  # type: ignore[no-untyped-def]
    """α, β, γ of the equation α cos θ + β sin θ + γ = 0 of difference d and bearings a, b."""
    n = cross(a, b)
    return n[0] * d[0] + n[2] * d[2], n[0] * d[2] - n[2] * d[0], n[1] * d[1]


@scalar
def quadratic(d, a, b):  # type: ignore[no-untyped-def]
    """Coefficients in x = tan(θ/2), highest degree first."""
    alpha, beta, gamma = sinusoid(d, a, b)
    return gamma - alpha, 2.0 * beta, gamma + alpha


@scalar
def roots(alpha, beta, gamma):  # type: ignore[no-untyped-def]
    """Cosine and sine of the two solutions; where noise left none, both are the point of nearest approach."""
    radius2 = alpha * alpha + beta * beta
    radius = np.sqrt(radius2)
    clipped = min(max(gamma, -radius), radius)
    half = np.sqrt(max(radius2 - gamma * gamma, 0.0))
    inverse = 1.0 / radius2
    return (
        (-clipped * alpha - beta * half) * inverse,
        (-clipped * beta + alpha * half) * inverse,
        (-clipped * alpha + beta * half) * inverse,
        (-clipped * beta - alpha * half) * inverse,
    )


@scalar
def is_facing(c, s, normal, ray):  # type: ignore[no-untyped-def]
    """Whether a normal, rotated about the vertical, is within its view angle for a unit bearing."""
    return dot(rotate_vector_about_y(c, s, normal), ray) + normal[3] <= 0.0
