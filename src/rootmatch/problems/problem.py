"""What every geometric problem offers to the road: its sizes, its polynomial and its tables."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.errors import InputError
from rootmatch.problems.fit import Fit


class Problem(ABC):
    """A minimal problem whose univariate polynomials bind correspondences together.

    A minimal set of ``minimal`` correspondences gives one polynomial of degree ``degree``; a hyper-edge of
    ``order = minimal + 1`` correspondences joins two minimal sets whose polynomials share a root when all are right.
    """

    name: ClassVar[str]
    """Short name, also on the command line."""
    order: ClassVar[int]
    """Correspondences of a hyper-edge."""
    minimal: ClassVar[int]
    """Correspondences of a minimal set."""
    degree: ClassVar[int]
    """Degree of the univariate polynomial."""
    constraints: ClassVar[int]
    """Independent constraints of a hyper-edge: the degrees of freedom of the ``joint`` residual."""
    pair_count: ClassVar[int]
    """Pairs of minimal sets of one hyper-edge that can be compared."""
    source_dimension: ClassVar[int]
    """3 where the source is points in space, 2 where it is an image."""
    target_dimension: ClassVar[int] = 2
    fits_groups: ClassVar[bool] = False
    """Whether `group_chi2`, `group_grown` and `group_extended` are there."""
    fits_answers: ClassVar[bool] = False
    """Whether `fitted` is there."""
    to_check: ClassVar[str] = "units and what the problem was given"
    """What to look at where no answer can be trusted, in the words of the status' advice; …"""
    to_tell: ClassVar[str] = "say by `candidates` which pairs are possible"
    """… and what may tell answers apart that are equally good. Name nothing that the problem refuses."""
    small_baseline: float = 0.0
    """ρ of a prior exp(−|R₂ₙ,₂ₙ| / ρ) on each hyper-edge, for views from nearly one place; 0 for none."""
    paper_rho: ClassVar[float] = 1e-6
    """ρ of the paper's preset. The scale of |R₂ₙ,₂ₙ| differs by problem: 3e-7 (P3P), 4e-5 (3P1) and 0.5 (up2p) are the
    medians of false hyper-edges in the paper's scenes."""

    @abstractmethod
    def prepare(
        self, source: ArrayLike, target: ArrayLike, noise: ArrayLike = 1.0, normals: ArrayLike | None = None
    ) -> Any:
        """Tables for the kernels: a NamedTuple of arrays.

        Parameters
        ----------
        source : (n, 3) or (n, 2) array
            Points in space (any unit, any frame) or pixels of the first image.
        target : (n', 2) array
            Pixels.
        noise : float or (n',) array
            Standard deviation of a pixel coordinate of the target.
        normals : (n, 3) array, optional
            Outward normals of source points in space, which are then seen only from their front; zero where unknown.

        Raises
        ------
        InputError
            If the points cannot be used; the text says why.
        """

    @abstractmethod
    def coefficients(self, source: ArrayLike, target: ArrayLike) -> NDArray[np.float64]:
        """Polynomials (E, degree + 1), highest degree first, of minimal sets: (E, m, 3|2) and (E, m, 2) points."""

    def fitted(
        self, source: NDArray[np.float64], target: NDArray[np.float64], noise: ArrayLike, answers: NDArray[np.int64]
    ) -> Fit:
        """Each answer (K, n) fitted by the pose that suits it best, where `fits_answers` says so.

        Every answer needs ``minimal + 1`` matches; source, target and noise are as for `prepare`.
        """
        raise NotImplementedError(f"{self.name} cannot fit answers")

    def group_chi2(self, tables: Any, groups: NDArray[np.int64]) -> NDArray[np.float64]:
        """χ² (G,) of all points of each group about their common motion, where `fits_groups` says so.

        ``groups`` (G, n) holds the image of each point, −1 outside of the group. The best motion is eliminated: of m
        points ``2 (m − minimal)`` degrees of freedom are left.
        """
        raise NotImplementedError(f"{self.name} cannot fit whole groups")

    def group_grown(
        self, tables: Any, groups: NDArray[np.int64], allowed: NDArray[np.bool_] | None
    ) -> NDArray[np.int64]:
        """Groups (G, n) with what their common motion predicts, where `fits_groups` says so."""
        raise NotImplementedError(f"{self.name} cannot fit whole groups")

    def group_extended(
        self, tables: Any, groups: NDArray[np.int64], allowed: NDArray[np.bool_] | None
    ) -> NDArray[np.int64]:
        """Groups (E, n), each with one of the correspondences more that it may predict, where `fits_groups` says so."""
        raise NotImplementedError(f"{self.name} cannot fit whole groups")


