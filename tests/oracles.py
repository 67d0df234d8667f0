"""Slow, obvious re-statements of the package's mathematics in plain numpy and scipy. Nothing here imports the package.

Polynomials are coefficient arrays, highest degree first. A *minimal set* is a callable ``rays -> coefficients``, of a
stack of rays too, so that every derivative can be taken by differences, all of them in one call. Where the package
eliminates in closed form, these oracles sample and interpolate, factorise, or minimise.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.linalg import eigh, expm
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from instances import shortest_arc

Intrinsics = tuple[float, float, float, float]
Polynomial = Callable[[np.ndarray], np.ndarray]

CHART = 0.3
"""P3P works in z with x = 1 + CHART z, because its roots crowd about x = 1."""


FROM_ONE = np.array([np.pad(np.atleast_1d(np.poly([1.0] * k)), (4 - k, 0)) for k in (4, 3, 2, 1, 0)])
"""The powers of x - 1, from the fourth, in those of x."""


def bearings(pixels: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    fx, fy, cx, cy = intrinsics
    rays = np.array([((u - cx) / fx, (v - cy) / fy, 1.0) for u, v in np.asarray(pixels, dtype=float)])
    return np.array([ray / math.sqrt(ray @ ray) for ray in rays])


def solid_angle_sigma(pixels: np.ndarray, intrinsics: Intrinsics, sigma: float) -> np.ndarray:
    """Isotropic angular noise that covers the solid angle of the pixel noise; the area by differences of rays."""
    step = 1e-3
    made = []
    for u, v in np.asarray(pixels, dtype=float):
        right = bearings(np.array([[u + step, v], [u - step, v]]), intrinsics)
        below = bearings(np.array([[u, v + step], [u, v - step]]), intrinsics)
        area = np.linalg.norm(np.cross(right[0] - right[1], below[0] - below[1])) / (4.0 * step**2)
        made.append(sigma * math.sqrt(area))
    return np.array(made)


# ------------------------------------------------------------------ minimal problems


def p3p_polynomial(source: np.ndarray, rays: np.ndarray, chart: float | None = None) -> np.ndarray:
    """Quartic of the triple (a, b, c) in x = |X_b| / |X_a|, or in z with x = 1 + chart z.

    The three cosine laws with a = |X_a| divided out leave two quadratics in y = |X_c| / |X_a|; their Sylvester
    determinant at five values of x is interpolated.
    """
    a, b, c = np.asarray(source, dtype=float)
    ab, bc, ca = (b - a) @ (b - a), (c - b) @ (c - b), (a - c) @ (a - c)
    u, v, w = np.moveaxis(np.asarray(rays), -2, 0)
    # |u - v|^2 / 2 instead of 1 - u.v keeps small angles
    hp, hq, hr = (0.5 * ((s - t) ** 2).sum(axis=-1)[..., None] for s, t in ((u, v), (v, w), (w, u)))
    nodes = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    shift = nodes if chart is None else chart * nodes  # x - 1
    x = 1.0 + shift
    base = shift**2 + 2.0 * hp * x  # 1 + x^2 - 2 p x
    # in t = y - 1: ca-law and bc-law, both divided by the ab-law
    ones = np.ones_like(base)
    first = np.stack((ones, 2.0 * hr * ones, 2.0 * hr - ca / ab * base), axis=-1)
    second = np.stack((ones, 2.0 * (hq * x - shift), shift**2 + 2.0 * hq * x - bc / ab * base), axis=-1)
    values = np.linalg.det(sylvester(first, second))
    shifted = np.linalg.solve(np.vander(nodes, 5), values[..., None])[..., 0]
    return shifted if chart is not None else shifted @ FROM_ONE


def up2p_polynomial(
    source: np.ndarray, rays: np.ndarray, vertical_camera: np.ndarray, vertical_world: np.ndarray
) -> np.ndarray:
    """Quadratic in x = tan(theta / 2), where both verticals are first turned to y by the shortest arc.

    The step between both points, turned into the camera, lies in the plane of both rays: sampled at three angles.
    """
    y = np.array([0.0, 1.0, 0.0])
    to_camera = shortest_arc(np.asarray(vertical_camera, dtype=float), y)
    to_world = shortest_arc(np.asarray(vertical_world, dtype=float), y)
    normal = np.cross(rays[..., 0, :], rays[..., 1, :])
    step = np.asarray(source[1], dtype=float) - np.asarray(source[0], dtype=float)
    nodes = np.array([-1.0, 0.0, 1.0])
    turns = Rotation.from_rotvec(np.multiply.outer(2.0 * np.arctan(nodes), y)).as_matrix()
    values = (1.0 + nodes**2) * (normal @ (to_camera.T @ turns @ to_world @ step).T)
    return np.linalg.solve(np.vander(nodes, 3), values[..., None])[..., 0]


def up2p_angle(rotation: np.ndarray, vertical_camera: np.ndarray, vertical_world: np.ndarray) -> float:
    """The angle theta of a rotation that takes one vertical to the other."""
    y = np.array([0.0, 1.0, 0.0])
    turn = shortest_arc(vertical_camera, y) @ rotation @ shortest_arc(vertical_world, y).T
    return math.atan2(turn[0, 2] - turn[2, 0], turn[0, 0] + turn[2, 2])


def p3p_polynomials(
    source: np.ndarray, shared: Sequence[int], chart: float | None = None
) -> tuple[Polynomial, Polynomial]:
    """Both quartics of a 4-tuple for the shared pair ``shared`` = (a, b), as functions of the four rays."""
    a, b = shared
    c, d = (k for k in range(4) if k not in shared)
    triples = [(a, b, c), (a, b, d)]

    def maker(triple: tuple[int, int, int]) -> Polynomial:
        return lambda rays: p3p_polynomial(source[list(triple)], rays[..., list(triple), :], chart)

    return maker(triples[0]), maker(triples[1])


def up2p_polynomials(
    source: np.ndarray, sets: Sequence[Sequence[int]], vertical_camera: np.ndarray, vertical_world: np.ndarray
) -> tuple[Polynomial, Polynomial]:
    """Both quadratics of two pairs of a 3-tuple, as functions of its three rays."""

    def maker(pair: Sequence[int]) -> Polynomial:
        chosen = list(pair)
        return lambda rays: up2p_polynomial(source[chosen], rays[..., chosen, :], vertical_camera, vertical_world)

    return maker(sets[0]), maker(sets[1])


# ------------------------------------------------------------------ resultants


def sylvester(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Sylvester matrix of two polynomials of degree k, as the paper's equation 3."""
    k = p.shape[-1] - 1
    m = np.zeros((*p.shape[:-1], 2 * k, 2 * k))
    for row in range(k):
        m[..., row, row : row + k + 1] = p
        m[..., k + row, row : row + k + 1] = q
    return m


