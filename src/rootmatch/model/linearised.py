"""Images of a body's points in some poses, to first order."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from rootmatch.algebra.rotation import cross
from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.cameras.base import CameraModel
from rootmatch.model.compiled.projection import linearise
from rootmatch.model.views import Views
from rootmatch.model.visibility import facing_cosines

NO_ROWS, NO_LABELS = np.empty((0, 0)), np.empty((0, 0), np.int64)
"""What a kernel gets in the place of None."""


class Linearised(NamedTuple):
    """Images of a body's points in K poses, to first order.

    Attributes
    ----------
    pixels : (K, n, 2) float64
    jacobian : (K, n, 2, 6) float64
        By rotations ω about the body's centre (left perturbation, rad) and by translations τ.
    by_position : (K, n, 2, 3) float64
        By the points' positions in the camera frame.
    seen : (K, n) bool
        Whether the camera model holds there.
    cosine : (K, n) float64 or None
        Between normals and the direction to the camera.
    expected : (K, n) float64
        Visibility apart from that of the normals: 0 where not seen, and as far as the image is known to reach.
    rotation, position : (K, 3, 3) and (K, 3) float64
        Of the poses, the position that of the body's centre. Arrays of their own.
    blob : (K, n) int64 or None
        The point that stands for each, see `rootmatch.model.blobs`; None if each stands for itself. Pixels and
        Jacobians are those of blobs.
    blob_variance : (K, n) float64 or None
        Of each coordinate of a blob, in px², beside the noise of its detection.
    """

    pixels: Floats
    jacobian: Floats
    by_position: Floats
    seen: Bools
    cosine: Floats | None
    expected: Floats
    rotation: Floats
    position: Floats
    blob: Integers | None = None
    blob_variance: Floats | None = None

    def take(self, which: Integers | slice) -> Linearised:
        """Select some of the poses."""
        return Linearised._make([None if one is None else one[which] for one in self])

    def one(self, k: int) -> Linearised:
        """One of the poses."""
        return self.take(slice(k, k + 1))

    def squared_distances_from(self, target: Floats, sigma: Floats, covariance: Floats) -> Floats:
        """Squared distances (n, n') of detections (n', 2) from the first pose's image, in units of both variances.

        ``sigma`` (n',): that of the detections; ``covariance`` (6, 6): that of the pose.
        """
        by_pose = 0.5 * ((self.jacobian[0] @ covariance) * self.jacobian[0]).sum(axis=(1, 2))
        squared = ((self.pixels[0][:, None] - target) ** 2).sum(axis=2)
        return np.asarray(squared / (by_pose[:, None] + sigma**2))

    def replace_rows(self, which: Integers, others: Linearised) -> Linearised:
        """The same with other poses in the place of some."""
        one = self
        if (one.blob is None) != (others.blob is None):
            one, others = one._fill_blobs(), others._fill_blobs()
        pairs = zip(one, others, strict=True)
        return Linearised._make(None if old is None else replace_array_rows(old, which, new) for old, new in pairs)

    def _fill_blobs(self) -> Linearised:
        """The same where a blob may be of one point."""
        if self.blob is not None:
            return self
        alone = np.tile(np.arange(self.seen.shape[1]), (len(self.seen), 1))
        return self._replace(blob=alone, blob_variance=np.zeros(self.seen.shape))

    @property
    def for_kernels(self) -> tuple[Floats, Integers, Floats]:
        """Cosine, blob and blob variance, without rows where there are none."""
        return (
            NO_ROWS if self.cosine is None else self.cosine,
            NO_LABELS if self.blob is None else self.blob,
            NO_ROWS if self.blob_variance is None else self.blob_variance,
        )


def replace_array_rows(array: Any, which: Integers, rows: Any) -> Any:
    """A copy of an array with other rows in the place of some."""
    out = array.copy()
    out[which] = rows
    return out


def linearise_body(
    body: tuple[Floats, Floats], camera: CameraModel, views: Views | None, rotation: Floats, position: Floats
) -> Linearised:
    """Images of a body in poses (K, 3, 3) with its centre at (K, 3).

    ``body``: points (n, 3) about the centre, and normals (n, 3) or (0, 3); ``views``: of `kernel_camera_views`.
    """
    points, normals = body
    if views is None:
        return _linearise_numpy(points, normals, camera, np.array(rotation, float), np.array(position, float))
    at = image_room(len(points), len(normals) > 0, rotation, position)
    linearise(body, (at.rotation, at.position), views, (*at[:4], at.for_kernels[0], at.expected))
    return at


def image_room(n: int, with_normals: bool, rotation: Floats, position: Floats) -> Linearised:
    """Room for the images of n points in poses (K, 3, 3) and (K, 3), which are in it."""
    shape = len(rotation), n
    return Linearised(
        pixels=np.empty((*shape, 2)),
        jacobian=np.empty((*shape, 2, 6)),
        by_position=np.empty((*shape, 2, 3)),
        seen=np.empty(shape, np.bool_),
        cosine=np.empty(shape) if with_normals else None,
        expected=np.empty(shape),
        rotation=np.array(rotation, float),
        position=np.array(position, float),
    )


def _linearise_numpy(
    points: Floats, normals: Floats, camera: CameraModel, rotation: Floats, position: Floats
) -> Linearised:
    """`linearise_body` for cameras that are not compiled."""
    rotated = points @ rotation.swapaxes(-1, -2)
    places = rotated + position[:, None]
    with np.errstate(all="ignore"):
        pixels, by_position = camera.project(places), camera.jacobian(places)
        seen = camera.sees(places)
    jacobian = np.empty((*pixels.shape, 6))
    # −a [r]× = r × a, row by row
    jacobian[..., :3] = cross(rotated[:, :, None], by_position)
    jacobian[..., 3:] = by_position
    seen = seen & np.isfinite(pixels).all(axis=-1) & np.isfinite(jacobian).all(axis=(-1, -2))
    pixels = np.array(np.where(seen[..., None], pixels, 0.0))
    return Linearised(
        pixels=pixels,
        jacobian=np.where(seen[..., None, None], jacobian, 0.0),
        by_position=np.where(seen[..., None, None], by_position, 0.0),
        seen=seen,
        cosine=facing_cosines(normals if len(normals) else None, camera.from_centre(places), rotation),
        expected=np.where(seen, camera.in_image(pixels), 0.0),
        rotation=rotation,
        position=position,
    )
