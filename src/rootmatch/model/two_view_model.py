"""The model of two images with a known common direction: where a point of the first is seen in the second.

Frames are those of `rootmatch.problems.points.TwoViews`: bearings q of the first and p of the second image, y along
the common direction. A point fulfils λ' p = λ R q + b t, so with u = R q and β the angle between u and t it is seen at

- an angle e from the plane of t and u, N(0, s² (σ'² + σ² (sin(p, t) / sin β)²)): both detections are noisy;
- a parallax φ from u towards t, which tells its inverse distance r = b / λ = sin φ / sin(β − φ). Inverse distances of a
  scene are of one order: log r ~ N(μ, τ²), so that φ has the density N(log r; μ, τ²) dr/dφ / r. Noise of φ is added to
  τ to first order, r is never below its own noise, and a point may lie behind a camera by the noise alone.

Every other detection of the second image is clutter of density f (`rootmatch.model.clutter`), their number Poisson.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from rootmatch.algebra.directions import tangent_bases
from rootmatch.algebra.rotation import cross, rotation_about_y, rotation_from_vector
from rootmatch.arrays import Floats, Integers
from rootmatch.model.clutter import Clutter
from rootmatch.model.priors import PRESENT

SCALES = (math.log(1e-3), math.log(10.0))
"""Baselines over distances, from points that hardly move to nearer ones; logarithms. Round values."""
SPREADS = (math.log(0.05), math.log(1.5))
"""Spread τ of the logarithm of the distances of one scene: from a shell to all within a factor 20. Round values."""
NOTHING = -30.0
"""Log-odds below which a pair counts for nothing at a sample: far below `two_view_posterior.MINIMUM`."""
PAIRS_PER_THREAD = 200_000
"""Pairs at samples that are worth waking a thread for, some milliseconds. Changes no result."""
MIN_SINE = 1e-6
"""Of the angle between a bearing and the baseline. By construction: far below any noise."""


class Relative(NamedTuple):
    """K relative poses, and how far away the points are."""

    turn: Floats
    """(K,) rotation about y, radians."""
    translation: Floats
    """(K, 3) unit vectors t."""
    tilt: Floats
    """(K, 2) turns about x and z after that, radians: zero where the common direction is exact."""
    scale: Floats
    """(K,) mean μ of the logarithms of the inverse distances, in baselines."""
    spread: Floats
    """(K,) logarithm of their standard deviation τ."""

    def take(self, rows: Integers | slice) -> Relative:
        """Some of them."""
        return Relative(*(part[rows] for part in self))

    @property
    def rotation(self) -> Floats:
        """(K, 3, 3) rotations of the first onto the second view."""
        rotation = rotation_about_y(np.cos(self.turn), np.sin(self.turn))
        if not self.tilt.any():
            return rotation
        vector = np.zeros((len(self.turn), 3))
        vector[:, 0], vector[:, 2] = self.tilt[:, 0], self.tilt[:, 1]
        return np.asarray(rotation_from_vector(vector) @ rotation)

    @classmethod
    def joined(cls, parts: list[Self]) -> Self:
        """All of several, one after the other."""
        return cls(*(np.concatenate(every) for every in zip(*parts, strict=True)))


@dataclass(frozen=True, eq=False)
class TwoViewModel:
    """Two images, and what is known of them.

    Attributes
    ----------
    first, second : (n, 3) and (n', 3) arrays
        Unit bearings.
    first_variance, second_variance : (n,) and (n',) arrays
        Radians² on each axis.
    log_clutter : (n',) array
        Logarithm of the density of clutter at each detection, in steradians⁻¹.
    planar : bool
        Whether t is orthogonal to the common direction.
    tilt : float
        Standard deviation in radians of the one common direction against the other, on each of two axes.
    log_weights : (n, n') array, optional
        Of correspondences before anything is seen, over their mean for a point; −∞ for those that cannot be.
    detection_rate : float, optional
        Probability that a point of the first image is in the second; unknown by default.
    weighs_parts : bool
        Whether unmatched points may be those of a motion that shows too few matches to be proposed.
    present : float
        Probability that the images show the same points, before they are seen.
    crowds : Clutter, optional
        How the points of the first image crowd.
    """

    first: Floats
    second: Floats
    first_variance: Floats
    second_variance: Floats
    log_clutter: Floats
    planar: bool = False
    tilt: float = 0.0
    log_weights: Floats | None = None
    detection_rate: float | None = None
    weighs_parts: bool = True
    present: float = PRESENT
    crowds: Clutter | None = None

    @cached_property
    def views(self) -> tuple[Floats, ...]:
        """Input of compiled code: bearings of both images, and their variances."""
        arrays = self.first, self.second, self.first_variance, self.second_variance
        return tuple(np.ascontiguousarray(array, np.float64) for array in arrays)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of points, and of detections."""
        return len(self.first), len(self.second)

    @property
    def size(self) -> int:
        """Parameters p of a pose: an angle, a direction, two tilts if they are unknown, scale and spread."""
        return (4 if self.planar else 5) + (2 if self.tilt > 0.0 else 0)

    @cached_property
    def log_volume(self) -> float:
        """Logarithm of the volume over which the reference prior of a pose is spread, the tilts apart."""
        directions = 2.0 * math.pi if self.planar else 4.0 * math.pi
        spans = (SCALES[1] - SCALES[0]) * (SPREADS[1] - SPREADS[0])
        return math.log(2.0 * math.pi * directions * spans)

    def log_prior(self, poses: Relative) -> Floats:
        """Logarithm (K,) of the reference density: all rotations and directions, tilts as measured."""
        inside = (poses.scale > SCALES[0]) & (poses.scale < SCALES[1])
        inside &= (poses.spread > SPREADS[0]) & (poses.spread < SPREADS[1])
        tilts = 0.0
        if self.tilt > 0.0:
            squared = (poses.tilt**2).sum(axis=1) / self.tilt**2
            tilts = -0.5 * squared - math.log(2.0 * math.pi * self.tilt**2)
        return np.where(inside, tilts - self.log_volume, -np.inf)

    def log_odds(self, poses: Relative, variance: Floats, term: Floats, pairs: tuple[Integers, Integers]) -> Floats:
        """Log density ratios (K, P) of detections as the images of points, against clutter, and a term (K,) more.

        ``variance`` (K,): the factor s² on all variances. ``pairs``: points, in order, and detections (P,); those below
        `NOTHING` have −∞.
        """
        from rootmatch.jit.threads import (  # compiled code, which not every import needs
            run_in_threads,
            worthwhile_threads,
        )
        from rootmatch.model.two_view_odds import fill_pair_log_odds

        rows, columns = pairs
        own = self.first_variance[rows], self.second_variance[columns]
        maximum = -0.5 * np.log(own[1] * (own[0] + own[1])) - math.log(2.0 * math.pi) - self.log_clutter[columns]
        if self.log_weights is not None:
            maximum += self.log_weights[rows, columns]
        scene2 = np.exp(2.0 * np.minimum(poses.spread, SPREADS[1]))
        of_poses = poses.rotation, poses.translation, np.exp(poses.scale), scene2, variance, term
        given = self.views, tuple(np.ascontiguousarray(part) for part in of_poses)
        out = np.empty((len(variance), len(rows)))

        def work(start: int, end: int) -> None:
            fill_pair_log_odds(*given, start, end, rows, columns, maximum, NOTHING, out)

        run_in_threads(work, len(out), worthwhile_threads(out.size // PAIRS_PER_THREAD))
        return out

    def seen(self, poses: Relative, rows: Integers, columns: Integers, factor: Floats | float = 1.0) -> Seen:
        """Pairs of points (P,) and detections (P,), or (K, P), at K poses."""
        u = (self.first @ poses.rotation.swapaxes(-1, -2))[:, rows]
        p, t = self.second[columns], poses.translation[:, None]
        k, pt, pu = _dot(u, t), _dot(p, t), _dot(p, u)
        sine = np.sqrt(np.maximum(1.0 - k * k, MIN_SINE**2))
        own = self.first_variance[rows], self.second_variance[columns]
        ahead, parallax, size2 = pu - k * pt, pt - k * pu, sine * sine
        with np.errstate(all="ignore"):
            across = factor * (own[1] + own[0] * (1.0 - pt * pt) / size2)
            noise = factor * (own[0] + own[1])
            slope = size2 * sine / (ahead * ahead)
            floor2 = noise * slope * slope
            r2 = (parallax / ahead) ** 2 + floor2
            mean = np.exp(poses.scale)[:, None]
            # dr / dφ = (1 + 2 r cos β + r²) / sin β
            mean2 = mean * mean + noise * ((1.0 + mean * (2.0 * k + mean)) / sine) ** 2
            spread2 = np.exp(2.0 * np.minimum(poses.spread, SPREADS[1]))[:, None] + floor2 / r2
            z = 0.5 * np.log(r2 / mean2) / np.sqrt(spread2)
        e = _dot(cross(t, u), p) / (sine * np.sqrt(across))
        behind = np.minimum(parallax / sine, 0.0) / np.sqrt(noise)
        return Seen(
            sine=sine, parallax=parallax, ahead=ahead, across=across, slope=slope,
            floor2=floor2, r2=r2, spread2=spread2, e=e, z=z, behind=behind,
        )  # fmt: skip

    def moved(self, poses: Relative, step: Floats) -> Relative:
        """Poses after steps (K, p): turn, direction of t, tilts if they are unknown, scale and spread."""
        moves = self.bases(poses.translation)
        d = moves.shape[1]
        t = poses.translation + (step[:, 1 : 1 + d, None] * moves).sum(axis=1)
        t /= np.linalg.norm(t, axis=1, keepdims=True)
        tilt = poses.tilt + (step[:, 1 + d : 3 + d] if self.tilt > 0.0 else 0.0)
        return Relative(poses.turn + step[:, 0], t, tilt, poses.scale + step[:, -2], poses.spread + step[:, -1])

    def steps_to(self, poses: Relative, others: Relative) -> tuple[Floats, Floats]:
        """Steps (C, K, p) from C poses to K others, and the logarithm (C, K) of their volume over that of poses.

        Steps to directions on the other side, which `moved` does not reach, are huge.
        """
        moves = self.bases(poses.translation)
        d = moves.shape[1]
        steps = np.empty((len(poses.turn), self.size, len(others.turn)))  # parameter by parameter, for speed
        turn = others.turn - poses.turn[:, None]
        steps[:, 0] = turn - 2.0 * np.pi * np.rint(turn / (2.0 * np.pi))
        cosine = poses.translation @ others.translation.T
        direction = moves @ others.translation.T / np.maximum(cosine, 1e-300)[:, None]
        steps[:, 1 : 1 + d] = np.where(cosine[:, None] > 1e-9, direction, 1e9)
        if self.tilt > 0.0:
            steps[:, 1 + d : 3 + d] = others.tilt.T - poses.tilt[..., None]
        steps[:, -2], steps[:, -1] = others.scale - poses.scale[:, None], others.spread - poses.spread[:, None]
        log_area = 0.5 * (d + 1.0) * np.log1p((steps[:, 1 : 1 + d] ** 2).sum(axis=1))
        return steps.swapaxes(1, 2), log_area

    def bases(self, t: Floats) -> Floats:
        """Directions (K, d, 3) in which t can move."""
        if self.planar:
            return cross(np.array([0.0, 1.0, 0.0]), t)[:, None]
        return np.stack(tangent_bases(t), axis=1)


class Seen(NamedTuple):
    """What a detection p is as the image of a point seen along u after the rotation; all (K, P)."""

    sine: Floats
    """Of the angle β between u and t."""
    parallax: Floats
    """sin β sin φ."""
    ahead: Floats
    """sin β sin(β − φ): positive in front of both cameras."""
    across: Floats
    """Variance of the angle from the epipolar plane."""
    slope: Floats
    """dr / dφ."""
    floor2: Floats
    """Square of the noise of r."""
    r2: Floats
    """Square of r, not below that."""
    spread2: Floats
    """Variance of log r, by the scene and by noise."""
    e: Floats
    """Angle from the epipolar plane over its σ."""
    z: Floats
    """Deviation of log r over its σ."""
    behind: Floats
    """Parallax of the wrong sign over its σ, else 0."""

    @property
    def log_density(self) -> Floats:
        """Logarithm of the density of the detection per steradian; −∞ behind the second camera."""
        with np.errstate(all="ignore"):
            squares = self.e * self.e + self.z * self.z + self.behind * self.behind
            log = np.log(self.slope * self.slope / (self.across * self.spread2 * self.r2))
            log = 0.5 * (log - squares) - math.log(2.0 * math.pi)
        return np.where((self.ahead > 0.0) & np.isfinite(log), log, -np.inf)


def _dot(first: Floats, second: Floats) -> Floats:
    """Products (…,) of vectors (…, 3)."""
    return np.asarray(np.einsum("...i,...i->...", first, second))
