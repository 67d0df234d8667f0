"""Priors of the motion between two point sets: what is known of it, in the place of the volume in which it may lie.

The model of `rootmatch.model.point_set_model` integrates the motion of a labelling out under a flat prior. About its
best motion the likelihood is normal, with a covariance Σ; knowledge of the motion is a measurement of some of its six
parameters (seven, where the scale is unknown) that is off by d, with Jacobian J and covariance C. Its prior therefore
multiplies the odds by

    N(d; 0, J Σ Jᵀ + C) / N(0; 0, F + C)

where F is the covariance of a normal distribution with the volume that the flat prior gives what is known: 8π² for a
rotation, 4π for a direction, for a position that of the box in which targets lie, as long along each of its axes, and
for a scale s that times the range of its logarithm. Precise knowledge is worth that volume, and vague knowledge is
worth nothing, so it takes nothing away either, nor does what is vaguely known along one axis take from another. It
takes no second fit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rootmatch.algebra.rotation import angle_count, turn_jacobian
from rootmatch.arrays import Floats, Integers
from rootmatch.hypergraph.assignment import maximise_total
from rootmatch.model.pose_density import ROTATIONS
from rootmatch.model.widened_prediction import find_widening
from rootmatch.problems.points import PointClouds
from rootmatch.problems.pose_fit.point_set_fit import RANGE_OF_LOG, PointSetFit, squared_deviations
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.pose_prior import MIN_TILT, PosePrior, kalman_update, turn_vectors
from rootmatch.problems.pose_fit.shared_errors import EXACT, SharedErrors, SharedPose, copy_shared_errors

DIRECTIONS = 4.0 * math.pi
"""Area of all directions."""
GATE = 21.0
"""Squared deviation, in three coordinates, up to which a target may be a predicted point: chance 10⁻⁴ beyond."""
NARROWED = 16
"""Matches that are tried one by one, of the targets that the fewest points are near. A round value."""
RIDGE = 1e-12
"""Added to the diagonal of a covariance, relative to it, so that it has an inverse."""


class _Off(NamedTuple):
    """How far K motions are from what is known, the same of all or of each (K, …) its own."""

    off: Floats
    """(K, k)."""
    jacobian: Floats
    """(k, 6) or (k, 7): of a turn, a shift and, where it is unknown, the scale of the motion."""
    covariance: Floats
    """(k, k)."""
    flat: Floats
    """(k, k) whose columns span the volume of what is known under the flat prior."""

    @property
    def log_volume(self) -> Floats:
        """Logarithm of 1 / N(0; 0, F + C): of that volume, if the knowledge is precise."""
        half = np.linalg.solve(self.flat, self.covariance).swapaxes(-1, -2)
        unit = 2.0 * math.pi * np.linalg.solve(self.flat, half)
        more = 0.5 * np.linalg.slogdet(np.eye(unit.shape[-1]) + unit)[1]
        return np.asarray(np.linalg.slogdet(self.flat)[1] + more)


@dataclass(frozen=True, eq=False)
class MotionPrior:
    """Predictions of a motion, or knowledge of a part of it, which may all be wrong.

    Parameters
    ----------
    predictions : sequence of (Pose or PosePrior, share)
        Shares add up to 1. A pose has a covariance (6, 6), or (3, 3) in a plane, or one row more if it tells the scale.
    doubt : float
        Probability that none of them holds.
    freedom : float
        Degrees of freedom for which their covariances count: deviations have a t-distribution. As the motion is
        integrated out beforehand, that is only of what the points tell.
    """

    predictions: tuple[tuple[Pose | PosePrior, float | Floats], ...]
    doubt: float | Floats
    freedom: float = math.inf

    def log_factors(self, fit: PointSetFit, box: Floats) -> Floats:
        """Logarithm (predictions + 1, K) of the factor on the odds of each prediction, and of the doubt as the last.

        ``box`` (k, k): edges, as columns, of the box in which positions may be.
        """
        covariance = motion_covariances(fit)
        every = np.empty((len(self.predictions) + 1, len(fit.scale)))
        every[-1] = np.log(self.doubt)
        for row, (known, share) in zip(every, self.predictions, strict=False):
            log_share = np.log((1.0 - self.doubt) * np.maximum(share, 1e-300))
            row[:] = log_share + self._log_factor(known, fit, covariance, box)
        every[:-1, np.linalg.det(fit.rotation) < 0.0] = -np.inf
        return every

    def tell_places(self, box: Floats) -> list[Floats]:
        """How well (…, k + 1) each prediction tells places along the edges of a box, and the scale: from not, 0, to 1.

        A flat prior along an edge e with a variance c² counts as e² / (e² + 2π c²): vague knowledge leaves the object
        where it may be without.
        """
        every, back, size = [], np.linalg.inv(box), len(box)
        for known, _ in self.predictions:
            if isinstance(known, Pose):
                assert known.covariance is not None
                own = slice(angle_count(size), angle_count(size) + size)
                place, scale = known.covariance[..., own, own], float(_has_scale(known))
            elif known.place is not None:
                place, scale = known.place[1], 0.0
            else:
                every.append(np.zeros(size + 1))
                continue
            share = 1.0 / (1.0 + 2.0 * math.pi * np.diagonal(back @ place @ back.T, axis1=-2, axis2=-1))
            every.append(np.concatenate([share, np.full((*share.shape[:-1], 1), scale)], axis=-1))
        return every

    def labellings(self, clouds: PointClouds, *, narrowed: bool = False) -> list[Integers]:
        """The assignment (n,) about each whole pose that is predicted: the nearest targets within its covariance.

        ``narrowed``: about what one more match makes of each of these poses, of targets that few points are near; none
        where no target is near several points.
        """
        every = []
        for known, _ in self.predictions:
            pose = known.pose if isinstance(known, PosePrior) else known
            if pose is not None and (_has_scale(pose) or not clouds.scaled):
                every += [_label_nearest(clouds, one) for one in (_narrow(clouds, pose) if narrowed else [pose])]
        return every

    def allows(self, clouds: PointClouds, assignment: Integers, which: int) -> bool:
        """Whether all matches of an assignment (n,) are where one of the predictions, of a whole pose, has them."""
        known = self.predictions[which][0]
        pose = known.pose if isinstance(known, PosePrior) else known
        if pose is None or (clouds.scaled and not _has_scale(pose)):
            return False
        off, spread = (part[assignment >= 0, assignment[assignment >= 0]] for part in _deviations(clouds, pose))
        return bool((squared_deviations(off, spread) < GATE).all())

    def _log_factor(self, known: Pose | PosePrior, fit: PointSetFit, covariance: Floats, box: Floats) -> Floats:
        """Logarithm (K,) of the factor that one prediction puts on the odds of rotations."""
        measured = _measure_offsets(known, fit, box)
        off, jacobian = measured.off, measured.jacobian
        whole = jacobian @ covariance @ jacobian.T + measured.covariance
        # turns and shifts have different units: scaled, so that the inverse is exact
        size = np.sqrt(np.diagonal(whole, axis1=1, axis2=2))
        unit, scaled, count = whole / (size[:, :, None] * size[:, None]), off / size, off.shape[1]
        unit = unit + RIDGE * np.eye(count)
        squared = squared_deviations(scaled, unit)
        peak = 0.5 * (np.linalg.slogdet(unit)[1] + count * math.log(2.0 * math.pi)) + np.log(size).sum(axis=1)
        tail = -0.5 * squared
        if math.isfinite(self.freedom):
            half, more = 0.5 * self.freedom, 0.5 * count
            tail = math.lgamma(half + more) - math.lgamma(half) - more * math.log(half)
            tail = tail - (half + more) * np.log1p(squared / self.freedom)
        return np.asarray(measured.log_volume - peak + tail)


def stack_priors(priors: Sequence[MotionPrior | None], counts: Sequence[int]) -> MotionPrior | None:
    """One prior of the motions of several bodies, so many of each; None unless each predicts one whole pose."""
    known = [one for one in priors if one is not None and len(one.predictions) == 1]
    poses = [pose for one in known for pose, _ in one.predictions if isinstance(pose, Pose)]
    told = [pose.covariance for pose in poses if pose.covariance is not None]
    if len(told) < len(priors) or len({(one.freedom, len(some)) for one, some in zip(known, told, strict=True)}) > 1:
        return None
    columns: list[Any] = [[pose.R for pose in poses], [pose.t for pose in poses], told, [pose.scale for pose in poses]]
    columns += [[one.predictions[0][1] for one in known], [one.doubt for one in known]]
    each: list[Any] = [np.repeat(np.array(one), counts, axis=0) for one in columns]
    return MotionPrior(((Pose.unchecked(*each[:4]), each[4]),), each[5], known[0].freedom)


def motion_covariances(fit: PointSetFit) -> Floats:
    """Covariances (K, 6, 6) of a turn (ω, rad) and of the translation of fitted motions; (K, 3, 3) in a plane.

    One row more where the scale is fitted too.
    """
    turned = (fit.rotation @ fit.centre[:, :, None])[:, :, 0]
    whole, angles = fit.covariance, angle_count(turned.shape[1])
    shift = slice(angles, angles + turned.shape[1])
    change = np.tile(np.eye(whole.shape[1]), (len(whole), 1, 1))  # from the centre of the matches to the origin
    change[:, shift, :angles] = -turn_jacobian(fit.scale[:, None] * turned)
    if fit.clouds.scaled:
        change[:, -1, -1], change[:, shift, -1] = fit.scale, -fit.scale[:, None] * turned
    return np.asarray(change @ whole @ change.swapaxes(1, 2))


def fuse_with_known(fit: Pose, known: Pose | PosePrior, freedom: float = math.inf) -> Pose:
    """A fitted motion and what is known of it together, to first order; shared errors are those of the fit alone.

    ``freedom``: see `MotionPrior`.
    """
    if isinstance(known, PosePrior):
        return known.with_prediction(fit)
    fit = _correct_scale_bias(fit)
    assert known.covariance is not None
    assert fit.covariance is not None
    size = len(known.covariance)
    # as `kalman_update` takes it: were it the difference, each frame would add to the scale
    longer = fit.scale * math.log(known.scale / fit.scale)
    off = np.array([*turn_vectors((known.R @ fit.R.T)[None])[0], *(known.t - fit.t), longer])[:size]
    factor = find_widening(off, known.covariance, fit.covariance[:size, :size], freedom)
    return kalman_update(fit, np.eye(size), off, factor * known.covariance)


def _correct_scale_bias(fit: Pose) -> Pose:
    """A fit whose scale is the most likely one with rotations integrated out: the best rotation fits noise as well.

    The likelihood of a rotation falls with its squared angle times the scale, so the integral has a factor s^(−1/2) for
    each angle.
    """
    if not _has_scale(fit):
        return fit
    assert fit.covariance is not None
    with_scale, variance = fit.covariance[:, -1], float(fit.covariance[-1, -1])
    angles = angle_count(len(fit.t))
    scale = fit.scale * math.exp(-0.5 * angles * variance / fit.scale**2)
    shift = (scale - fit.scale) / variance * with_scale[angles:-1]
    return copy_shared_errors(Pose.unchecked(fit.R, fit.t + shift, fit.covariance, scale), fit)


def add_source_errors(clouds: PointClouds, assignment: Integers, fit: Pose) -> Pose:
    """The fitted motion of an assignment (n,), with what it has of the errors of the source, unless that is exact."""
    if fit.scale**2 * float(clouds.source_variance.max()) <= EXACT * float(clouds.target_variance.max()):
        return fit
    assert fit.covariance is not None
    used, linear = assignment >= 0, fit.scale * fit.R
    first, second = clouds.covariances(linear)
    by_pose = used[:, None, None] * _motion_jacobians(clouds.source @ fit.R.T, fit)
    known = clouds.source_covariance
    covariance = clouds.source_variance[:, None, None] * np.eye(len(linear)) if known is None else known
    by_point = np.broadcast_to(linear, (len(used), *linear.shape))
    spread = first + second[assignment]
    return SharedPose.of(fit, SharedErrors.of_points(fit.covariance, (by_pose, by_point), spread, covariance))


def _has_scale(pose: Pose) -> bool:
    """Whether the scale is one of the predicted parameters."""
    size = pose.t.shape[-1]
    return pose.covariance is not None and pose.covariance.shape[-1] > angle_count(size) + size


def _measure_offsets(known: Pose | PosePrior, fit: PointSetFit, box: Floats) -> _Off:
    """How far fitted motions are from what is known of them; ``box`` (3, 3): see `MotionPrior.log_factors`."""
    dimension, angles, back = len(box), angle_count(len(box)), fit.rotation.swapaxes(1, 2)
    turns = ROTATIONS ** (1.0 / 3.0) * np.eye(3) if dimension == 3 else 2.0 * math.pi * np.eye(1)
    fitted, shift = angles + dimension + fit.clouds.scaled, slice(angles, angles + dimension)
    if isinstance(known, Pose):
        assert known.covariance is not None
        size, scale = known.covariance.shape[-1], np.asarray(known.scale)
        longer, flat = (known.scale - fit.scale)[:, None], np.zeros((*scale.shape, *(angles + dimension + 1,) * 2))
        off = np.concatenate([turn_vectors(known.R @ back), known.t - fit.shift, longer], axis=1)[:, :size]
        flat[..., :angles, :angles], flat[..., shift, shift], flat[..., -1, -1] = turns, box, scale * RANGE_OF_LOG
        return _Off(off, np.eye(size, fitted), known.covariance, flat[..., :size, :size])
    parts = []
    if known.turn is not None:
        R, covariance = known.turn
        parts.append(_Off(turn_vectors(R @ back), np.eye(angles, fitted), covariance, turns))
    elif known.down is not None:
        source, target, noise = known.down
        across = np.linalg.svd(target[None])[2][1:]  # axes of the turns that tilt it
        off = _tilt_vectors(fit.rotation @ source, target, across) @ across.T
        tilt = max(noise, MIN_TILT) ** 2 * np.eye(2)
        parts.append(_Off(off, across @ np.eye(3, fitted), tilt, DIRECTIONS**0.5 * np.eye(2)))
    if known.place is not None:
        t, covariance = known.place
        parts.append(_Off(t - fit.shift, np.eye(dimension, fitted, angles), covariance, box))
    from scipy.linalg import block_diag  # slow to import

    return _Off(
        np.concatenate([one.off for one in parts], axis=1),
        np.concatenate([one.jacobian for one in parts]),
        block_diag(*[one.covariance for one in parts]),
        block_diag(*[one.flat for one in parts]),
    )


def _tilt_vectors(now: Floats, target: Floats, across: Floats) -> Floats:
    """Rotation vectors (K, 3) that take directions (K, 3) to the target's (3,); ``across``: the opposite one's."""
    axis = np.cross(now, target)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, now @ target)
    unit = np.where(sine[:, None] > 0.0, axis / np.maximum(sine, 1e-300)[:, None], across[0])
    return np.asarray(angle[:, None] * unit)


def _label_nearest(clouds: PointClouds, pose: Pose) -> Integers:
    """The assignment (n,) about a pose: the targets nearest to where it predicts the points."""
    off, spread = _deviations(clouds, pose)
    squared = squared_deviations(off, spread)
    near = squared < GATE
    if (near.sum(axis=0) > 1).any() or (near.sum(axis=1) > 1).any():
        return maximise_total(np.maximum(GATE - squared, 0.0), 0.0)
    one = np.full(len(squared), -1, np.int64)
    rows, columns = np.nonzero(near)
    one[rows] = columns
    return one


def _narrow(clouds: PointClouds, pose: Pose) -> list[Pose]:
    """A predicted pose after one match each: where points are closer than it is certain, errors are those of all."""
    off, spread = _deviations(clouds, pose)
    near = squared_deviations(off, spread) < GATE
    count = near.sum(axis=0)
    if not ((count > 1).any() or (near.sum(axis=1) > 1).any()):
        return []
    columns = [j for j in np.argsort(count, kind="stable").tolist() if count[j]]
    pairs = [(i, j) for j in columns for i in np.flatnonzero(near[:, j]).tolist()][:NARROWED]
    jacobian = _motion_jacobians(clouds.source @ pose.R.T, pose)
    first, second = clouds.covariances(pose.scale * pose.R)
    return [kalman_update(pose, jacobian[i], off[i, j], first[i] + second[j]) for i, j in pairs]


def _deviations(clouds: PointClouds, pose: Pose) -> tuple[Floats, Floats]:
    """Deviations (n, n', k) of targets from the places that a pose predicts, and their covariances (n, n', k, k)."""
    assert pose.covariance is not None
    turned = clouds.source @ pose.R.T
    rows, moved = _motion_jacobians(turned, pose), pose.scale * turned
    spread = rows @ pose.covariance @ rows.swapaxes(1, 2)
    first, second = clouds.covariances(pose.scale * pose.R)
    whole = (spread + first)[:, None] + second
    whole = whole + RIDGE * np.trace(whole, axis1=2, axis2=3)[..., None, None] * np.eye(len(pose.t))
    return clouds.target - (moved + pose.t)[:, None], whole


def _motion_jacobians(turned: Floats, pose: Pose) -> Floats:
    """Derivatives (n, k, p) of moved source points, of which some (n, k) are turned alone, by a motion's p errors."""
    assert pose.covariance is not None
    still = np.broadcast_to(np.eye(turned.shape[1]), (*turned.shape, turned.shape[1]))
    parts = [turn_jacobian(pose.scale * turned), still, turned[:, :, None]]
    return np.concatenate(parts, axis=2)[:, :, : len(pose.covariance)]