def _unit(p: np.ndarray) -> np.ndarray:
    return np.asarray(p, dtype=float) / np.linalg.norm(p)


def qr(p: np.ndarray, q: np.ndarray) -> float:
    """|R_2k,2k| of the Sylvester matrix of the polynomials scaled to unit 2-norm."""
    return float(abs(np.linalg.qr(sylvester(_unit(p), _unit(q)), mode="r")[-1, -1]))


def qr_both(p: np.ndarray, q: np.ndarray) -> float:
    return min(qr(p, q), qr(p[::-1], q[::-1]))


def svd(p: np.ndarray, q: np.ndarray) -> float:
    return float(np.linalg.svd(sylvester(_unit(p), _unit(q)), compute_uv=False)[-1])


def relative_value(p: np.ndarray, x: float) -> float:
    """|p(x)| / sum |c_k x^k|, in 1/x beyond the unit circle so that x may be huge."""
    p = np.asarray(p, dtype=float)
    if abs(x) > 1.0:
        p, x = p[::-1], 1.0 / x
    powers = x ** np.arange(len(p) - 1, -1, -1)
    scale = np.abs(p * powers).sum()
    return float(abs((p * powers).sum()) / scale) if scale > 0.0 else 0.0


# ------------------------------------------------------------------ noise


