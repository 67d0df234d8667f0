"""Validation of priors: a pose in space with a covariance, or one for each body."""

from __future__ import annotations

from collections.abc import Mapping

from rootmatch.errors import InputError
from rootmatch.explain.body_labels import BodyLabels
from rootmatch.problems.pose_fit.pose import Pose


def check_predicted(prior: object, labels: BodyLabels | None) -> None:
    """Refuse anything but one pose with a covariance or, with several bodies, poses of some of them by label."""
    if labels is None:
        check_prior(prior)
        return
    if not isinstance(prior, Mapping):
        raise InputError("prior: one pose given with bodies=; give a dict from the label of a body to its pose")
    for label, pose in prior.items():
        if label not in labels.names:
            raise InputError(
                f"prior: no body is labelled {label!r}; the labels are {', '.join(map(str, labels.names))}"
            )
        check_prior(pose, f"prior of {label!r}")


def check_prior(prior: object, name: str = "prior") -> None:
    """Refuse anything but a pose in space with a covariance."""
    if not isinstance(prior, Pose):
        raise InputError(f"{name}: {type(prior).__name__} given; give rootmatch.Pose(R, t, covariance)")
    if prior.R.shape != (3, 3) or prior.covariance is None or prior.covariance.shape != (6, 6):
        raise InputError(f"{name}: a pose in space with a covariance (6, 6) is needed; give Pose(R, t, covariance)")
