"""Maximum-likelihood pose and focal length of an upright camera whose zoom is unknown, with their covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.cameras.pinhole import Camera
from rootmatch.problems.points import PointSets
from rootmatch.problems.pose_fit.camera_fit import pack_matches
from rootmatch.problems.pose_fit.descent import State, descend, select_lowest, state_covariance, sum_of_squares
from rootmatch.problems.pose_fit.fitted_pose import make_pose_of_fit, to_callers_frame
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.prior_residuals import Upright
from rootmatch.problems.pose_fit.projection_model import ProjectionModel
from rootmatch.problems.pose_fit.starts import GRID, STARTS

TOLD = 20.0
"""Factor on the usual focal length, up or down, within which one that linear equations tell is taken. A round value."""


@dataclass(frozen=True, eq=False)
class _ZoomModel(ProjectionModel):
    """B poses with focal lengths; states: (R, t, log f). Images (B, n, 2) count from the principal point."""

    usual: float = 1.0
    """Focal length to start from where none is told, in pixels."""

    def residuals(self, state: State) -> Floats:
        """See `Model`."""
        return self._at(state[2]).residuals(state[:2])

    def jacobian(self, state: State) -> Floats:
        """See `Model`."""
        model, (rotation, translation) = self._at(state[2]), state[:2]
        projected = self.camera.project(self.points @ rotation.swapaxes(-1, -2) + translation[:, None])
        by_focal = np.where(model.weight[..., None] > 0.0, projected * model.weight[..., None], 0.0)
        return np.concatenate([model.jacobian(state[:2]), by_focal.reshape(len(rotation), -1, 1)], axis=-1)

    def moved(self, state: State, step: Floats) -> State:
        """See `Model`."""
        return *super().moved(state[:2], step[:, :-1]), state[2] + step[:, -1]

    def _at(self, log: Floats) -> ProjectionModel:
        """The model of the poses alone, at known focal lengths, in units of these."""
        focal = np.exp(log)[:, None]
        image, weight = self.image / focal[..., None], self.weight * focal
        return ProjectionModel(self.points, image, weight, self.camera, self.axes)


class ZoomFits(NamedTuple):
    """S poses with focal lengths of each of K assignments, the best first."""

    rotation: Floats
    """(K, S, 3, 3)."""
    position: Floats
    """(K, S, 3) of the centre of all source points in the camera frame."""
    log_focal: Floats
    """(K, S)."""
    chi2: Floats
    """(K, S); infinite where there is none."""


def zoom_fits(
    points: PointSets,
    centre: Floats,
    upright: Upright,
    assignments: Integers,
    steps: int,
    *,
    usual: float,
    maximum: int,
) -> ZoomFits:
    """The ``maximum`` lowest fits of each assignment after some steps from each of `STARTS`; several may share one.

    Parameters as of `zoom_poses`. Without steps: of a grid of rotations, with what then follows from linear equations.
    """
    model, _, unit = _make_model(points, centre, upright, assignments, usual)
    fits = descend(model.repeated(STARTS), _best_starts(model, upright), steps)
    (rotation, place, log), chi2 = select_lowest(*fits, len(assignments), maximum)
    shape = len(assignments), maximum
    return ZoomFits(
        rotation.reshape(*shape, 3, 3), unit * place.reshape(*shape, 3), log.reshape(shape), chi2.reshape(shape)
    )


def zoom_poses(
    points: PointSets,
    centre: Floats,
    upright: Upright,
    assignments: Integers,
    start: Pose | None = None,
    *,
    usual: float,
) -> list[Pose | None]:
    """The most likely pose and focal length of each assignment (K, n), None if there is none.

    Parameters
    ----------
    points : PointSets
        Points in space and pixels with their σ.
    centre : (2,) array
        Principal point.
    upright : Upright
        The known vertical.
    assignments : (K, n) int array
        −1 where unmatched; at least three matches in each.
    start : Pose, optional
        With a focal length, from which all are fitted; else from many.
    usual : float
        Focal length to start from where the points tell none.
    """
    model, middle, unit = _make_model(points, centre, upright, assignments, usual)
    count = len(assignments)
    if start is None:
        state, chi2 = descend(model.repeated(STARTS), _best_starts(model, upright))
        state, chi2 = select_lowest(state, chi2, count)
    else:
        assert start.focal is not None
        place = (start.t + start.R @ middle) / unit
        near = upright.nearest(start.R), place, np.log(start.focal)
        state, chi2 = descend(model, tuple(np.repeat(np.asarray(one)[None], count, axis=0) for one in near))
    covariance = state_covariance(model, state)
    poses: list[Pose | None] = []
    for k, assignment in enumerate(assignments):
        if not np.isfinite(chi2[k]):
            poses.append(None)
            continue
        rotation, focal = state[0][k], float(np.exp(state[2][k]))
        translation, own = to_callers_frame(
            rotation, state[1][k], covariance[k], axes=model.axes, centre=middle, unit=unit
        )
        own[-1] *= focal  # of log f
        own[:, -1] *= focal
        members = np.flatnonzero(assignment >= 0)
        positions = points.source[members] @ rotation.T + translation
        predicted = centre + focal * positions[:, :2] / positions[:, 2:]
        poses.append(
            make_pose_of_fit(
                rotation,
                translation,
                own,
                chi2=float(chi2[k]),
                dof=2 * len(members) - 5,
                points=members,
                predicted=predicted,
                residuals=np.linalg.norm(points.target[assignment[members]] - predicted, axis=1),
                sigma=points.target_noise[assignment[members]],
                focal=focal,
            )
        )
    return poses


def _make_model(
    points: PointSets, centre: Floats, upright: Upright, assignments: Integers, usual: float
) -> tuple[_ZoomModel, Floats, float]:
    """The fits of assignments, with the centre and the unit of the points that they use."""
    middle, unit, _, target, places, weight = pack_matches(points, assignments)
    image = points.target[target] - centre
    return _ZoomModel(places, image, weight, Camera(1.0, 1.0, 0.0, 0.0), upright.camera[1:2], usual=usual), middle, unit


def _best_starts(model: _ZoomModel, upright: Upright) -> State:
    """The best starts of each fit, (K `STARTS`, …)."""
    starts = _starts(model, upright)
    return select_lowest(starts, sum_of_squares(model.repeated(GRID).residuals(starts)), len(model.points), STARTS)[0]


def _starts(model: _ZoomModel, upright: Upright) -> State:
    """For a grid of rotations (S,) translation and focal length by linear equations: (K S, 3, 3), (K S, 3), (K S,).

    Of points at nearly one depth they tell no focal length, least of all beside the right rotation; the usual one then
    stands for it.
    """
    rotation = upright.turned(2.0 * np.pi * np.arange(GRID) / GRID)
    turned = model.points[:, None] @ rotation.swapaxes(-1, -2)
    x, y, z = np.moveaxis(turned, -1, 0)
    u, v = (np.broadcast_to(model.image[:, None, :, axis], x.shape) for axis in (0, 1))
    one, none = np.ones_like(x), np.zeros_like(x)
    # u (z + c) = f x + f a and v (z + c) = f y + f b are linear in c, f a, f b and f
    rows = np.stack([np.stack([u, -one, none, -x], axis=-1), np.stack([v, none, -one, -y], axis=-1)], axis=-2)
    known = -np.stack([u * z, v * z], axis=-1)
    scale = model.weight[:, None, :, None]
    rows = (rows * scale[..., None]).reshape(*x.shape[:2], -1, 4)
    known = (known * scale).reshape(*x.shape[:2], -1)
    c, fa, fb, f = _least_squares(rows, known)
    with np.errstate(all="ignore"):
        told = np.abs(np.log(f / model.usual)) < np.log(TOLD)
    if not told.all():
        usual = _least_squares(rows[..., :3], known - model.usual * rows[..., 3])
        c, fa, fb = (np.where(told, own, other) for own, other in zip((c, fa, fb), usual, strict=True))
        f = np.where(told, f, model.usual)
    translation = np.stack([fa / f, fb / f, c], axis=-1)
    return np.tile(rotation, (len(model.points), 1, 1)), translation.reshape(-1, 3), np.log(f).ravel()


def _least_squares(rows: Floats, known: Floats) -> Floats:
    """Solutions, the unknowns first, of stacked linear equations (…, m, q) and (…, m)."""
    normal = rows.swapaxes(-1, -2) @ rows
    diagonal = np.arange(rows.shape[-1])
    normal[..., diagonal, diagonal] = normal[..., diagonal, diagonal] * (1.0 + 1e-12) + 1e-300
    solved = np.linalg.solve(normal, rows.swapaxes(-1, -2) @ known[..., None])[..., 0]
    return np.moveaxis(np.asarray(solved, float), -1, 0)