def tangents(ray: np.ndarray) -> np.ndarray:
    """Two unit vectors (2, 3) across a ray."""
    return np.linalg.svd(ray[None])[2][1:]


def ray_gradient(
    function: Callable[[np.ndarray], np.ndarray], rays: np.ndarray, step: float = 1e-6, ambient: bool = False
) -> np.ndarray:
    """Central differences of a vector function of a stack of rays, (outputs, 2 m), by small turns of each ray.

    ``ambient``: by small steps along x, y and z instead, (outputs, 3 m), off the unit sphere too. What vanishes when a
    ray gets longer has the same variance either way.
    """
    stack = []
    for k, ray in enumerate(rays):
        for direction in np.eye(3) if ambient else tangents(ray):
            for sign in (1.0, -1.0):
                moved = rays.copy()
                moved[k] = ray + sign * step * direction
                if not ambient:
                    moved[k] /= np.linalg.norm(moved[k])
                stack.append(moved)
    values = function(np.array(stack))
    return (values[::2] - values[1::2]).T / (2.0 * step)


def linearised(p: Polynomial, q: Polynomial, rays: np.ndarray, sigma: np.ndarray, x: float) -> float:
    """|f| / sigma_f with f = q'(x) p(x) - p'(x) q(x) at a given x; ``sigma`` (m,) angular noise of each ray."""
    first, second = p(rays), q(rays)
    slopes = np.polyval(np.polyder(second), x), np.polyval(np.polyder(first), x)

    def f(moved: np.ndarray) -> np.ndarray:
        return np.asarray(slopes[0] * np.polyval(p(moved).T, x) - slopes[1] * np.polyval(q(moved).T, x))

    gradient = ray_gradient(f, rays)
    return float(abs(f(rays)) / math.sqrt(((gradient * np.repeat(sigma, 2)) ** 2).sum()))


def normalised_by_pixels(
    p: Polynomial, q: Polynomial, pixels: np.ndarray, intrinsics: Intrinsics, sigma: float, step: float = 1e-2
) -> float:
    """|Res| / sigma_Res: the Sylvester determinant and its central differences in every pixel coordinate."""

    flat = np.asarray(pixels, dtype=float).ravel()
    moves = step * np.eye(flat.size)
    moved = np.concatenate((flat[None], flat + moves, flat - moves))
    rays = np.array([bearings(coordinates.reshape(-1, 2), intrinsics) for coordinates in moved])
    middle, *ends = np.linalg.det(sylvester(p(rays), q(rays)))
    gradient = (np.array(ends[: flat.size]) - np.array(ends[flat.size :])) / (2.0 * step)
    return float(abs(middle) / (sigma * np.linalg.norm(gradient)))


def eliminated_chi2(values: np.ndarray, by_unknowns: np.ndarray, by_noise: np.ndarray) -> float:
    """chi2 of equations ``values`` (e,) less their unknowns (e, u); ``by_noise`` (e, w) are unit-variance columns."""
    u = np.linalg.svd(by_unknowns)[0]
    rest = u[:, by_unknowns.shape[1] :].T
    residual, spread = rest @ values, rest @ by_noise
    return float(residual @ np.linalg.solve(spread @ spread.T, residual))


# ------------------------------------------------------------------ P3P in units of the noise


def p3p_depths(source: np.ndarray, rays: np.ndarray) -> list[np.ndarray]:
    """Depths (3,) of the solutions of a triple that lie in front: the quartic's roots, then Newton's method."""
    found = []
    for root in np.roots(p3p_polynomial(source, rays, CHART)):
        if abs(root.imag) > 1e-6 * max(1.0, abs(root)):
            continue
        x = 1.0 + CHART * root.real
        y = p3p_third(source, rays, x)
        if x <= 0.0 or y <= 0.0:
            continue
        side = np.linalg.norm(source[1] - source[0])
        first = side / np.linalg.norm(x * rays[1] - rays[0])
        found.append(follow_depths(source, rays, first * np.array([1.0, x, y])))
    return found


