"""Triangles of a shape, the motions that take one onto another, and the points that these bring near targets, compiled.

Points of a plane have a third coordinate here, which is 0.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.decorators import FASTMATH, driver, part


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def list_alike(triples, table, points, gate, found):  # type: ignore[no-untyped-def]
    """List the triangles like some triples; how many there are, and how many were compared.

    Parameters
    ----------
    triples : tuple of (T, 3) arrays
        Sides ab, ac and bc of each, the first one the longest, and variances of a, b and c.
    table : tuple
        Of `ShapeTable`: keys (E,), corners (3, E), and of each class the first cell, their number, their width and the
        least length of a first side; lift.
    points : tuple
        Distances (n, n) of the points in the table, and their variances (n,).
    gate : float
        In σ.
    found : ((F,) array, (F, 3) array)
        Filled with the number of the triple and the corners, as far as they have room.
    """
    sides, own = triples
    rising, corners, begin, cells, width, shortest, lift = table
    far, variance = points
    number, images = found
    count, compared, widest = 0, 0, 0.0
    for k in range(len(variance)):
        widest = max(widest, variance[k])
    for t in range(len(sides)):
        ab, ac, bc = sides[t, 0], sides[t, 1], sides[t, 2]
        wa, wb, wc = own[t, 0], own[t, 1], own[t, 2]
        second, third, relative = ac / ab, bc / ab, max(wa, wb, wc) / (ab * ab)
        for o in range(len(width)):
            w = 2.0 * gate * math.sqrt(widest / (shortest[o] * shortest[o]) + relative)
            first = int(max((second - w) / width[o], 0.0))
            last = int(min((second + w) / width[o], cells[o] - 1.0))
            for cell in range(first, last + 1):
                base = lift * (begin[o] + cell)
                minimum, maximum = base + max(third - w, 0.0), base + min(third + w, 0.998 * lift)
                low, high = 0, len(rising)
                while low < high:
                    middle = (low + high) // 2
                    if rising[middle] < minimum:
                        low = middle + 1
                    else:
                        high = middle
                while low < len(rising) and rising[low] <= maximum:
                    k, l, m = corners[0, low], corners[1, low], corners[2, low]  # noqa: E741
                    low += 1
                    compared += 1
                    scale = far[k, l] / ab
                    square = scale * scale
                    # an unknown scale has the noise of the side that it is taken from
                    both = variance[k] + variance[l] + square * (wa + wb)
                    off, noise = far[k, m] - scale * ac, variance[k] + variance[m] + square * (wa + wc)
                    if off * off > gate * gate * (noise + both * second * second):
                        continue
                    off, noise = far[l, m] - scale * bc, variance[l] + variance[m] + square * (wb + wc)
                    if off * off > gate * gate * (noise + both * third * third):
                        continue
                    if count < len(number):
                        number[count] = t
                        images[count, 0], images[count, 1], images[count, 2] = k, l, m
                    count += 1
    return count, compared


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def fill_triangle_motions(source, target, scaled, in_plane, motions):  # type: ignore[no-untyped-def]
    """Least-squares motions of triangles (H, 3, 3) onto others, without a reflection.

    They turn the plane of one into that of the other, and in it by the angle of the sum of products of corners.
    ``motions``: (H, 3, 3), (H, 3) and (H,), filled with linear part, shift and scale.
    """
    linear, shift, scale = motions
    for h in range(len(source)):
        p, e, f, n = _plane(source[h], in_plane)
        q, e2, f2, n2 = _plane(target[h], in_plane)
        cosine, sine, spread = 0.0, 0.0, 0.0
        for corner in range(3):
            x, y, x2, y2 = 0.0, 0.0, 0.0, 0.0
            for a in range(3):
                off, off2 = source[h, corner, a] - p[a], target[h, corner, a] - q[a]
                x, y = x + off * e[a], y + off * f[a]
                x2, y2 = x2 + off2 * e2[a], y2 + off2 * f2[a]
            cosine, sine, spread = cosine + x * x2 + y * y2, sine + x * y2 - y * x2, spread + x * x + y * y
        length = max(math.sqrt(cosine * cosine + sine * sine), 1e-300)
        cosine, sine = cosine / length, sine / length
        s = length / max(spread, 1e-300) if scaled else 1.0
        scale[h] = s
        for a in range(3):
            along, across = cosine * e2[a] + sine * f2[a], cosine * f2[a] - sine * e2[a]
            shift[h, a] = q[a]
            for b in range(3):
                linear[h, a, b] = s * (along * e[b] + across * f[b] + n2[a] * n[b])
                shift[h, a] -= linear[h, a, b] * p[b]


@part
def _plane(corners, in_plane):  # type: ignore[no-untyped-def]
    """The middle of a triangle, and axes along a side, across it, and across its plane; 0 where it has none."""
    middle = (
        (corners[0, 0] + corners[1, 0] + corners[2, 0]) / 3.0,
        (corners[0, 1] + corners[1, 1] + corners[2, 1]) / 3.0,
        (corners[0, 2] + corners[1, 2] + corners[2, 2]) / 3.0,
    )
    if in_plane:
        return middle, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    ax, ay, az = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
    bx, by, bz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
    one = 1.0 / max(math.sqrt(ax * ax + ay * ay + az * az), 1e-300)
    ax, ay, az = one * ax, one * ay, one * az
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    one = 1.0 / max(math.sqrt(nx * nx + ny * ny + nz * nz), 1e-300)
    nx, ny, nz = one * nx, one * ny, one * nz
    return middle, (ax, ay, az), (ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax), (nx, ny, nz)


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def list_pairs(motions, points, grid, gate, found):  # type: ignore[no-untyped-def]
    """List the pairs of points and targets that motions bring near each other; how many there are.

    Parameters
    ----------
    motions : tuple
        Linear part (H, 3, 3), shift (H, 3) and scale (H,).
    points : tuple
        Source (3, n), its variances (n,), targets (n', 3), their variances (n',), and which may be which, (n, n') or
        (0, 0).
    grid : tuple
        Of `PlaceGrid`: lowest corner (3,), cells along each axis (3,) and their width; whether each cell lists targets,
        the first of these, for one cell more, and the targets; and the widest gate that these are for.
    gate : float
        In σ.
    found : tuple of (F,) arrays
        Filled, as far as they have room, with motion, point and target, squared distance and variance.
    """
    linear, shift, scale = motions
    source, source_variance, target, target_variance, allowed = points
    low, shape, width, listed, begin, targets, reach = grid
    whose, point, image, squares, variances = found
    n, n_target, count = source.shape[1], len(target), 0
    maximum, most2, most3 = shape[0] - 1.0, shape[1] - 1.0, shape[2] - 1.0  # cells that list nothing
    widest, widest2 = 0.0, 0.0
    for i in range(n):
        widest = max(widest, source_variance[i])
    for j in range(n_target):
        widest2 = max(widest2, target_variance[j])
    high, high2, high3 = low[0] + shape[0] * width, low[1] + shape[1] * width, low[2] + shape[2] * width
    cells, inverse, moved = np.empty(n, np.int64), 1.0 / width, np.empty((3, n))
    for h in range(len(scale)):
        square = scale[h] * scale[h]
        far = gate * math.sqrt(square * widest + widest2)
        is_listed = far <= reach
        far -= 2.0 * width  # beyond the cells about the targets
        for axis in range(3):
            a, b, c, d = linear[h, axis, 0], linear[h, axis, 1], linear[h, axis, 2], shift[h, axis]
            for i in range(n):
                moved[axis, i] = a * source[0, i] + b * source[1, i] + c * source[2, i] + d
        if is_listed:
            for i in range(n):
                u, v = (moved[0, i] - low[0]) * inverse, (moved[1, i] - low[1]) * inverse
                w = (moved[2, i] - low[2]) * inverse
                u, v, w = min(max(u, 0.0), maximum), min(max(v, 0.0), most2), min(max(w, 0.0), most3)
                cells[i] = (int(u) * shape[1] + int(v)) * shape[2] + int(w)
        for i in range(n):
            first, last = 0, n_target
            if is_listed:
                if not listed[cells[i]]:
                    continue
                first, last = begin[cells[i]], begin[cells[i] + 1]
            x, y, z = moved[0, i], moved[1, i], moved[2, i]
            if not is_listed:
                off = max(low[0] - x, low[1] - y, low[2] - z)
                off = max(off, x - high, y - high2, z - high3)
                if off > far:
                    continue
            for e in range(first, last):
                j = targets[e] if is_listed else e
                off, off2, off3 = x - target[j, 0], y - target[j, 1], z - target[j, 2]
                distance = off * off + off2 * off2 + off3 * off3
                variance = square * source_variance[i] + target_variance[j]
                if distance <= gate * gate * variance and (allowed.size == 0 or allowed[i, j]):
                    if count < len(whose):
                        whose[count], point[count], image[count] = h, i, j
                        squares[count], variances[count] = distance, variance
                    count += 1
    return count