def check_points(points: ArrayLike, dimension: int, name: str, least: int) -> NDArray[np.float64]:
    """Points as a contiguous float array, or the one clear error that says what is wrong with them.

    Parameters
    ----------
    points : (m, dimension) array
    dimension : int
        2 or 3.
    name : str
        ``"source"`` or ``"target"``, for the message.
    least : int
        How many points the problem needs.
    """
    try:
        array = np.ascontiguousarray(points, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: it is not an array of numbers; give shape (m, {dimension})") from None
    if array.ndim != 2 or array.shape[1] != dimension:
        raise InputError(f"{name}: shape {array.shape} given, (m, {dimension}) expected")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if len(bad):
        raise InputError(f"{name}: point {bad[0]} holds NaN or infinity; remove such points, {len(bad)} in all")
    if len(array) < least:
        raise InputError(f"{name}: {len(array)} points given, at least {least} needed for one hyper-edge")
    order = np.lexsort(array.T[::-1])
    same = np.flatnonzero((array[order[1:]] == array[order[:-1]]).all(axis=1))
    if len(same):
        first, second = sorted((int(order[same[0]]), int(order[same[0] + 1])))
        raise InputError(f"{name}: points {first} and {second} are the same; remove repeated points")
    return array


def check_normals(normals: ArrayLike | None, count: int) -> NDArray[np.float64]:
    """Normals (count, 3), zeros where none are given."""
    if normals is None:
        return np.zeros((count, 3))
    try:
        array = np.asarray(normals, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"normals: not an array of numbers; give shape ({count}, 3)") from None
    if array.shape != (count, 3):
        raise InputError(f"normals: shape {array.shape} given, ({count}, 3) expected, one for each source point")
    if not np.all(np.isfinite(array)):
        raise InputError("normals: NaN or infinity; give 0,0,0 for a point without a known normal")
    return array


def check_not_collinear(points: NDArray[np.float64], name: str) -> None:
    """Refuse points that all lie on one line: every turn about it looks the same."""
    centred = points - points.mean(axis=0)
    values = np.linalg.svd(centred, compute_uv=False)
    if values[1] <= 1e-9 * values[0]:
        raise InputError(
            f"{name}: all {len(points)} points are collinear, which determines no pose; add points off the line"
        )


def check_noise(noise: ArrayLike, count: int, name: str = "noise") -> NDArray[np.float64]:
    """Standard deviations (count,) in pixels of a scalar or an array.

    Zero is taken as 1e-6 px: exact data then still yields finite normalised residuals.
    """
    try:
        sigma = np.asarray(noise, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: {noise!r} given; give a number of pixels, or one for each target point") from None
    if sigma.shape not in ((), (count,)):
        raise InputError(f"{name}: shape {sigma.shape} given; give one number or one for each of {count} target points")
    if not np.all(np.isfinite(sigma)) or np.any(sigma < 0.0):
        raise InputError(f"{name}: {np.min(sigma):g} px given; a standard deviation is finite and not negative")
    if np.any(sigma > 1e4):
        raise InputError(
            f"{name}: {np.max(sigma):g} px given, wider than an image; give the noise of a pixel coordinate"
        )
    return np.ascontiguousarray(np.broadcast_to(np.maximum(sigma, 1e-6), (count,)))
