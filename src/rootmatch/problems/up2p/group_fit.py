"""Groups of correspondences fitted by one upright camera each: χ² of all their points at once, compiled.

For the packing of several motions, which fits thousands of small groups and needs no more than χ² and the prediction of
further points. Bearings have isotropic noise, of which a tilt of the vertical is part; the best pose is eliminated.
The model of an image fits the few assignments of one body, with pixel noise and covariances.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rootmatch.algebra.vector import tangent_basis
from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.jit.decorators import driver
from rootmatch.jit.internal import internal_function
from rootmatch.problems.limits import GATE

FIRST_GATE = 6.0
"""Deviations within which a detection joins a group of three points, whose pose is uncertain; `GATE` for larger ones.
Not tuned: a round value."""
POSSIBLE = 8.0
"""Deviations from the prediction of a few points within which a detection may belong to them. Not tuned."""

STEPS = 6
"""Most Gauss-Newton steps after the linear start. Not tuned."""
SETTLED = 1e-6
"""Step in radians, and in sizes of the object, at which the fit ends: far below any noise. Not tuned."""
ROUNDS = 3
"""Times that a group is fitted and grown. Not tuned."""
LINEAR, DESCENT = np.array([5, 4])
"""Unknowns of the linear start and of a step; not plain integers, for each of which what takes them is compiled."""
FLAT = 1e-12
"""Pivot, relative to the largest entry, below which equations count as degenerate: rounding. Not tuned."""


@dataclass(frozen=True, eq=False)
class UprightGroups:
    """Groups of one task; see `rootmatch.problems.base.Groups`."""

    points: Floats
    rays: Floats
    variance: Floats
    allowed: Bools | None

    def chi2(self, groups: Integers) -> Floats:
        """See `Groups.chi2`."""
        return np.asarray(upright_chi2(self.points, self.rays, self.variance, groups))

    def grown(self, groups: Integers) -> Integers:
        """See `Groups.grown`."""
        of = self.points, self.rays, self.variance, groups
        return np.asarray(grow_upright_groups(*of, FIRST_GATE**2, GATE**2, self._mask))

    def extended(self, groups: Integers) -> Integers:
        """See `Groups.extended`."""
        of = self.points, self.rays, self.variance, groups
        rows = 4 * len(groups)
        while True:
            out = np.empty((rows, groups.shape[1]), np.int64)
            count = extend_upright_groups(*of, POSSIBLE**2, self._mask, out)
            if count <= rows:
                return out[:count]
            rows = count

    @property
    def _mask(self) -> Bools:
        """Allowed correspondences (n, n') as the drivers take them: (0, 0) for all."""
        return np.empty((0, 0), np.bool_) if self.allowed is None else np.ascontiguousarray(self.allowed)


@driver(error_model="numpy")
def upright_chi2(points, rays, variance, groups):  # type: ignore[no-untyped-def]
    """χ² of the bearings of each group about those of its best pose, 2 m − 4 degrees of freedom for m points.

    Parameters
    ----------
    points : (3, n) array
    rays : (3, n') array
        Unit bearings.
    variance : (n',) array
        Of a bearing, in radians², on each of two axes.
    groups : (G, n) int64 array
        Image of each point, −1 for those outside of the group; at least three in each.

    Returns
    -------
    (G,) array
        Infinite where no pose puts all points in front of the camera.
    """
    out = np.empty(groups.shape[0])
    pose = np.empty(5)
    for group in range(groups.shape[0]):
        out[group] = upright_pose(points, rays, variance, groups[group], pose)
    return out


@driver(error_model="numpy")
def grow_upright_groups(points, rays, variance, groups, first_gate2, gate2, allowed):  # type: ignore[no-untyped-def]
    """Groups grown by what their pose predicts, the nearest first, and fitted again.

    Parameters
    ----------
    points, rays, variance, groups
        As in `upright_chi2`.
    first_gate2, gate2 : float
        χ² of a detection about a prediction within which it joins: of the group as given, whose pose is uncertain,
        and of what has grown, which loses the members that are farther away.
    allowed : (n, n') bool array, or (0, 0) for all

    Returns
    -------
    (G, n) int64 array
    """
    out = groups.copy()
    n, n_target = groups.shape[1], rays.shape[1]
    pose = np.empty(5)
    predicted = np.empty((3, n))
    taken = np.empty(n_target, np.bool_)
    squared = np.empty((n, n_target))
    masked = allowed.shape[0] > 0
    for group in range(groups.shape[0]):
        image = out[group]
        for attempt in range(ROUNDS):
            if not upright_pose(points, rays, variance, image, pose) < np.inf:
                break
            gate = first_gate2 if attempt == 0 else gate2
            _predict(points, pose, predicted)
            taken[:] = False
            for i in range(n):
                if image[i] >= 0 and attempt > 0 and _squared(predicted, rays, variance, i, image[i]) > gate:
                    image[i] = -1
                if image[i] >= 0:
                    taken[image[i]] = True
            for i in range(n):
                for k in range(n_target):
                    squared[i, k] = np.inf
                    if image[i] < 0 and not taken[k] and (not masked or allowed[i, k]):
                        squared[i, k] = _squared(predicted, rays, variance, i, k)
            while True:
                best, point, pixel = gate, -1, -1
                for i in range(n):
                    if image[i] >= 0:
                        continue
                    for k in range(n_target):
                        if squared[i, k] < best and not taken[k]:
                            best, point, pixel = squared[i, k], i, k
                if point < 0:
                    break
                image[point] = pixel
                taken[pixel] = True
    return out


@driver(error_model="numpy")
def extend_upright_groups(points, rays, variance, groups, gate2, allowed, out):  # type: ignore[no-untyped-def]
    """Groups with each one of the correspondences more that lie within a gate of what their pose predicts.

    Parameters
    ----------
    points, rays, variance, groups, allowed
        As in `grow_upright_groups`.
    gate2 : float
        χ² of a detection about a prediction within which it may belong to the group.
    out : (E, n) int64 array
        Filled as far as it reaches.

    Returns
    -------
    int
        How many there are.
    """
    n, n_target = groups.shape[1], rays.shape[1]
    pose = np.empty(5)
    predicted = np.empty((3, n))
    taken = np.empty(n_target, np.bool_)
    masked = allowed.shape[0] > 0
    count = 0
    for group in range(groups.shape[0]):
        image = groups[group]
        if not upright_pose(points, rays, variance, image, pose) < np.inf:
            continue
        _predict(points, pose, predicted)
        taken[:] = False
        for i in range(n):
            if image[i] >= 0:
                taken[image[i]] = True
        for i in range(n):
            for k in range(n_target):
                if image[i] >= 0 or taken[k] or (masked and not allowed[i, k]):
                    continue
                if _squared(predicted, rays, variance, i, k) <= gate2:
                    if count < out.shape[0]:
                        # `out[count] = image` would be compiled with all the text of an error: four seconds
                        for other in range(n):
                            out[count, other] = image[other]
                        out[count, i] = k
                    count += 1
    return count


@internal_function(error_model="numpy")
def _predict(points, pose, predicted):  # type: ignore[no-untyped-def]
    """Bearings (3, n) of all points as a pose has them."""
    for i in range(points.shape[1]):
        x, y, z = points[0, i], points[1, i], points[2, i]
        px, py, pz = pose[0] * x + pose[1] * z + pose[2], y + pose[3], pose[0] * z - pose[1] * x + pose[4]
        scale = 1.0 / np.sqrt(px * px + py * py + pz * pz)
        predicted[0, i], predicted[1, i], predicted[2, i] = px * scale, py * scale, pz * scale


@internal_function(error_model="numpy")
def _squared(predicted, rays, variance, i, k):  # type: ignore[no-untyped-def]
    """χ² of a detection about a predicted bearing that is known exactly."""
    x, y, z = predicted[0, i] - rays[0, k], predicted[1, i] - rays[1, k], predicted[2, i] - rays[2, k]
    return (x * x + y * y + z * z) / variance[k]


@internal_function(error_model="numpy")
def upright_pose(points, rays, variance, image, pose):  # type: ignore[no-untyped-def]
    """χ² of one group about its best pose (c, s, t), which is written to `pose` (5,).

    With a rotation θ about y the camera sees p = (c X + s Z + t₁, Y + t₂, c Z − s X + t₃) along the bearing u: two
    equations that are linear in c, s and t start a Gauss-Newton descent in θ and t.
    """
    n = image.size
    normal = np.zeros((5, 6))
    row = np.empty(6)
    for i in range(n):
        if image[i] < 0:
            continue
        basis = tangent_basis(rays[0, image[i]], rays[1, image[i]], rays[2, image[i]])
        x, y, z = points[0, i], points[1, i], points[2, i]
        for q in range(2):
            f0, f1, f2 = basis[q]
            row[0], row[1] = f0 * x + f2 * z, f0 * z - f2 * x
            row[2], row[3], row[4], row[5] = f0, f1, f2, -f1 * y
            _add(normal, row, LINEAR, 1.0 / variance[image[i]])
    if not _solve(normal, LINEAR):
        return np.inf
    angle = np.arctan2(normal[1, 5], normal[0, 5])
    scale = 1.0 / np.hypot(normal[0, 5], normal[1, 5])
    # heights are known: only the rotation and the horizontal part of t share the scale that was left free
    t0, t1, t2 = scale * normal[2, 5], normal[3, 5], scale * normal[4, 5]
    chi2 = np.inf
    for step in range(STEPS + 1):
        normal[:] = 0.0
        chi2 = 0.0
        c, s = np.cos(angle), np.sin(angle)
        pose[0], pose[1], pose[2], pose[3], pose[4] = c, s, t0, t1, t2
        for i in range(n):
            k = image[i]
            if k < 0:
                continue
            x, y, z = points[0, i], points[1, i], points[2, i]
            px, py, pz = c * x + s * z + t0, y + t1, c * z - s * x + t2
            distance = np.sqrt(px * px + py * py + pz * pz)
            if not px * rays[0, k] + py * rays[1, k] + pz * rays[2, k] > 0.0:
                chi2 = np.inf
            basis = tangent_basis(rays[0, k], rays[1, k], rays[2, k])
            weight = 1.0 / variance[k]
            for q in range(2):
                f0, f1, f2 = basis[q]
                e = (f0 * px + f1 * py + f2 * pz) / distance
                chi2 += weight * e * e
                row[0] = (f0 * (c * z - s * x) - f2 * (c * x + s * z)) / distance
                row[1], row[2], row[3], row[4] = f0 / distance, f1 / distance, f2 / distance, -e
                _add(normal, row, DESCENT, weight)
        if step == STEPS or not _solve(normal, DESCENT):
            break
        small = abs(normal[0, 4]) < SETTLED and abs(normal[1, 4]) + abs(normal[2, 4]) + abs(normal[3, 4]) < SETTLED
        angle += normal[0, 4]
        t0 += normal[1, 4]
        t1 += normal[2, 4]
        t2 += normal[3, 4]
        if small:
            break
    return chi2


@internal_function()
def _add(normal, row, size, weight):  # type: ignore[no-untyped-def]
    """Add an equation row · x = row[size] to normal equations (size, size + 1)."""
    for a in range(size):
        for b in range(size + 1):
            normal[a, b] += weight * row[a] * row[b]


@internal_function()
def _solve(normal, size):  # type: ignore[no-untyped-def]
    """Solve symmetric equations (size, size + 1) in place by elimination; the solution is in column `size`."""
    largest = 0.0
    for a in range(size):
        largest = max(largest, abs(normal[a, a]))
    for a in range(size):
        pivot = a
        for b in range(a + 1, size):
            if abs(normal[b, a]) > abs(normal[pivot, a]):
                pivot = b
        if not abs(normal[pivot, a]) > FLAT * largest:
            return False
        for b in range(size + 1):
            normal[a, b], normal[pivot, b] = normal[pivot, b], normal[a, b]
        for other in range(size):
            if other != a:
                factor = normal[other, a] / normal[a, a]
                for b in range(a, size + 1):
                    normal[other, b] -= factor * normal[a, b]
    for a in range(size):
        normal[a, size] /= normal[a, a]
    return True
