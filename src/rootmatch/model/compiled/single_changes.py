"""Gains of single matches about a mode, to first order in its pose, compiled."""

from __future__ import annotations

import math

from rootmatch.jit.decorators import part
from rootmatch.model.compiled.evidence import LOG_2PI
from rootmatch.model.compiled.gating import add_covariance, project_pose_covariance

NOT_SINGULAR = 1e-9
"""Added to the diagonal of I − H, so that a match which alone determines its prediction has an inverse."""


@part
def fill_match_gains(assignment, points, covariance, image, rate, gains):  # type: ignore[no-untyped-def]
    """Log-odds (n, n') of each match against none, the pose following it, into ``gains``.

    A point's own match must not predict itself. Without it the prediction moves away and is less certain: with H = S
    N⁻¹, S the spread of its pixel by the pose and N the noise, it lies (I − H)⁻¹ r off the detection, r its residual,
    and has the spread (I − H)⁻¹ S.

    Parameters
    ----------
    assignment : (n,) int64 array
    points : tuple
        Pixels (n, 2), jacobian (n, 2, 6), their covariances (n, 2, 2) by the model points, empty if exact, visibility
        (n,), and whether each is seen (n,).
    covariance : (6, 6) array
        Of the pose.
    image : tuple
        As for `rootmatch.model.compiled.gating.gate`, and the change (n',) of `log_counts` by one match.
    rate : float
        Of detection.
    gains : (n, n') array
    """
    pixels, jacobian, of_points, visible, seen = points
    target, sigma, blur, log_clutter, log_weights, log_count = image
    for i in range(pixels.shape[0]):
        a, b, c = project_pose_covariance(jacobian, covariance, i)
        u, v = pixels[i, 0], pixels[i, 1]
        d, e, f = add_covariance(0.0, 0.0, 0.0, of_points, i)
        j = assignment[i]
        if j >= 0:
            variance = sigma[j] * sigma[j]
            k, m, n = add_covariance(d, e, f, blur, j)
            k, n = k + variance, n + variance
            size = k * n - m * m
            # H by rows, then (I − H)⁻¹
            h00, h01 = (a * n - b * m) / size, (b * k - a * m) / size
            h10, h11 = (b * n - c * m) / size, (c * k - b * m) / size
            g00, g11 = 1.0 + NOT_SINGULAR - h00, 1.0 + NOT_SINGULAR - h11
            size = g00 * g11 - h01 * h10
            r00, r01, r10, r11 = g11 / size, h01 / size, h10 / size, g00 / size
            x, y = target[j, 0] - u, target[j, 1] - v
            u, v = target[j, 0] - (r00 * x + r01 * y), target[j, 1] - (r10 * x + r11 * y)
            a, b, c = r00 * a + r01 * b, r00 * b + r01 * c, r10 * b + r11 * c
        a, b, c = a + d, b + e, c + f
        chance = min(rate * visible[i], 0.999)
        shown = math.log(chance) - math.log1p(-chance)
        for j in range(target.shape[0]):
            if not seen[i]:
                gains[i, j] = -math.inf
                continue
            variance = sigma[j] * sigma[j]
            p, o, q = add_covariance(a, b, c, blur, j)
            p, q = p + variance, q + variance
            determinant = max(p * q - o * o, variance * variance)  # it is, but for rounding
            x, y = target[j, 0] - u, target[j, 1] - v
            squared = (q * x * x - 2.0 * o * x * y + p * y * y) / determinant
            gain = shown - 0.5 * (squared + math.log(determinant)) - LOG_2PI - log_clutter[j] + log_count[j]
            if log_weights.shape[0] > 0:
                gain += log_weights[i, j]
            gains[i, j] = gain
