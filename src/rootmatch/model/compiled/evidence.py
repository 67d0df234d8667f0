"""Evidence of assignments about poses, compiled: the formulas of `rootmatch.model.evidence`."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.algebra.elimination import factorise, invert_factored
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.model.compiled.occluder import (
    DIRECTIONS,
    EDGE,
    LOG_FREE,
    MIN_HIDDEN,
    WINDOW,
    fill_distance_powers,
    fill_sizes,
    find_occluders,
    largest_size,
    log_with_range_limit,
)
from rootmatch.model.compiled.rates import log_over_rates
from rootmatch.model.compiled.visibility import (
    count_view_angles,
    facing_terms,
    fill_visibility_of_pose,
    merge_blob_visibility,
    visibility_by_normal,
)

LOG_2PI = math.log(2.0 * math.pi)
RIDGE = 1e-13
"""Added to the unit diagonal of a scaled precision, so that it has an inverse."""


@part
def log_student_density(squared, freedom, given):  # type: ignore[no-untyped-def]
    """Logarithm of the density at a squared deviation with a factor on all variances, over that of N(0, 1) at zero.

    ``freedom``: of the deviation; ``given``: of the factor's distribution.
    """
    if given == math.inf:
        return -0.5 * squared
    half = 0.5 * given
    change = math.lgamma(half + 0.5 * freedom) - math.lgamma(half) - 0.5 * freedom * math.log(half)
    return change - (half + 0.5 * freedom) * math.log1p(squared / given)


@part
def invert_scaled(matrix, factor, scale, out):  # type: ignore[no-untyped-def]
    """Inverse of a positive definite matrix (6, 6), into ``out``; the logarithm of its determinant.

    It is scaled to a unit diagonal first, as its units differ. ``factor`` (6, 6) and ``scale`` (6,): scratch.
    """
    logarithm = 0.0
    for i in range(6):
        scale[i] = 1.0 / math.sqrt(matrix[i, i])
        for j in range(i + 1):
            factor[i, j] = matrix[i, j] * scale[i] * scale[j] + (RIDGE if i == j else 0.0)
    factorise(factor, 6, 1e-300)
    invert_factored(factor, 6, out)
    for i in range(6):
        logarithm += 2.0 * math.log(factor[i, i] / scale[i])
        for j in range(i + 1):
            out[i, j] = out[j, i] = 0.5 * (out[i, j] + out[j, i]) * scale[i] * scale[j]
    return logarithm


@part
def log_crowd_correction(assignment, taken, clutter):  # type: ignore[no-untyped-def]
    """Correction of the log-densities of `rootmatch.model.clutter.Clutter` for detections that are taken away together.

    If a whole crowd is taken, its first member was not predicted by the others: it is predicted by the remaining
    detections, or begins a crowd anywhere. Which member came first does not matter, so this is a mean over all of them.
    ``clutter``: `Clutter.for_kernels`; ``taken`` (n',): scratch, False.
    """
    log_density, about, centres, uniform, alone = clutter
    count = 0
    for i in range(assignment.shape[0]):
        if assignment[i] >= 0:
            taken[assignment[i]] = True
            count += 1
    left = 0
    for c in range(centres.shape[0]):
        left += 0 if taken[centres[c]] else 1
    total = 0.0
    for i in range(assignment.shape[0]):
        j = assignment[i]
        if j >= 0:
            others = (1.0 - alone) * uniform[j]
            for c in range(centres.shape[0]):
                if not taken[centres[c]]:
                    others += about[j, c]
            total += log_density[j] - math.log(alone * uniform[j] + others / (left + 1.0))
    for i in range(assignment.shape[0]):
        if assignment[i] >= 0:
            taken[assignment[i]] = False
    return max(total / max(count, 1), 0.0)


@part
def weighing_scratch(n, images, n_target, nodes):  # type: ignore[no-untyped-def]
    """What `weigh_one` writes into, for so many points, images, detections and nodes of the rate."""
    square, hidden = (
        (np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))),
        (np.empty(2), np.empty((DIRECTIONS + 1, 3))),
    )
    points, of_rates = np.empty((12, n)), np.empty((4, nodes))
    return square, np.empty((3, 6)), points, of_rates, np.empty(images, np.int64), np.zeros(n_target, np.bool_), hidden


@part
def best_step(measured, slope, precision, prior_slope, whole, factor, scale, covariance, step):  # type: ignore[no-untyped-def]
    """The step to the best pose by detections and a prior, to first order, and its covariance.

    Returns
    -------
    float, float, float
        Logarithm of the determinant of the precision; by how much the step decreases the squared deviation; and how
        many parameters the detections determine.
    """
    for a in range(6):
        for b in range(6):
            whole[a, b] = measured[a, b] + precision[a, b]
    log_precision = invert_scaled(whole, factor, scale, covariance)
    decrement, known = 0.0, 0.0
    for a in range(6):
        total = 0.0
        for b in range(6):
            total += covariance[a, b] * (slope[b] + prior_slope[b])
            known += covariance[a, b] * measured[a, b]
        step[a] = total
        decrement += total * (slope[a] + prior_slope[a])
    return log_precision, decrement, known


@part
def weigh_one(k, pose, assignments, at, white, terms, image, clutter, rates, scratch, out):  # type: ignore[no-untyped-def]
    """Evidence of the k-th assignment in one of the poses of ``at``; otherwise as `weigh`.

    Of a prior's components, rows of ``terms``, that counts which explains most at its own best pose.
    """
    pixels, jacobian, seen, expected, cosine, blob, blob_variance = at
    rows, residuals, log_spreads = white
    target, sigma, log_weights, view_cosine, log_counts, image_of = image
    nodes, log_nodes, noise_freedom = rates
    log_odds, steps, covariances, squared_out, freedom_out, visible, decrements, detected = out
    (whole, measured, factor), vectors, points, products, counts, taken, (odds, sides) = scratch
    scale, slope, row = vectors[0], vectors[1], vectors[2]
    precisions, slopes, squares, log_densities = terms
    missing, shown, left, sizes = points[0], points[1], points[2], points[3]
    in_sight, limits, powers, (away, growth, barely) = points[4:6], points[6:8], points[8], points[9:]
    n, images = assignments.shape[1], log_counts.shape[0]
    total, matches, possible = 0.0, 0, True
    of_image = 0.0
    counts[:] = 0
    for a in range(6):
        slope[a] = 0.0
        for b in range(6):
            measured[a, b] = 0.0
    for i in range(n):
        j = assignments[k, i]
        if j < 0:
            continue
        matches += 1
        counts[image_of[j]] += 1
        possible = possible and seen[pose, i]
        weight, log_spread = 1.0, 0.0
        if rows.shape[0] == 0:
            variance = sigma[j] * sigma[j]
            if blob_variance.shape[0] > 0:
                variance += blob_variance[pose, i]
            weight, log_spread = 1.0 / math.sqrt(variance), math.log(variance)
        else:
            log_spread = log_spreads[k, i]
        for q in range(2):
            if rows.shape[0] == 0:
                residual = (target[j, q] - pixels[pose, i, q]) * weight
                for a in range(6):
                    row[a] = jacobian[pose, i, q, a] * weight
            else:
                residual = residuals[k, i, q]
                for a in range(6):
                    row[a] = rows[k, i, q, a]
            of_image += residual * residual
            for a in range(6):
                slope[a] += residual * row[a]
                for b in range(a + 1):
                    measured[a, b] += row[a] * row[b]
        total -= clutter[0][j] + LOG_2PI + log_spread
        if log_weights.shape[0] > 0:
            total += log_weights[i, j]
    for a in range(6):
        for b in range(a):
            measured[b, a] = measured[a, b]
    covariance, step = covariances[k], steps[k]
    best, which, squared, decrement, freedom = -math.inf, 0, 0.0, 0.0, 0.0
    count = log_densities.shape[0]
    for turn in range(count + (1 if count > 1 else 0)):
        one = turn if turn < count else which  # once more, for its covariance and step
        if log_densities[one] == -math.inf:
            continue
        log_precision, decrement, known = best_step(
            measured, slope, precisions[one], slopes[one], whole, factor, scale, covariance, step
        )
        squared = max(of_image + squares[one] - decrement, 0.0)
        freedom = max(2.0 * matches - known, 0.0)
        value = log_student_density(squared, freedom, noise_freedom) - 0.5 * log_precision + log_densities[one]
        if value > best:
            best, which = value, one
    total += 3.0 * LOG_2PI + best
    tilt = min(math.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1] + covariance[2, 2])), 1.0)
    highest, weights, edges = -math.inf, 0.0, count_view_angles(cosine, view_cosine)
    visible[k] = 0.0
    for i in range(n):
        away[i], growth[i], barely[i] = facing_terms(cosine, view_cosine, tilt, pose, i)
    farthest = fill_sizes(assignments[k], jacobian[pose], sizes)
    fill_distance_powers(farthest, sizes, powers)
    for edge in range(edges):
        for i in range(n):
            shown[i] = expected[pose, i] * visibility_by_normal(away[i], barely[i])
            away[i] *= growth[i]
        if blob.shape[0] > 0:
            merge_blob_visibility(blob[pose], shown, missing)
        owned, lost = 0.0, 0.0
        for i in range(n):
            missing[i] = 0.0
            if assignments[k, i] >= 0:
                owned += math.log(shown[i])
            else:
                missing[i] = shown[i]
                lost += shown[i]
        near = largest_size(assignments[k], shown, sizes)
        if edge == 0:
            odds[:] = -math.inf
            if lost > MIN_HIDDEN:
                find_occluders(assignments[k], pixels[pose], missing, images, sides, in_sight, odds)
        far = log_over_rates(missing, matches, nodes, log_nodes, products)
        value = log_with_range_limit(
            assignments[k], missing, far, near, farthest, powers, nodes, log_nodes, limits, products
        )
        for kind in (EDGE, WINDOW):
            if odds[kind] > -math.inf:
                for i in range(n):
                    left[i] = missing[i] * in_sight[kind, i]
                far = log_over_rates(left, matches, nodes, log_nodes, products)
                hidden = odds[kind] + log_with_range_limit(
                    assignments[k], left, far, near, farthest, powers, nodes, log_nodes, limits, products
                )
                value = max(value, hidden) + math.log1p(math.exp(-abs(value - hidden)))
        value += owned
        if edge == 0 or value > highest:
            before = math.exp(highest - value) if weights > 0.0 else 0.0
            highest, weight = value, 1.0
        else:
            before, weight = 1.0, math.exp(value - highest) if highest > -math.inf else 0.0
        weights = before * weights + weight
        for i in range(n):
            visible[k, i] = before * visible[k, i] + weight * shown[i]
    for i in range(n):
        visible[k, i] /= weights
    detected[k] = highest + math.log(weights / edges) + images * LOG_FREE
    total += detected[k]
    for one in range(images):
        total += log_counts[one, counts[one]]
    total += log_crowd_correction(assignments[k], taken, clutter)
    log_odds[k] = total if possible and total < math.inf else -math.inf
    squared_out[k], freedom_out[k], decrements[k] = squared, freedom, decrement


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def weigh(assignments, at, white, terms, image, clutter, rates, out):  # type: ignore[no-untyped-def]
    """Evidence of K assignments.

    Parameters
    ----------
    assignments : (K, n) int64 array
    at : tuple
        Of `rootmatch.model.linearised.Linearised`: pixels, jacobian, seen, expected, cosine, blob and
        blob_variance, the last three with no rows where they are None.
    white : tuple
        Jacobians, residuals and ½ log |S| in units of a noise that points share, as `Linearised`; without rows if each
        detection has its own alone.
    terms : tuple
        Of `rootmatch.model.pose_density.Terms`, (K, C, …) of C components.
    image : tuple
        Detections (n', 2), their σ (n',), logarithms of the weights of matches (n, n'), −∞ where one is not allowed,
        and cosines of the view angles (n,), the last two empty if not given; logarithms (C, n' + 1) of the odds of
        counts, and the image (n',) of each detection.
    clutter : tuple
        Of `rootmatch.model.clutter.Clutter`: log_density, about, centres, uniform, alone.
    rates : tuple
        Nodes (Q,) and logarithms of weights of the detection rate, and the number of residuals that σ is worth.
    out : tuple
        Of `rootmatch.model.evidence.Evidence`; filled.
    """
    assignments, at, white, terms = borrow((assignments, at, white, terms))
    image, clutter, rates, out = borrow((image, clutter, rates, out))
    precisions, slopes, squares, log_densities = terms
    scratch = weighing_scratch(assignments.shape[1], image[4].shape[0], image[0].shape[0], rates[0].shape[0])
    for k in range(assignments.shape[0]):
        own = precisions[k], slopes[k], squares[k], log_densities[k]
        weigh_one(k, k, assignments, at, white, own, image, clutter, rates, scratch, out)


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def fill_visibility(at, view_cosine, tilts, out):  # type: ignore[no-untyped-def]
    """Visibility (K, n) of points, into ``out``.

    Parameters
    ----------
    at : tuple
        Expected, cosine and blob, as for `weigh`.
    view_cosine : (n,) or (0,) array
    tilts : (K,) array
        Standard deviations of the poses' directions, rad.
    out : (K, n) array
    """
    at, view_cosine, tilts, out = borrow((at, view_cosine, tilts, out))
    expected, cosine, blob = at
    hidden = np.empty(out.shape[1])
    for k in range(out.shape[0]):
        fill_visibility_of_pose(k, expected[k], cosine, view_cosine, tilts[k], out[k])
        if blob.shape[0] > 0:
            merge_blob_visibility(blob[k], out[k], hidden)
