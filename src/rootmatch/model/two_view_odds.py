"""Log-odds of pairs at many samples of a relative pose, compiled: what `TwoViewModel.seen` says in NumPy."""

from __future__ import annotations

import math

from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, scalar

MIN_SINE2 = 1e-12
"""Square of `rootmatch.model.two_view_model.MIN_SINE`."""


@scalar
def epipolar_variance(k, pt, v, w, factor):  # type: ignore[no-untyped-def]
    """Square of the sine of β, and the variance across the epipolar plane; v, w: variances of point and detection."""
    size2 = max(1.0 - k * k, MIN_SINE2)
    return size2, factor * (w + v * (1.0 - pt * pt) / size2)


@scalar
def inverse_distance_terms(k, size2, parallax, ahead, noise, mean, scene2):  # type: ignore[no-untyped-def]
    """Of r: its derivative by φ, the squares of its noise and of itself, that of e^μ, and the variance of log r."""
    slope = size2 * math.sqrt(size2) / (ahead * ahead)
    floor2 = noise * slope * slope
    r = parallax / ahead
    r2 = r * r + floor2
    at_mean = 1.0 + mean * (2.0 * k + mean)
    return slope, floor2, r2, mean * mean + noise * at_mean * at_mean / size2, scene2 + floor2 / r2


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def fill_pair_log_odds(views, poses, start, end, rows, columns, maximum, minimum, out):  # type: ignore[no-untyped-def]
    """Log-odds of pairs at samples ``start … end − 1``.

    Parameters
    ----------
    views : tuple
        Bearings (n, 3) and (n', 3), and their variances (n,) and (n',).
    poses : tuple
        Rotations (K, 3, 3), unit baselines (K, 3), e^μ (K,), τ² (K,), factors s² on all variances (K,), and a term
        (K,) that is added to all pairs.
    rows, columns : (P,) int64 arrays
        Points, in order, and detections of the pairs.
    maximum : (P,) array
        A bound of what a pair can have where s = τ = 1 and it lies in its epipolar plane, what else is known of it
        included: what `inverse_distance_terms` and the variance across the plane take from it is never negative.
    minimum : float
        Log-odds below which a pair is not looked at closely: −∞.
    out : (K, P) array
        Filled.
    """
    views, poses, rows, columns, maximum, out = borrow((views, poses, rows, columns, maximum, out))
    first, second, first_variance, second_variance = views
    rotations, baselines, means, scenes, factors, terms = poses
    for sample in range(start, end):
        R, t = rotations[sample], baselines[sample]
        t0, t1, t2 = t[0], t[1], t[2]
        mean, scene2, factor, term = means[sample], scenes[sample], factors[sample], terms[sample]
        # what the smaller noise and the narrower scene gain at most
        gain = term - minimum - math.log(factor) - 0.5 * math.log(scene2)
        own = -1
        u0, u1, u2, n0, n1, n2, k, v = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for pair in range(rows.shape[0]):
            if rows[pair] != own:
                own = rows[pair]
                q0, q1, q2 = first[own, 0], first[own, 1], first[own, 2]
                u0 = R[0, 0] * q0 + R[0, 1] * q1 + R[0, 2] * q2
                u1 = R[1, 0] * q0 + R[1, 1] * q1 + R[1, 2] * q2
                u2 = R[2, 0] * q0 + R[2, 1] * q1 + R[2, 2] * q2
                n0, n1, n2 = t1 * u2 - t2 * u1, t2 * u0 - t0 * u2, t0 * u1 - t1 * u0
                k, v = u0 * t0 + u1 * t1 + u2 * t2, first_variance[own]
            column = columns[pair]
            p0, p1, p2, w = second[column, 0], second[column, 1], second[column, 2], second_variance[column]
            pt = p0 * t0 + p1 * t1 + p2 * t2
            size2, across = epipolar_variance(k, pt, v, w, factor)
            triple = n0 * p0 + n1 * p1 + n2 * p2
            e2 = triple * triple / (size2 * across)
            pu = p0 * u0 + p1 * u1 + p2 * u2
            ahead = pu - k * pt
            if not (ahead > 0.0 and 0.5 * e2 < gain + maximum[pair]):
                out[sample, pair] = -math.inf
                continue
            parallax, noise = pt - k * pu, factor * (v + w)
            slope, _, r2, mean2, spread2 = inverse_distance_terms(k, size2, parallax, ahead, noise, mean, scene2)
            z = 0.5 * math.log(r2 / mean2)
            behind = min(parallax, 0.0)
            squares = e2 + z * z / spread2 + behind * behind / (size2 * noise)
            # relative to the bound, where the variances of the two bearings stand alone
            log = 0.5 * (math.log(slope * slope * (v + w) * w / (across * spread2 * r2)) - squares)
            log += maximum[pair] + term
            out[sample, pair] = log if abs(log) < math.inf else -math.inf
