"""The three-plus-one problem: two calibrated images that share one known direction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.errors import InputError
from rootmatch.problems.points import PointSets, TwoViews
from rootmatch.problems.two_images import TwoImageProblem

if TYPE_CHECKING:
    from rootmatch.problems.three_plus_one.tables import ThreePlusOneTables

Unknown = Literal["tan", "cos"]


@dataclass(frozen=True)
class ThreePlusOne(TwoImageProblem):
    """Relative pose of two images from three points and one common direction (Naroditsky et al. 2012; paper, "3P1").

    Pass it to `rootmatch.match`; its methods are only needed to write problems or samplers.

    The unknown is x = tan(θ/2) or cos θ of the rotation θ about the common direction that takes the first view to the
    second; it belongs to the cameras, so all triples share it. Pixels of the first image are the source, of the second
    the target.

    Parameters
    ----------
    camera : Camera
        Of the first image.
    camera2 : Camera, optional
        Of the second image; the first one by default.
    axis, axis2 : three floats
        The common direction (gravity, a vanishing point) in the frame of the first and of the second camera. Any length
        but 0. There is no default; two images without a common direction would need five points, an order of 6, and
        are not supported.
    axis_noise : float
        Standard deviation in radians of either direction on each of two axes; it enters the residuals' variance.
    small_baseline : float
        ρ of a prior exp(−|R₈,₈| / ρ) on each hyper-edge, 0 for none. The raw resultant vanishes for two views from one
        place. If the baseline is known to be below a tenth of the distance, 3e-8 helps; otherwise it does harm.
    unknown : "tan" or "cos"
        Which unknown the polynomials have: x = tan(θ/2), whose roots are rotations, or x = cos θ, as the paper writes,
        whose roots θ and −θ share. It matters to `coefficients` and to ``"qr"``, ``"qr-both"`` and ``"svd"`` only.

    Raises
    ------
    InputError
        If a camera or a direction is missing or cannot be used, or another parameter is out of range.

    Notes
    -----
    Degenerate: a pure rotation, for which every triple has a triple root (near it roots crowd, so they are found in
    closed form, and a nearly real pair counts by its real part); three correspondences whose determinant vanishes at
    every angle (they carry no information and get a large residual); θ = π puts x at infinity, which harms only
    ``"qr"``.
    """

    axis_noise: float = 0.0
    small_baseline: float = 0.0
    unknown: Unknown = "tan"
    name: ClassVar[str] = "3p1"
    minimal: ClassVar[int] = 3
    degree: ClassVar[int] = 4
    constraints: ClassVar[int] = 1
    min_for_pose: ClassVar[int] = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (0.0 <= self.axis_noise < 1.0):
            raise InputError(
                f"axis_noise: {self.axis_noise} given; give radians from 0 to 1, such as np.radians(1.0) for 1°"
            )
        if not (0.0 <= self.small_baseline < float("inf")):
            raise InputError(f"small_baseline: {self.small_baseline} given; give a positive ρ, or 0 for none")
        if self.unknown not in get_args(Unknown):
            raise InputError(f"unknown: {self.unknown!r} given; give 'tan' for tan(θ/2) or 'cos' for cos θ")

    @property
    def tilt_variance(self) -> float:
        """See `TwoImageProblem.tilt_variance`: a tilt of one axis is the opposite tilt of the other, so both add."""
        return 2.0 * float(self.axis_noise) ** 2

    def tables(self, points: PointSets) -> ThreePlusOneTables:
        """Tables for the kernels; see `Problem.tables`."""
        from rootmatch.problems.three_plus_one.cosine import CosineTables  # takes Numba: see `P3P`
        from rootmatch.problems.three_plus_one.tables import ThreePlusOneTables

        (camera, camera2), (first, second) = self.cameras, self.rays(points.source, points.target)
        kind = CosineTables if self.unknown == "cos" else ThreePlusOneTables
        return kind(
            source=np.ascontiguousarray(first.T),
            target=np.ascontiguousarray(second.T),
            source_deviation=camera.angular_noise(points.source, points.source_noise),
            target_deviation=camera2.angular_noise(points.target, points.target_noise),
            tilt_variance=np.array([self.tilt_variance]),
        )

    def two_views(self, points: PointSets) -> TwoViews | None:
        """See `TwoImageProblem.two_views`; None with the prior of small baselines, which is no part of the search."""
        return None if self.small_baseline > 0.0 else super().two_views(points)

    def coefficients(self, source: ArrayLike, target: ArrayLike) -> NDArray[np.float64]:
        """Quartics (E, 5), highest degree first, of minimal sets of pixels (E, 3, 2) and (E, 3, 2)."""
        from rootmatch.problems.three_plus_one.cosine import cosine_coefficients
        from rootmatch.problems.three_plus_one.quartic import quartic

        first, second = (one.tolist() for one in self.rays(source, target))
        rows = [
            quartic(tuple(q[0]), tuple(p[0]), tuple(q[1]), tuple(p[1]), tuple(q[2]), tuple(p[2]))
            for q, p in zip(first, second, strict=True)
        ]
        if self.unknown == "cos":
            rows = [cosine_coefficients(*row) for row in rows]
        return np.array(rows, dtype=float).reshape(-1, 5)
