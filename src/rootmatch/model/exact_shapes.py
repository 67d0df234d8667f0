"""Bodies that may be exactly symmetric, or exact copies of each other, though their points were measured with errors.

What is measured of such a body tells nothing of which way round it is. So its points are those that were measured, or
those that are symmetric and the most probable by them: see `rootmatch.model.exact_symmetry`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rootmatch.arrays import Floats, Integers, cache_by_values
from rootmatch.deadline import checkpoint
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import weigh_assignments
from rootmatch.model.exact_symmetry import ExactShape, fit_exact_shape, leave_points_out, log_prior_of_outliers
from rootmatch.model.modes import Modes
from rootmatch.model.near_symmetries import find_symmetries
from rootmatch.model.reweighed import reweigh_evidence

DRAWN = 0.01
"""Mean square deviation, in units of the noise, below which points were drawn so rather than measured: labellings are
equal as they are. A round value."""
FAR_BEHIND = 60.0
"""Log-odds behind the best mode beyond which none that is worse than clutter is weighed as one of an exact shape. A
round value."""

Copies = Sequence[tuple[DetectionModel, Integers]]
"""Bodies that were measured, and the point (n,) of each for every point of another one that they are copies of."""


def exact_shape_log_gains(model: DetectionModel, modes: Modes, copies: Copies = ()) -> Floats | float:
    """By how much the log-odds (M,) of a body's modes change as it may be of an exact shape; 0 if it is of none.

    What the body weighs against clutter stays what it is, as nobody says whether its points were measured or drawn.
    """
    if model.source_covariance is None or len(modes.log_odds) < 2:
        return 0.0
    shapes = _candidate_shapes(model, copies)
    if not shapes:
        return 0.0
    counts = modes.log_mass > min(modes.log_mass.max() - FAR_BEHIND, 0.0)
    (some,) = counts.nonzero()
    odds = np.array([0.0, *(shape.log_odds for shape in shapes)])
    own, *exact = odds - np.logaddexp.reduce(odds)
    gains, kept = np.full(len(counts), own), modes.take(some)
    for share, shape in zip(exact, shapes, strict=True):
        gains[some] = np.logaddexp(gains[some], share + _shape_log_gains(model, kept, shape))
    before, after = (float(np.logaddexp.reduce(one)) for one in (modes.log_mass, modes.log_mass + gains))
    return np.asarray(gains + before - after)


def _shape_log_gains(model: DetectionModel, modes: Modes, shape: ExactShape) -> Floats:
    """Logarithm (M,) of the evidence of modes with points of an exact shape, over that with those measured."""
    assignments = modes.assignments
    n, at = len(shape.moved), model.linearise_about(modes.rotation, modes.position)
    found = weigh_assignments(model, assignments, at)
    by_point = at.by_position @ at.rotation[:, None]
    own = model.assigned_covariances(at, np.maximum(assignments, 0))
    out = found.log_odds.copy()
    for k in np.flatnonzero(np.isfinite(out)).tolist():
        checkpoint()
        used = np.flatnonzero(assignments[k] >= 0)
        m, size = np.arange(len(used)), 2 * len(used)
        by_points = np.zeros((len(used), 2, n, 3))  # sightings of one point share its error
        by_points[m, :, used % n] = by_point[k, used]
        white = np.zeros((len(used), 2, len(used), 2))
        white[m, :, m] = own[k, used]
        rows = by_points.reshape(size, -1)
        assert model.source_covariance is not None
        of_points = np.einsum("kanb,nbc->kanc", by_points, model.source_covariance[:n])
        alone = white.reshape(size, size) + of_points.reshape(size, -1) @ rows.T
        spread = white.reshape(size, size) + rows @ shape.covariance @ rows.T
        offset = (model.target[assignments[k, used]] - at.pixels[k, used]).ravel()
        known = at.jacobian[k, used].reshape(size, 6), offset, alone, model.noise_freedom
        out[k] += reweigh_evidence(
            found.take(slice(k, k + 1)), known, spread, offset - rows @ shape.moved.ravel()
        ).gained
    return np.asarray(out - modes.log_odds)


def _candidate_shapes(model: DetectionModel, copies: Copies) -> tuple[ExactShape, ...]:
    """The exact shapes of a body by its own near symmetries and its copies."""
    assert model.source_covariance is not None
    n = len(model.points) // max(len(model.images), 1)
    points, covariance = [model.points[:n]], [model.source_covariance[:n]]
    normals = None if model.normals is None else model.normals[:n]
    images = [one.image for one in find_symmetries(points[0], normals, covariance=covariance[0])]
    for copy, image in copies:
        assert copy.source_covariance is not None
        images.append(n * len(points) + image)
        points.append(copy.points[:n])
        covariance.append(copy.source_covariance[:n])
    if not images:
        return ()
    return _find_exact_shapes(np.concatenate(points), np.concatenate(covariance), np.array(images))


@cache_by_values(128)
def _find_exact_shapes(points: Floats, covariance: Floats, images: Integers) -> tuple[ExactShape, ...]:
    """The shapes of a body, the first n points, by motions that are exact with one half or more; none without any.

    Parameters
    ----------
    points : (N, 3) array
        Of the body and of its copies.
    covariance : (N, 3, 3) array
    images : (W, n) int64 array
        The point at the place of each of the body after a motion; −1 for none.
    """
    n, motions, fewest = images.shape[1], [], images.shape[1]
    for image in images:
        checkpoint()
        (first,) = np.nonzero(image >= 0)
        every, place = np.unique(np.concatenate([first, image[first]]), return_inverse=True)
        motion = place[: len(first)], place[len(first) :]
        one = fit_exact_shape(points[every], covariance[every], [motion])
        if one is not None and one.log_odds + log_prior_of_outliers(n - len(first), n) >= 0.0:
            motions.append((first, image[first]))
            fewest = min(fewest, n - len(first))
    found = fit_exact_shape(points, covariance, motions) if motions else None
    if found is None or found.squared < DRAWN * found.freedom:
        return ()
    found = found._replace(log_odds=found.log_odds + log_prior_of_outliers(fewest, n))
    own = leave_points_out(points, covariance, motions, found)
    return tuple(one._replace(moved=one.moved[:n], covariance=one.covariance[: 3 * n, : 3 * n]) for one in own)
