"""A body where another one of its family was expected: put in its place, or told the wrong way round before.

What is predicted of a body says where that body was. A body that shares most of its points with it may be there
instead, and then it is so in the pose in which they look the same: to within the prediction, not anywhere in the room.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rootmatch.arrays import Bools, Floats
from rootmatch.frozen import amend, copy_with, once
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.pose_density import (
    Doubted,
    Gaussian,
    Mixed,
    Mixture,
    PoseDensity,
    largest_component,
    pack_predictions,
)
from rootmatch.model.posterior import Posterior
from rootmatch.problems.pose_fit.reference_point import pose_about_point

EXCHANGED = 1e-3
"""Prior probability that a body is in the place of another one of its family. A stated value, not measured."""


@dataclass(frozen=True, eq=False)
class Places:
    """How a body lies where another one lies if their common points coincide.

    Attributes
    ----------
    rotation : (3, 3) array
        Takes directions of the body to those of the other one.
    point : (3,) array
        Its centre, about the other one's centre and in the frame of that.
    variance : (6,) array
        Of the pose, as the points do not quite coincide: rad², and the unit of length squared.
    """

    rotation: Floats
    point: Floats
    variance: Floats

    def of(self, other: Gaussian) -> Gaussian:
        """Where the body is in the place in which the other one is predicted."""
        position, covariance = pose_about_point(other.rotation, other.position, other.covariance, self.point)
        return Gaussian(other.rotation @ self.rotation, position, covariance + np.diag(self.variance), other.freedom)


@dataclass(frozen=True, eq=False)
class Exchanged(Mixed):
    """What is known of a body, and with small shares the places in which others of its family are predicted.

    Parameters
    ----------
    known : PoseDensity
        What is known of the body itself.
    others : sequence of (Gaussian, float)
        Its pose in those places, with the logarithms of their shares.
    """

    known: Mixed
    others: Sequence[tuple[Gaussian, float]]

    @property
    def minimum(self) -> int:
        """See `PoseDensity.minimum`."""
        return self.known.minimum

    @once
    def for_kernels(self) -> Mixture:
        """See `PoseDensity.for_kernels`."""
        left = math.log1p(-sum(math.exp(share) for _, share in self.others))
        (*parts, peaks, freedom), (*numbers, log_share, radius), (*pieces, known) = self.known.for_kernels
        own = *parts, peaks + left, freedom  # others follow what is known of the body itself
        predictions = tuple(map(np.concatenate, zip(own, pack_predictions(self.others, radius), strict=True)))
        return predictions, (*numbers, log_share + left, radius), (*pieces, known + left)  # type: ignore[return-value]

    def is_in_other_place(self, rotation: Floats, position: Floats) -> Bools:
        """Whether each of some poses (K,) is most probably in the place of another body."""
        every, which = self._components(rotation, position)
        own = len(self.known.for_kernels[0][0])
        return np.asarray((largest_component(every) == 0) & (which >= own) & (which < own + len(self.others)))


def own_prior(prior: PoseDensity) -> PoseDensity:
    """What a prior knows of the body itself, but for the places of others."""
    return prior.known if type(prior) is Exchanged else prior


def add_family_places(model: DetectionModel, others: Sequence[tuple[Places, PoseDensity]]) -> DetectionModel:
    """The model of a body that may be where others of its family are expected; as given if none is.

    ``others``: how the body lies where each of them does, and what is known of that one's pose.
    """
    predicted = [
        (places.of(one), math.log(EXCHANGED) + share)
        for places, prior in others
        if isinstance(prior, Doubted)
        for one, share in zip(prior.predictions, prior.log_shares, strict=True)
        if isinstance(one, Gaussian)
    ]
    if not predicted or not isinstance(model.prior, Mixed):
        return model
    return amend(model, prior=Exchanged(model.prior, predicted))


def mark_exchanged(model: DetectionModel, told: Posterior) -> Posterior:
    """A posterior by `add_family_places` that tells which modes are where another body was expected."""
    if type(model.prior) is not Exchanged:
        return told
    return copy_with(told, exchanged=model.prior.is_in_other_place(told.modes.rotation, told.modes.position))