def follow_depths(source: np.ndarray, rays: np.ndarray, depths: np.ndarray) -> np.ndarray:
    """Newton's method on the three cosine laws of a triple."""
    pairs = ((0, 1), (1, 2), (2, 0))
    sides = np.array([((source[i] - source[j]) ** 2).sum() for i, j in pairs])
    for _ in range(20):
        points = depths[:, None] * rays
        value = np.array([((points[i] - points[j]) ** 2).sum() for i, j in pairs]) - sides
        slope = np.zeros((3, 3))
        for row, (i, j) in enumerate(pairs):
            slope[row, i] = 2.0 * (points[i] - points[j]) @ rays[i]
            slope[row, j] = 2.0 * (points[j] - points[i]) @ rays[j]
        step = np.linalg.solve(slope, value)
        depths = depths - step
        if np.abs(step).max() < 1e-14 * np.abs(depths).max():
            break
    return depths


def p3p_root_gap(source: np.ndarray, rays: np.ndarray) -> float:
    """Least distance in z of two roots of a triple's quartic, complex ones too: small near a double root."""
    roots = np.roots(p3p_polynomial(source, rays, CHART))
    return min((abs(s - t) for s, t in itertools.combinations(roots, 2)), default=0.0)


def p3p_third(source: np.ndarray, rays: np.ndarray, x: float) -> float:
    """y = |X_c| / |X_a| for a given x: the difference of both quadratics in y is linear in it."""
    ab, bc, ca = ((source[i] - source[j]) @ (source[i] - source[j]) for i, j in ((0, 1), (1, 2), (2, 0)))
    hp, hq, hr = (0.5 * ((rays[i] - rays[j]) ** 2).sum() for i, j in ((0, 1), (1, 2), (2, 0)))
    base = (1.0 - x) ** 2 + 2.0 * hp * x
    # ca-law: y^2 - 2 r y + 1 = (ca/ab) base;  bc-law: y^2 - 2 q x y + x^2 = (bc/ab) base
    return float(((bc - ca) / ab * base + (1.0 - x) * (1.0 + x)) / (2.0 * (1.0 - x - hr + hq * x)))


def p3p_normalised(source: np.ndarray, rays: np.ndarray, sigma: np.ndarray, shared: tuple[int, int]) -> float:
    """Least |f| / sigma_f over the solutions of the first triple; inf without one."""
    p, q = p3p_polynomials(source, shared, CHART)
    c = min(k for k in range(4) if k not in shared)
    triple = [*shared, c]
    ratios = [d[1] / d[0] for d in p3p_depths(source[triple], rays[triple])]
    return min((linearised(p, q, rays, sigma, (x - 1.0) / CHART) for x in ratios), default=math.inf)


