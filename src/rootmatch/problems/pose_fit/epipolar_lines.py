"""Two images with a common direction: how far pairs lie from their epipolar lines, and along them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.cameras.base import CameraModel
from rootmatch.problems.points import PointSets


@dataclass(frozen=True, eq=False)
class Views:
    """Two images and their noise, in frames whose y is the common direction."""

    first: Floats
    second: Floats
    """(n, 3) and (n', 3). Rays of any length: of a pinhole, the third coordinate of the camera frame is 1."""
    first_axes: Floats
    second_axes: Floats
    """(n, 3, 2) and (n', 3, 2). How such a ray moves with a pixel of its image."""
    first_sigma: Floats
    second_sigma: Floats
    """(n,) and (n',), in pixels."""
    tilt: float
    """Standard deviation in radians of the one direction against the other, on each of two axes; 0 for none."""
    focal: float
    """Of the second image, in pixels."""

    @classmethod
    def of(
        cls, points: PointSets, cameras: tuple[CameraModel, CameraModel], rotations: tuple[Floats, Floats], tilt: float
    ) -> Views:
        """Views of pixels, each rotated so that the common direction is y."""
        rays, axes = [], []
        for pixels, camera, rotation in zip((points.source, points.target), cameras, rotations, strict=True):
            ray, own_axes = camera.axes(pixels)
            rays.append(ray @ rotation.T)
            axes.append(rotation @ own_axes)
        return cls(
            first=rays[0],
            second=rays[1],
            first_axes=axes[0],
            second_axes=axes[1],
            first_sigma=points.source_noise,
            second_sigma=points.target_noise,
            tilt=tilt,
            focal=cameras[1].focal,
        )

    def deviations(self, essential: Floats, i: Integers, k: Integers) -> tuple[Floats, Floats]:
        """Epipolar deviations in σ, and σ across the line in the second image in pixels, of pairs (…, m) of indices.

        ``essential`` (…, 3, 3); first-order (Sampson) variance of both pixels.
        """
        first, second = self.first[i], self.second[k]
        line = (essential[..., None, :, :] @ first[..., None])[..., 0]
        value = (second * line).sum(axis=-1)
        by_second = ((line[..., None, :] @ self.second_axes[k])[..., 0, :] ** 2).sum(axis=-1)
        back = (second[..., None, :] @ essential[..., None, :, :])[..., 0, :]
        by_first = ((back[..., None, :] @ self.first_axes[i])[..., 0, :] ** 2).sum(axis=-1)
        variance = by_second * self.second_sigma[k] ** 2 + by_first * self.first_sigma[i] ** 2
        deviation = np.sqrt(np.maximum(variance, 1e-300))
        return value / deviation, deviation / np.sqrt(np.maximum(by_second, 1e-300))

    def offsets_from_lines(self, essential: Floats, i: Integers, k: Integers) -> tuple[Floats, Floats]:
        """Vectors (m, 2) in pixels to detections from their epipolar lines, and σ of their lengths, both ends noisy."""
        deviation, width = self.deviations(essential, i, k)
        slope = (essential @ self.first[i][..., None])[..., 0][..., None, :] @ self.second_axes[k]
        direction = slope[..., 0, :] / np.maximum(np.linalg.norm(slope[..., 0, :], axis=-1, keepdims=True), 1e-300)
        return (deviation * width)[..., None] * direction, width

    def parallax(self, rotation: Floats, translation: Floats, i: Integers, k: Integers) -> Floats:
        """How far detections (…, m) lie along their epipolar lines from where points at infinity are seen, in pixels.

        Positive towards the epipole: in front of both cameras, for this sign of the translation.
        """
        far = (rotation[..., None, :, :] @ self.first[i][..., None])[..., 0]
        far = far / np.linalg.norm(far, axis=-1, keepdims=True)
        towards = translation[..., None, :] - (far * translation[..., None, :]).sum(axis=-1, keepdims=True) * far
        towards = towards / np.maximum(np.linalg.norm(towards, axis=-1, keepdims=True), 1e-300)
        second = self.second[k]
        return np.asarray(self.focal * np.arctan2((second * towards).sum(axis=-1), (second * far).sum(axis=-1)))
