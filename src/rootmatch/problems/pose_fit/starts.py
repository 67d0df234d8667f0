"""Poses to start a fit from, of which one lies in the deepest valley: of triples, of a grid of rotations, reflected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import spread_rotations, triangle_frames
from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.problems.pose_fit.descent import Model, State
from rootmatch.problems.pose_fit.prior_residuals import Upright

STARTS = 8
"""Starts of a fit, the best of all that are tried. Not tuned."""
TRIPLES = 12
"""Triples whose poses are tried. Not tuned: all of four points, and those that noise harms least of many."""
GRID = 64
"""Rotations that are tried besides, some 45° apart; about a known vertical 6°. Not tuned."""
APART = 0.1
"""Angle in radians between two starts, at least: of nearer ones one is enough. Not tuned."""
DOUBTED = 9.0
"""Squared deviation from which a point counts less, when starts are compared. Not tuned: (3 σ)²."""
BEFORE = 0.1
"""Minimum depth of a start's points in units of their root mean square distance from their centre. Not tuned."""


NEARLY_REAL = 0.1
"""Imaginary part up to which a root is taken to be a real one that noise moved; the fit rejects the rest. Not tuned."""


def starting_poses(points: Floats, rays: Floats, weight: Floats, upright: Upright | None) -> State:
    """Poses to start from, rotations (K, S, 3, 3) and translations (K, S, 3).

    Parameters
    ----------
    points, rays : (K, n, 3) arrays
        Points, and unit rays in the camera frame.
    weight : (K, n) array
        0 for what is not matched.
    upright : Upright, optional
        The known vertical.
    """
    if upright is not None:
        grid = upright.turned(2.0 * np.pi * np.arange(GRID) / GRID)
        return np.tile(grid, (len(points), 1, 1, 1)), _translations(grid, points, rays, weight)
    grid = spread_rotations(GRID)
    chosen = np.concatenate([wide_triples(_plane(rays), weight > 0.0), _random_triples(weight > 0.0)], axis=1)
    every = np.arange(len(points))[:, None, None]
    rotation, translation = solve_triples(
        points[every, chosen].reshape(-1, 3, 3), rays[every, chosen].reshape(-1, 3, 3)
    )
    return (
        np.concatenate([rotation.reshape(len(points), -1, 3, 3), np.tile(grid, (len(points), 1, 1, 1))], axis=1),
        np.concatenate([translation.reshape(len(points), -1, 3), _translations(grid, points, rays, weight)], axis=1),
    )


def select_best_apart(model: Model, starts: State) -> State:
    """The `STARTS` best of many poses (K, S, …) that differ in rotation; ``model`` is that of all of them."""
    rotation, translation = starts
    groups, times = rotation.shape[:2]
    with np.errstate(all="ignore"):
        off = model.residuals((rotation.reshape(-1, 3, 3), translation.reshape(-1, 3)))
        cost = np.log1p(off**2 / DOUBTED).sum(axis=1).reshape(groups, times)
    cost = np.where(np.isfinite(cost), cost, np.inf)
    every, picked = np.arange(groups), []
    near = 1.0 + 2.0 * np.cos(APART)
    for _ in range(STARTS):
        best = cost.argmin(axis=1)
        picked.append(best)
        trace = np.einsum("kij,ksij->ks", rotation[every, best], rotation)
        cost = np.where(trace > near, np.inf, cost)
    chosen = np.stack(picked, axis=1)
    return rotation[every[:, None], chosen], translation[every[:, None], chosen]


def reflect_poses(state: State, points: Floats, weight: Floats) -> State:
    """Poses that look alike from afar: the points reflected in their plane and in that across the line of sight."""
    rotation, translation = state
    centre, normal = fit_planes(points, weight > 0.0)
    middle = (rotation @ centre[..., None])[..., 0] + translation
    sight = middle / np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-300)
    turned = _reflection(sight) @ rotation @ _reflection(normal)
    return turned, middle - (turned @ centre[..., None])[..., 0]


def fit_planes(points: Floats, used: Bools) -> tuple[Floats, Floats]:
    """Centres (K, 3) and normals (K, 3) of the planes nearest to the used (K, n) of some points (K, n, 3)."""
    share = used / np.maximum(used.sum(axis=1), 1)[:, None]
    centre = (points * share[..., None]).sum(axis=1)
    away = (points - centre[:, None]) * np.sqrt(share)[..., None]
    return centre, np.linalg.eigh(away.swapaxes(-1, -2) @ away)[1][..., 0]


def _reflection(normal: Floats) -> Floats:
    return np.asarray(np.eye(3) - 2.0 * normal[..., :, None] * normal[..., None, :])


