"""COLMAP's lenses that have no class of their own here, through pycolmap (the extra ``colmap``)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from rootmatch.arrays import Bools, Floats
from rootmatch.cameras.lens import Lens
from rootmatch.errors import InputError, RootmatchError, quote_value

AGREES = 1e-7
"""Distance in focal lengths at which a ray that was projected again has come back. Not tuned."""
STEP = 1e-6
"""Step of numerical derivatives over the distance of a point. Not tuned."""


@dataclass(frozen=True)
class Colmap(Lens):
    """A lens model of COLMAP, by its name.

    Parameters
    ----------
    model : str
        Such as ``"FOV"`` or ``"THIN_PRISM_FISHEYE"``: one with focal lengths and a principal point.
    values : sequence of floats
        Its parameters after those.

    Notes
    -----
    What lies in front of the camera alone is seen, and derivatives are numerical.
    """

    model: str
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", tuple(float(value) for value in self.values))
        if not np.all(np.isfinite(self.values)):
            raise InputError(f"camera: model {self.model} with NaN or infinity; give finite parameters")
        focal, centre, names = colmap_parameters(self.model)
        if not focal or not centre:
            raise InputError(f"camera: COLMAP's model {self.model} has no focal length; give another camera")
        if len(names) != len(focal) + len(centre) + len(self.values):
            raise InputError(
                f"camera: model {self.model} has {len(names)} parameters: {', '.join(names)}; give that many"
            )

    @cached_property
    def _camera(self) -> Any:
        focal, centre, _ = colmap_parameters(self.model)
        fixed = [1.0 if k in focal else 0.0 for k in range(len(focal) + len(centre))]
        return _pycolmap().Camera(model=self.model, width=1, height=1, params=[*fixed, *self.values])

    @property
    def radius(self) -> float:
        """See `Lens.radius`; unknown."""
        return np.inf

    def __reduce__(self) -> Any:
        """Pickled without pycolmap's object."""
        return Colmap, (self.model, self.values)

    def image(self, points: Floats) -> Floats:
        """See `Lens.image`."""
        flat = np.ascontiguousarray(points.reshape(-1, 3))
        return np.asarray(self._camera.img_from_cam(flat), dtype=np.float64).reshape(*points.shape[:-1], 2)

    def jacobian(self, points: Floats) -> Floats:
        """See `Lens.jacobian`."""
        step = STEP * np.linalg.norm(points, axis=-1, keepdims=True)
        moved = [(self.image(points + step * e) - self.image(points - step * e)) / (2.0 * step) for e in np.eye(3)]
        return np.stack(moved, axis=-1)

    def sees(self, points: Floats) -> Bools:
        """See `Lens.sees`."""
        with np.errstate(all="ignore"):
            plane = points[..., :2] / points[..., 2:]
            back = self._plane(self.image(points))
            return np.asarray((points[..., 2] > 0.0) & (np.abs(back - plane).max(axis=-1) < AGREES))

    def rays(self, image: Floats) -> Floats:
        """See `Lens.rays`."""
        plane = self._plane(image)
        rays = np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1)
        with np.errstate(all="ignore"):
            back = np.abs(self.image(rays) - image).max(axis=-1) < AGREES
        return np.where(back[..., None], rays, np.nan)

    def _plane(self, image: Floats) -> Floats:
        flat = np.ascontiguousarray(image.reshape(-1, 2))
        return np.asarray(self._camera.cam_from_img(flat), dtype=np.float64).reshape(image.shape)


def colmap_parameters(model: str) -> tuple[list[int], list[int], list[str]]:
    """Which parameters of a model are focal lengths, which the principal point, and the names of all.

    Raises
    ------
    InputError
        If pycolmap does not know the model.
    RootmatchError
        If pycolmap is needed and not installed.
    """
    pycolmap = _pycolmap()
    known = {name: value for name, value in pycolmap.CameraModelId.__members__.items() if name != "INVALID"}
    if model not in known:
        raise InputError(f"camera: COLMAP has no model {quote_value(model)}; it has {', '.join(sorted(known))}")
    camera = pycolmap.Camera.create_from_model_id(1, known[model], 1.0, 1, 1)
    names = [name.strip() for name in camera.params_info.split(",")]
    return list(camera.focal_length_idxs()), list(camera.principal_point_idxs()), names


def _pycolmap() -> Any:
    try:
        import pycolmap
    except ImportError:
        raise RootmatchError(
            "camera: this model of COLMAP needs pycolmap; install the extra: pip install 'rootmatch[colmap]'"
        ) from None
    return pycolmap
