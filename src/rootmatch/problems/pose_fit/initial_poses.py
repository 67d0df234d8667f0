"""Poses to start a fit from: of minimal sets of points in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import cross

Floats = NDArray[np.float64]

NEARLY_REAL = 0.1
"""Imaginary part up to which a root is taken to be a real one that noise moved; the fit rejects the rest. Not tuned."""


def triples(image: Floats, used: NDArray[np.bool_]) -> NDArray[np.int64]:
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


def poses_of_triples(points: Floats, rays: Floats) -> tuple[Floats, Floats]:
    """Poses that put three points (B, 3, 3) on three unit rays (B, 3, 3).

    Rotations (B, 4, 3, 3), translations (B, 4, 3).

    Where there are fewer than four the translation is NaN (Fischler & Bolles 1981; the quartic is the paper's). As
    `rootmatch.problems.p3p.roots` for a few triples of ordinary size, in NumPy, which needs no compiling.
    """
    side = [((points[:, (k + 1) % 3] - points[:, k]) ** 2).sum(axis=1) for k in range(3)]
    versine = [0.5 * ((rays[:, (k + 1) % 3] - rays[:, k]) ** 2).sum(axis=1) for k in range(3)]
    with np.errstate(all="ignore"):
        u, v = (side[1] - side[2]) / side[0], side[2] / side[0]
        p, q, r = (1.0 - value for value in versine)
        roots = _roots(_quartic(u, v, p, q, r))
        nearly, x = np.abs(roots.imag) < NEARLY_REAL, roots.real
        x2 = 1.0 + x * x - 2.0 * p[:, None] * x
        y = (u[:, None] * x2 + 1.0 - x * x) / (2.0 * (r[:, None] - q[:, None] * x))
        a = np.sqrt(side[0][:, None] / x2)
        depths = np.stack([a, a * x, a * y], axis=-1)
        good = nearly & (x > 0.0) & (y > 0.0) & np.isfinite(depths).all(axis=-1)
        positions = depths[..., None] * rays[:, None]
        rotation = _frames(positions) @ _frames(points[:, None]).swapaxes(-1, -2)
        translation = positions.mean(axis=2) - (rotation @ points.mean(axis=1)[:, None, :, None])[..., 0]
    good &= np.isfinite(rotation).all(axis=(-1, -2))
    return np.where(good[..., None, None], rotation, np.eye(3)), np.where(good[..., None], translation, np.nan)


def _quartic(u: Floats, v: Floats, p: Floats, q: Floats, r: Floats) -> Floats:
    """N² − 4 r N D + 4 D² M, (B, 5), highest degree first."""
    n = np.stack([u - 1.0, -2.0 * u * p, 1.0 + u], axis=-1)
    d = np.stack([-q, r], axis=-1)
    m = np.stack([-v, 2.0 * v * p, 1.0 - v], axis=-1)
    out = _times(n, n) + 4.0 * _times(_times(d, d), m)
    out[:, 1:] -= 4.0 * r[:, None] * _times(n, d)
    return out


def _times(first: Floats, second: Floats) -> Floats:
    """Products of polynomials, one a row."""
    out = np.zeros((len(first), first.shape[1] + second.shape[1] - 1))
    for power in range(first.shape[1]):
        out[:, power : power + second.shape[1]] += first[:, power, None] * second
    return out


def _roots(coefficients: Floats) -> NDArray[np.complex128]:
    """Roots (B, 4) of quartics (B, 5), highest degree first, as eigenvalues."""
    companion = np.zeros((len(coefficients), 4, 4))
    companion[:, 0] = -coefficients[:, 1:] / coefficients[:, :1]
    companion[:, 1, 0] = companion[:, 2, 1] = companion[:, 3, 2] = 1.0
    return np.linalg.eigvals(np.nan_to_num(companion, nan=0.0, posinf=1e6, neginf=-1e6)).astype(np.complex128)


def _frames(corners: Floats) -> Floats:
    """Orthonormal frames (…, 3, 3), columns, of triangles (…, 3, 3)."""
    first = corners[..., 1, :] - corners[..., 0, :]
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    normal = cross(first, corners[..., 2, :] - corners[..., 0, :])
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.stack([first, cross(normal, first), normal], axis=-1)