def rigid(source: np.ndarray, points: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """The rigid motion that takes three source points to their places (least squares, Kabsch)."""
    rotation, _ = Rotation.align_vectors(points - points.mean(axis=0), source - source.mean(axis=0))
    return lambda x: rotation.apply(x - source.mean(axis=0)) + points.mean(axis=0)


def p3p_joint(source: np.ndarray, rays: np.ndarray, sigma: np.ndarray) -> float:
    """sqrt(chi2): how far the fourth ray is from where a solution of the first three puts it; the least over solutions.

    The covariance of the prediction by differences: each ray of the triple is turned a little, the solution followed.
    """
    minimum = math.inf
    for depths in p3p_depths(source[:3], rays[:3]):

        def predicted(moved: np.ndarray, depths: np.ndarray = depths) -> np.ndarray:
            points = follow_depths(source[:3], moved, depths)[:, None] * moved
            fourth = rigid(source[:3], points)(source[3])
            return fourth / np.linalg.norm(fourth)

        expected = predicted(rays[:3])
        across = tangents(expected)
        gradient = ray_gradient(lambda stack: np.array([predicted(one) for one in stack]), rays[:3])
        spread = across @ gradient * np.repeat(sigma[:3], 2)
        offset = across @ rays[3]
        covariance = spread @ spread.T + sigma[3] ** 2 * np.eye(2)
        if expected @ rays[3] > 0.0:
            minimum = min(minimum, float(offset @ np.linalg.solve(covariance, offset)))
    return math.sqrt(minimum)


# ------------------------------------------------------------------ up2p in units of the noise


class Upright:
    """A hyper-edge of up2p: its coplanarity equations as functions of the angle and of the rays."""

    def __init__(
        self, source: np.ndarray, rays: np.ndarray, vertical_camera: np.ndarray, vertical_world: np.ndarray
    ) -> None:
        self.y = np.array([0.0, 1.0, 0.0])
        self.to_camera = shortest_arc(np.asarray(vertical_camera, dtype=float), self.y)
        self.source = source @ shortest_arc(np.asarray(vertical_world, dtype=float), self.y).T
        self.rays = rays @ self.to_camera.T

    def equations(self, pairs: Sequence[tuple[int, int]], angle: float, rays: np.ndarray) -> np.ndarray:
        a, b = np.transpose(pairs)
        steps = Rotation.from_rotvec(angle * self.y).apply(self.source[b] - self.source[a])
        return np.asarray((np.cross(rays[..., a, :], rays[..., b, :]) * steps).sum(axis=-1))

    def angles(self, pair: tuple[int, int]) -> list[float]:
        """Angles at which the pair's equation holds; where there is none, the one of the nearest approach."""
        grid = np.array([0.0, 2.0, 4.0])
        values = [self.equations([pair], angle, self.rays)[0] for angle in grid]
        alpha, beta, gamma = np.linalg.solve(np.stack((np.cos(grid), np.sin(grid), np.ones(3)), axis=1), values)
        # alpha cos + beta sin = radius cos(angle - phase) = -gamma
        radius, phase = math.hypot(alpha, beta), math.atan2(beta, alpha)
        half = math.acos(min(1.0, max(-1.0, -gamma / radius)))
        return [phase + half, phase - half]

    def chi2(self, pairs: Sequence[tuple[int, int]], angle: float, sigma: np.ndarray, tilt: float = 0.0) -> float:
        """chi2 of the pairs' equations once the angle is eliminated; ``tilt`` turns all rays about x and z.

        The equations are homogeneous in each ray: noise along a ray scales a value that is 0 for a true hyper-edge, so
        it may be counted or not. The package counts it.
        """
        step = 1e-6
        ends = [self.equations(pairs, angle + sign * step, self.rays) for sign in (1.0, -1.0)]
        gradient = ray_gradient(lambda moved: self.equations(pairs, angle, moved), self.rays, ambient=True)
        noise = gradient * np.repeat(sigma, 3)
        columns = [noise]
        for axis in ((step, 0.0, 0.0), (0.0, 0.0, step)):
            turn = Rotation.from_rotvec(axis)
            tilted = [self.equations(pairs, angle, t.apply(self.rays)) for t in (turn, turn.inv())]
            columns.append(tilt * (tilted[0] - tilted[1])[:, None] / (2.0 * step))
        by_angle = (ends[0] - ends[1])[:, None] / (2.0 * step)
        return eliminated_chi2(self.equations(pairs, angle, self.rays), by_angle, np.concatenate(columns, axis=1))

    def in_front(self, angle: float) -> bool:
        """Whether all points lie on the positive side of their rays, with depths of the first two by least squares."""
        points = Rotation.from_rotvec(angle * self.y).apply(self.source)
        a, b = self.rays[:2]
        depths = np.linalg.lstsq(np.stack((-a, b), axis=1), points[1] - points[0], rcond=None)[0]
        third = depths[0] * a + points[2] - points[0]
        return bool(depths.min() > 0.0 and third @ self.rays[2] > 0.0)

    def normalised(self, order: Sequence[int], sigma: np.ndarray, tilt: float = 0.0) -> float:
        """|f| / sigma_f of the equations of (a, b) and (a, c); the least over both roots of the first."""
        a, b, c = order
        return math.sqrt(min(self.chi2([(a, b), (a, c)], t, sigma, tilt) for t in self.angles((a, b))))

    def joint(self, order: Sequence[int], sigma: np.ndarray, tilt: float = 0.0) -> float:
        """sqrt(chi2) of all three equations; the least over the roots of (a, b) with all points in front; else inf."""
        a, b, c = order
        turned = self._reordered(order)
        chosen = [t for t in turned.angles((0, 1)) if turned.in_front(t)]
        return math.sqrt(min((self.chi2([(a, b), (a, c), (b, c)], t, sigma, tilt) for t in chosen), default=math.inf))

    def _reordered(self, order: Sequence[int]) -> Upright:
        other = Upright.__new__(Upright)
        other.y, other.to_camera = self.y, self.to_camera
        other.source, other.rays = self.source[list(order)], self.rays[list(order)]
        return other


# ------------------------------------------------------------------ brute force


def reprojection_chi2(
    source: np.ndarray,
    pixels: np.ndarray,
    intrinsics: Intrinsics,
    rotation: np.ndarray,
    translation: np.ndarray,
    sigma: float,
    axis: np.ndarray | None = None,
) -> float:
    """Least sum of squared reprojection errors over sigma^2, over all poses near the given one.

    ``axis``: the world's vertical; then only turns about it are free (up2p, 4 parameters instead of 6).
    """
    fx, fy, cx, cy = intrinsics
    centre = source.mean(axis=0)  # turning about the middle of the points decouples turn and shift
    start = rotation @ centre + translation

    def residual(parameters: np.ndarray) -> np.ndarray:
        turn = parameters[:3] if axis is None else parameters[0] * axis
        points = (source - centre) @ Rotation.from_rotvec(turn).as_matrix().T @ rotation.T + start + parameters[-3:]
        seen = np.stack((fx * points[:, 0] / points[:, 2] + cx, fy * points[:, 1] / points[:, 2] + cy), axis=1)
        return ((seen - pixels) / sigma).ravel()

    free = 6 if axis is None else 4
    return 2.0 * float(least_squares(residual, np.zeros(free), x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15).cost)


# ------------------------------------------------------------------ enumeration


def all_hyperedges(n: int, n_target: int, order: int) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Every hyper-edge once: unordered in the source, ordered in the target."""
    return [
        (i, j) for i in itertools.combinations(range(n), order) for j in itertools.permutations(range(n_target), order)
    ]


# ------------------------------------------------------------------ clutter


def log_first(clutter: Any, taken: np.ndarray) -> float:
    """Correction of the log-densities of clutter for detections (n',) that are taken away together.

    The first one was predicted by what remains, or begins a crowd anywhere; a mean over which of them came first.
    """
    rest = ~taken[clutter.centres]
    others = (clutter.about[:, rest].sum(axis=1) + (1.0 - clutter.alone) * clutter.uniform) / (rest.sum() + 1.0)
    owed = (clutter.log_density - np.log(clutter.alone * clutter.uniform + others))[taken]
    return max(float(owed.sum()) / max(len(owed), 1), 0.0)


def moved_along_arc(step: np.ndarray) -> np.ndarray:
    """Where a motion (6,) leads, a rotation vector and a translation at constant rates: the exponential of SE(3)."""
    generator = np.zeros((4, 4))
    (x, y, z) = step[:3]
    generator[:3, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    generator[:3, 3] = step[3:]
    return np.asarray(expm(generator)[:3, 3])


def in_either_axes(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Contraharmonic mean of two covariances, (a² + b²) / (a + b) in the axes in which both are diagonal."""
    ratio, vectors = eigh(second, first)
    across = first @ vectors
    return np.asarray(across * ((1.0 + ratio**2) / (1.0 + ratio)) @ across.T)
