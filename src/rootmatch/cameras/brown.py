"""Brown's lens with OpenCV's coefficients: radial, tangential, rational, thin prism and tilted (Brown 1966; OpenCV)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rootmatch.arrays import Bools, Floats
from rootmatch.cameras.lens import Lens, coefficients, first_positive_root, increasing_root

COUNTS = (4, 5, 8, 12, 14)
"""OpenCV's: k1 k2 p1 p2, then k3, then k4 k5 k6, then s1 s2 s3 s4, then τx τy."""
STEPS = 50
"""Maximum number of Newton steps in the plane; five are usual. Not tuned."""
HALVINGS = 30
"""Maximum number of halvings of a step that would pass the fold. Not tuned."""
EXACT = 1e-13
"""Deviation, over 1 + the distance from the principal point in focal lengths, at which an inversion has converged."""


@dataclass(frozen=True)
class Brown(Lens):
    """OpenCV's standard model.

    Parameters
    ----------
    values : sequence of 4, 5, 8, 12 or 14 floats
        k1, k2, p1, p2[, k3[, k4, k5, k6[, s1, s2, s3, s4[, τx, τy]]]], as OpenCV orders them.

    Notes
    -----
    The model is followed from the centre to where its radial part first folds over. What lies beyond is not seen.
    """

    values: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", coefficients(self.values, COUNTS, "distortion"))

    @cached_property
    def _padded_values(self) -> tuple[float, ...]:
        return (*self.values, *(0.0,) * (14 - len(self.values)))

    @cached_property
    def _tilt(self) -> Floats:
        """Homography (3, 3) of the tilted sensor."""
        x, y = self._padded_values[12:]
        cx, sx, cy, sy = np.cos(x), np.sin(x), np.cos(y), np.sin(y)
        rotation = np.array([[cy, 0.0, -sy], [0.0, 1.0, 0.0], [sy, 0.0, cy]]) @ np.array(
            [[1.0, 0.0, 0.0], [0.0, cx, sx], [0.0, -sx, cx]]
        )
        z = rotation[2, 2]
        onto = np.array([[z, 0.0, -rotation[0, 2]], [0.0, z, -rotation[1, 2]], [0.0, 0.0, 1.0]])
        return np.asarray(onto @ rotation)

    @cached_property
    def fold(self) -> float:
        """Tangent of the angle to the optical axis at which the radial part folds over, or has a pole."""
        k1, k2, _, _, k3, k4, k5, k6 = self._padded_values[:8]
        above, below = np.array([k3, k2, k1, 1.0]), np.array([k6, k5, k4, 1.0])
        # of r N / D in s = r²: (N D + 2 s (N' D − N D')) / D²
        cross: Floats = np.polysub(np.polymul(np.polyder(above), below), np.polymul(above, np.polyder(below)))
        slope = np.polyadd(np.polymul(above, below), 2.0 * np.polymul(cross, [1.0, 0.0]))
        return float(np.sqrt(min(first_positive_root(slope), first_positive_root(below))))

    @property
    def radius(self) -> float:
        """See `Lens.radius`; of the radial part."""
        if not np.isfinite(self.fold):
            return np.inf
        return float(self._radial(np.array([self.fold * (1.0 - 1e-12)]))[0][0])

    def image(self, points: Floats) -> Floats:
        """See `Lens.image`."""
        return self.project_plane(points[..., :2] / points[..., 2:])[0]

    def jacobian(self, points: Floats) -> Floats:
        """See `Lens.jacobian`."""
        inverse = 1.0 / points[..., 2]
        plane = points[..., :2] * inverse[..., None]
        by_point = np.zeros((*points.shape[:-1], 2, 3))
        by_point[..., 0, 0] = by_point[..., 1, 1] = inverse
        by_point[..., 2] = -plane * inverse[..., None]
        return np.asarray(self.project_plane(plane)[1] @ by_point)

    def sees(self, points: Floats) -> Bools:
        """See `Lens.sees`."""
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        return np.asarray((z > 0.0) & (x * x + y * y < (self.fold * z) ** 2 if np.isfinite(self.fold) else z > 0.0))

    def rays(self, image: Floats) -> Floats:
        """See `Lens.rays`: Newton's method from the solution of the radial part, never across the fold."""
        wanted = self._untilt(image.reshape(-1, 2))
        distance = np.linalg.norm(wanted, axis=1)
        start = increasing_root(self._radial, distance, self.fold, distance)
        start = np.minimum(start, 0.999999 * self.fold)
        plane = wanted * np.where(distance > 0.0, start / np.where(distance > 0.0, distance, 1.0), 1.0)[:, None]
        settled = np.zeros(len(plane), np.bool_)
        with np.errstate(all="ignore"):
            value, slope = self._distort(plane)
            error = wanted - value
            for _ in range(STEPS):
                left = np.abs(error).max(axis=1, initial=0.0)
                settled = left <= EXACT * (1.0 + distance)
                if settled.all():
                    break
                (a, b), (c, d), (x, y) = slope[:, 0].T, slope[:, 1].T, error.T
                step = np.stack([d * x - b * y, a * y - c * x], axis=1) / (a * d - b * c)[:, None]
                share = np.ones(len(plane))
                for _ in range(HALVINGS):
                    moved = plane + share[:, None] * step
                    value, new_slope = self._distort(moved)
                    new_error = wanted - value
                    worse = ~(np.linalg.norm(new_error, axis=1) < np.linalg.norm(error, axis=1))
                    worse |= ~(np.linalg.det(new_slope) > 0.0) | ~(np.linalg.norm(moved, axis=1) < self.fold)
                    if not (worse & ~settled).any():
                        break
                    share = np.where(worse, 0.5 * share, share)
                better = ~worse
                if not better.any():
                    break
                plane = np.where(better[:, None], moved, plane)
                slope = np.where(better[:, None, None], new_slope, slope)
                error = np.where(better[:, None], new_error, error)
        settled = np.abs(error).max(axis=1, initial=0.0) <= EXACT * (1.0 + distance)
        rays = np.column_stack([np.where(settled[:, None], plane, np.nan), np.ones(len(plane))])
        return rays.reshape(*image.shape[:-1], 3)

    def project_plane(self, plane: Floats) -> tuple[Floats, Floats]:
        """Image (…, 2) of points of the plane z = 1 (…, 2), and its derivatives (…, 2, 2)."""
        value, slope = self._distort(plane)
        if self._padded_values[12:] == (0.0, 0.0):
            return value, slope
        h = value @ self._tilt[:, :2].T + self._tilt[:, 2]
        tilted = h[..., :2] / h[..., 2:]
        by_value = (self._tilt[:2, :2] - tilted[..., None] * self._tilt[2, :2]) / h[..., 2, None, None]
        return tilted, np.asarray(by_value @ slope)

    def _distort(self, plane: Floats) -> tuple[Floats, Floats]:
        """Points of the plane z = 1 (…, 2) distorted, but for the tilt, and the derivatives (…, 2, 2)."""
        _, _, p1, p2, _, _, _, _, s1, s2, s3, s4 = self._padded_values[:12]
        u, v = plane[..., 0], plane[..., 1]
        r2 = u * u + v * v
        radial, fall = self._factor(r2)
        value = np.stack(
            [
                u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u) + r2 * (s1 + r2 * s2),
                v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v + r2 * (s3 + r2 * s4),
            ],
            axis=-1,
        )
        du, dv = 2.0 * u, 2.0 * v  # derivatives of r²
        x, y = s1 + 2.0 * r2 * s2, s3 + 2.0 * r2 * s4
        slope = np.empty((*plane.shape, 2))
        slope[..., 0, 0] = radial + u * fall * du + 2.0 * p1 * v + 6.0 * p2 * u + x * du
        slope[..., 0, 1] = u * fall * dv + 2.0 * p1 * u + 2.0 * p2 * v + x * dv
        slope[..., 1, 0] = v * fall * du + 2.0 * p1 * u + 2.0 * p2 * v + y * du
        slope[..., 1, 1] = radial + v * fall * dv + 6.0 * p1 * v + 2.0 * p2 * u + y * dv
        return value, slope

    def _factor(self, s: Floats) -> tuple[Floats, Floats]:
        """The radial factor at squared distances s from the axis, and its derivative by s."""
        k1, k2, _, _, k3, k4, k5, k6 = self._padded_values[:8]
        above, below = 1.0 + s * (k1 + s * (k2 + s * k3)), 1.0 + s * (k4 + s * (k5 + s * k6))
        radial = above / below
        return radial, (k1 + s * (2.0 * k2 + s * 3.0 * k3) - radial * (k4 + s * (2.0 * k5 + s * 3.0 * k6))) / below

    def _radial(self, r: Floats) -> tuple[Floats, Floats]:
        """The radial part alone of distances (m,) from the axis, and its derivative."""
        s = r * r
        radial, fall = self._factor(s)
        return r * radial, radial + 2.0 * s * fall

    def _untilt(self, image: Floats) -> Floats:
        if self._padded_values[12:] == (0.0, 0.0):
            return image
        inverse = np.linalg.inv(self._tilt)
        h = image @ inverse[:, :2].T + inverse[:, 2]
        return np.asarray(h[..., :2] / h[..., 2:])
