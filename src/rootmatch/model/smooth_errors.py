"""Points that are off alike where they are near each other, as those of a bent body, or of a gear with other teeth.

On each axis the errors are a Gaussian process: two points at the distance d have the covariance τ² exp(−d² / 2 ρ²), ρ
the body's root mean square radius. So matches tell where the points about them are, and an assignment grows from that
of a mode over all that lies about it, however far off it is in the end.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import checkpoint
from rootmatch.frozen import copy_with
from rootmatch.model.compiled.assigning import assign_likeliest
from rootmatch.model.compiled.gating import gate
from rootmatch.model.detection_model import USUAL_RATE, DetectionModel
from rootmatch.model.evidence import Evidence, weigh_assignments
from rootmatch.model.linearised import Linearised
from rootmatch.model.modes import Modes
from rootmatch.model.prediction import GATE, HIDDEN
from rootmatch.model.reweighed import Reweighed, reweigh_evidence
from rootmatch.problems.pose_fit.reference_point import body_radius


def smooth_error_log_odds(model: DetectionModel, modes: Modes, k: int, errors: Floats) -> Floats:
    """Log-odds (W,) against clutter alone of a body whose points have smooth errors (W,), and all that is near it.

    Of one camera. Mode ``k`` has the pose and the first matches; ``errors``: standard deviations τ.
    """
    at, start = model.linearise_about(modes.rotation[k : k + 1], modes.position[k : k + 1]), modes.assignments[k]
    squares = ((model.points[:, None] - model.points) ** 2).sum(axis=2)
    alike = np.exp(-0.5 * squares / body_radius(model.points) ** 2)
    image = np.einsum("iac,jbc->iajb", at.by_position[0], at.by_position[0]) * alike[:, None, :, None]
    out = []
    for error in np.asarray(errors).tolist():
        independent = copy_with(model, source_covariance=np.tile(error**2 * np.eye(3), (len(alike), 1, 1)))
        off = _Off(independent, at, error**2 * image)
        out.append(off.grow_log_odds(start))
    return np.array(out)


class _Off(NamedTuple):
    """A body with points that are off, about one pose."""

    model: DetectionModel
    """With independent errors of the same size."""
    at: Linearised
    shared: Floats
    """Covariance (n, 2, n, 2) of the images of the points, px²."""

    def grow_log_odds(self, assignment: Integers) -> float:
        """Log-odds of the best of the assignments (n,) that grow from one."""
        best = -math.inf
        while True:
            checkpoint()
            found = weigh_assignments(self.model, assignment[None], self.at)
            fit = self._fit(assignment, found)
            best = max(best, float(found.log_odds[0]) + fit.gained)
            more = self._extend_surest(assignment, fit, found.visible[0])
            if (more == assignment).all():
                return best
            assignment = more

    def _fit(self, assignment: Integers, found: Evidence) -> Reweighed:
        """The best pose of an assignment; ``found``: its evidence with independent errors."""
        used = assignment >= 0
        image = assignment[used]
        own = self.model.assigned_covariances(self.at, np.maximum(assignment, 0)[None])[0, used]
        own = np.einsum("iab,ij->iajb", own, np.eye(len(image)))
        point = np.flatnonzero(used) % (len(used) // max(len(self.model.images), 1))
        same = point[:, None, None, None] == point[:, None]  # sightings of one point share its error
        offset = (self.model.target[image] - self.at.pixels[0, used]).ravel()
        rows, shared = self.at.jacobian[0, used].reshape(-1, 6), self.shared[used][:, :, used]
        alone, size = own + shared * same, len(offset)
        known = rows, offset, alone.reshape(size, size), self.model.noise_freedom
        return reweigh_evidence(found, known, (own + shared).reshape(size, size), offset)

    def _extend_surest(self, assignment: Integers, fit: Reweighed, visible: Floats) -> Integers:
        """An assignment with the surer half of the further matches that it leads to."""
        used = assignment >= 0
        n = len(used)
        across = np.linalg.solve(fit.root, self.shared[used].reshape(-1, 2 * n))  # (2 m, 2 n)
        left = self.at.jacobian[0].reshape(-1, 6) - across.T @ fit.rows
        pixels = self.at.pixels[0] + (self.at.jacobian[0] @ fit.step) + (across.T @ fit.residuals).reshape(n, 2)
        spread = (left @ fit.covariance @ left.T - across.T @ across).reshape(n, 2, n, 2) + self.shared
        spread = np.ascontiguousarray(spread[np.arange(n), :, np.arange(n)])
        *gated, more = np.empty(self.model.shape, np.bool_), np.empty(self.model.shape), np.empty(n, np.int64)
        limits = GATE**2, self.model.rate or USUAL_RATE, HIDDEN
        points = pixels, np.zeros((n, 2, 6)), spread, np.where(used, 0.0, visible)
        gate(points, np.zeros((6, 6)), self.model.gating_image, limits, (*gated, more))
        gated[0][:, assignment[used]] = False
        assign_likeliest(*gated, more)
        (which,) = np.nonzero(more >= 0)
        surer = which[np.argsort(np.linalg.det(spread[which]), kind="stable")[: (len(which) + 1) // 2]]
        out = assignment.copy()
        out[surer] = more[surer]
        return out