def _translations(grid: Floats, points: Floats, rays: Floats, weight: Floats) -> Floats:
    """Translations (K, S, 3) that suit rotations (S, 3, 3) best, by distances from the rays (Lu et al. 2000)."""
    across = (np.eye(3) - rays[..., :, None] * rays[..., None, :]) * (weight**2)[..., None, None]
    total = across.sum(axis=1)
    total = total + 1e-9 * np.trace(total, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-300 * np.eye(3)
    turned = points[:, None] @ grid.swapaxes(-1, -2)
    pulled = np.einsum("knij,ksnj->ksi", across, turned)
    translation = -np.einsum("kij,ksj->ksi", np.linalg.inv(total), pulled)
    # all points at least a little before the camera, along the middle of the rays
    used = weight > 0.0
    middle = (rays * used[..., None]).sum(axis=1)
    middle = middle / np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-300)
    depth = np.einsum("ksni,ki->ksn", turned + translation[:, :, None], middle)
    minimum = np.where(used[:, None], depth, np.inf).min(axis=2)
    lift = np.maximum(BEFORE - minimum, 0.0)
    return np.asarray(translation + lift[..., None] * middle[:, None])


def _plane(rays: Floats) -> Floats:
    """Rays (K, n, 3) as points of a plane (K, n, 2), in which wide triples are wide."""
    return np.asarray(rays[..., :2] / (1.0 + np.maximum(rays[..., 2:], -0.9)))


def _random_triples(used: Bools) -> Integers:
    """Random triples (K, T, 3) of the used points (K, n)."""
    random = np.random.default_rng(0).random((len(used), TRIPLES, used.shape[1]))
    return np.argsort(np.where(used[:, None], random, 2.0), axis=2)[..., :3]


def wide_triples(image: Floats, used: Bools) -> Integers:
    """Two wide triples of the used points (K, n) of images (K, n, 2), (K, 2, 3)."""
    every, used = np.arange(len(used)), used.copy()
    out = []
    for _ in range(2):
        count = used.sum(axis=1)
        centre = (image * used[..., None]).sum(axis=1) / np.maximum(count, 1)[:, None]
        a = np.where(used, ((image - centre[:, None]) ** 2).sum(axis=-1), -1.0).argmax(axis=1)
        from_a = image - image[every, a][:, None]
        b = np.where(used, (from_a**2).sum(axis=-1), -1.0).argmax(axis=1)
        side = from_a[every, b]
        area = np.abs(from_a[..., 0] * side[:, None, 1] - from_a[..., 1] * side[:, None, 0])
        area = np.where(used, area, -1.0)
        area[every, a] = area[every, b] = -2.0
        out.append(np.stack([a, b, area.argmax(axis=1)], axis=-1))
        # the second without the outermost point, should that be a wrong one
        enough = count > 4
        used[every[enough], a[enough]] = False
    return np.stack(out, axis=1)


def solve_triples(points: Floats, rays: Floats) -> tuple[Floats, Floats]:
    """Poses that put three points (B, 3, 3) on three unit rays (B, 3, 3).

    Rotations (B, 4, 3, 3), translations (B, 4, 3).

    Where there are fewer than four the translation is NaN (Fischler & Bolles 1981; the quartic is the paper's). As
    `rootmatch.problems.p3p.roots` for a few triples of ordinary size, in NumPy, which needs no compiling.
    """
    from rootmatch.problems.p3p.quartic import quartic_in_ratio  # takes Numba, which a bad file should not wait for

    side = [((points[:, (k + 1) % 3] - points[:, k]) ** 2).sum(axis=1) for k in range(3)]
    versine = [0.5 * ((rays[:, (k + 1) % 3] - rays[:, k]) ** 2).sum(axis=1) for k in range(3)]
    with np.errstate(all="ignore"):
        u = (side[1] - side[2]) / side[0]
        p, q, r = (1.0 - value for value in versine)
        roots = _roots(np.stack(quartic_in_ratio(*side, *versine), axis=-1))
        nearly, x = np.abs(roots.imag) < NEARLY_REAL, roots.real
        x2 = 1.0 + x * x - 2.0 * p[:, None] * x
        y = (u[:, None] * x2 + 1.0 - x * x) / (2.0 * (r[:, None] - q[:, None] * x))
        a = np.sqrt(side[0][:, None] / x2)
        depths = np.stack([a, a * x, a * y], axis=-1)
        good = nearly & (x > 0.0) & (y > 0.0) & np.isfinite(depths).all(axis=-1)
        positions = depths[..., None] * rays[:, None]
        rotation = triangle_frames(positions) @ triangle_frames(points[:, None]).swapaxes(-1, -2)
        translation = positions.mean(axis=2) - (rotation @ points.mean(axis=1)[:, None, :, None])[..., 0]
    good &= np.isfinite(rotation).all(axis=(-1, -2))
    return np.where(good[..., None, None], rotation, np.eye(3)), np.where(good[..., None], translation, np.nan)


def _roots(coefficients: Floats) -> NDArray[np.complex128]:
    """Roots (B, 4) of quartics (B, 5), highest degree first, as eigenvalues."""
    companion = np.zeros((len(coefficients), 4, 4))
    companion[:, 0] = -coefficients[:, 1:] / coefficients[:, :1]
    companion[:, 1, 0] = companion[:, 2, 1] = companion[:, 3, 2] = 1.0
    return np.linalg.eigvals(np.nan_to_num(companion, nan=0.0, posinf=1e6, neginf=-1e6)).astype(np.complex128)
