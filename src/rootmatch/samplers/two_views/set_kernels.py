"""Relative poses of minimal sets with every image they may have, the likeliest kept: compiled."""

from __future__ import annotations

import math

from rootmatch.algebra.vector import column
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, kernel
from rootmatch.samplers.two_views.likelihood import point_ratio
from rootmatch.samplers.two_views.minimal_poses import ROOTS, pair_poses, triple_poses


@kernel
def judge_panel(views, judge, order, own, panel, low, high, columns, poses, evidence, counts):  # type: ignore[no-untyped-def]
    """Judge the poses of the images ``low … high − 1`` of the point ``own`` in a panel by all points; keep the best.

    A pose counts by its log-likelihood ratio, of the source points or of the detections, whichever is less: many points
    may meet one detection. A sequential test ends most after a few points.
    """
    n = order.shape[0]
    inverse_density, possible, visible, found, blur, reject, drift = judge
    for root in range(ROOTS):
        for last in range(low, high):
            size = panel[root, 5, last]
            if not (size > 0.0 and possible[own, last] > 0.0):
                continue
            counts[1] += 1
            c, s = panel[root, 0, last], panel[root, 1, last]
            t = (panel[root, 2, last], panel[root, 3, last], panel[root, 4, last])
            for k in range(columns.shape[0]):
                columns[k] = 0.0
            total, limit = 0.0, reject
            for rank in range(n):
                point = order[rank]
                ratio = point_ratio(
                    c, s, t, column(views.source, point), views.source_variance[point], views, blur, 1.0 / size,
                    inverse_density, possible[point], columns,
                )  # fmt: skip
                total += math.log(1.0 - visible + visible * ratio)
                counts[2] += 1
                limit = reject - drift * (rank + 1)
                if total < limit:
                    break
            if total < limit or total <= evidence[0]:
                continue
            other = 0.0
            for k in range(columns.shape[0]):
                other += math.log(1.0 - found + found * columns[k])
            total = min(total, other)
            if total <= evidence[0]:
                continue
            # the least likely stands first
            evidence[0] = total
            for field in range(panel.shape[1]):
                poses[0, field] = panel[root, field, last]
            minimum = 0
            for kept in range(evidence.shape[0]):
                if evidence[kept] < evidence[minimum]:
                    minimum = kept
            evidence[0], evidence[minimum] = evidence[minimum], evidence[0]
            for field in range(panel.shape[1]):
                poses[0, field], poses[minimum, field] = poses[minimum, field], poses[0, field]


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def search_triples(  # type: ignore[no-untyped-def]
    views, judge, sets, orders, limits, start, end, begin, stop, panel, columns, poses, evidence, counts
):
    """Sets ``start … end − 1`` of three source points (S, 3), with some of their images.

    Parameters
    ----------
    views : TwoViews
    judge : tuple
        Over the density about each detection (n',), possible correspondences (n, n') as numbers, probability that a
        source point is detected and that a detection is of one, variance that a pose adds, and the log-likelihood
        ratio at which a pose is rejected: at first, and how much lower for each point.
    orders : (S, n) int64 array
        In which the points judge.
    limits : (2,) array
        Squared gate of the set's own correspondences, and largest ratio of their inverse distances.
    begin, stop : int
        The images, number (first · n' + second) · n' + last, from ``begin`` to ``stop − 1``; of n'³.
    panel, columns : (ROOTS, FIELDS, n') and (n',) arrays
        Scratch.
    poses, evidence : (S, K, FIELDS) and (S, K) arrays
        The likeliest so far; ``evidence`` −∞ at first.
    counts : (S, 3) int64 array
        Added to: minimal sets solved, poses judged, points looked up.
    """
    views, judge, sets, orders, panel, columns = borrow((views, judge, sets, orders, panel, columns))
    poses, evidence, counts, limits = borrow((poses, evidence, counts, limits))
    n_target = columns.shape[0]
    possible = judge[1]
    for index in range(start, end):
        i = sets[index]
        for number in range(begin // n_target, (stop - 1) // n_target + 1):
            first = number // n_target
            second = number - first * n_target
            low, high = max(begin - number * n_target, 0), min(stop - number * n_target, n_target)
            if first != second and possible[i[0], first] > 0.0 and possible[i[1], second] > 0.0:
                triple_poses(views, i, first, second, limits[0], limits[1], panel)
                counts[index, 0] += high - low - int(low <= first < high) - int(low <= second < high)
                judge_panel(
                    views, judge, orders[index], i[2], panel, low, high, columns,
                    poses[index], evidence[index], counts[index],
                )  # fmt: skip


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def search_pairs(  # type: ignore[no-untyped-def]
    views, judge, sets, orders, limits, start, end, begin, stop, panel, columns, poses, evidence, counts
):
    """Search sets of two source points (S, 2), as `search_triples`, for planar motion; images are first · n' + last."""
    views, judge, sets, orders, panel, columns = borrow((views, judge, sets, orders, panel, columns))
    poses, evidence, counts, limits = borrow((poses, evidence, counts, limits))
    n_target = columns.shape[0]
    possible = judge[1]
    for index in range(start, end):
        i = sets[index]
        for first in range(begin // n_target, (stop - 1) // n_target + 1):
            low, high = max(begin - first * n_target, 0), min(stop - first * n_target, n_target)
            if possible[i[0], first] > 0.0:
                pair_poses(views, i, first, limits[0], limits[1], panel)
                counts[index, 0] += high - low - int(low <= first < high)
                judge_panel(
                    views, judge, orders[index], i[1], panel, low, high, columns,
                    poses[index], evidence[index], counts[index],
                )  # fmt: skip
