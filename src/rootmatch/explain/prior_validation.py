"""What is known of poses, of one body or of each, and its validation: a pose with a covariance, or a part of one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.arrays import Bools, Floats, cache_by_identity
from rootmatch.cameras.vertical import unit_direction
from rootmatch.errors import InputError
from rootmatch.explain.body_labels import BodyLabels
from rootmatch.explain.validation import check_problem
from rootmatch.frozen import copy_with
from rootmatch.problems.base import Problem
from rootmatch.problems.capabilities import Capability
from rootmatch.problems.p3p import P3P
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.pose_prior import PosePrior
from rootmatch.problems.up2p import UP2P

Prior = Pose | PosePrior
"""A predicted pose with its covariance, or what is known of one."""
DOUBT = 0.01
"""Share of a prior for the case that no predicted pose is right, at least."""


class Rivals(NamedTuple):
    """What else a body's pose may be than the one that is most probably predicted."""

    poses: tuple[tuple[Pose, float], ...] = ()
    """Other predicted poses with the share of each; that of the first one is the rest."""
    doubt: float = DOUBT
    """Probability that none of all of them is right."""
    places: tuple[int, ...] = ()
    """Numbers of the places in which all of them are followed, the first one's before the others."""
    lit: Floats | None = None
    """(n,) probability that each sighting of a point is lit by the frames before; all are where not given."""
    placed: Bools | None = None
    """(m,) whether each point has been seen in its place before; none has where not given."""
    narrowed: tuple[int, ...] | None = None
    """Numbers of the predictions that are narrowed by single matches if they are wide, which takes as long as a search;
    all where not given."""

    def with_knowledge(self, known: PosePrior) -> Rivals:
        """The same poses with partial knowledge."""
        return self._replace(poses=tuple((known.with_prediction(pose), share) for pose, share in self.poses))


NONE = Rivals()
"""Of a pose that is predicted alone."""


def check_predicted(prior: Any, labels: BodyLabels | None, problem: Problem) -> tuple[Problem, Any]:
    """Refuse anything but one prior or, with several bodies, priors of some of them by label.

    Returns problem and prior as `give_each_its_vertical` does.
    """
    Capability.PRIOR.require(problem.takes_prior or problem.takes_motion_prior, problem.name)
    if labels is None and isinstance(prior, Mapping):
        told = ", ".join(map(repr, prior))
        raise InputError(f"prior: a dict for {told} given without bodies=; give the pose itself, or bodies=")
    if labels is None:
        check_prior(prior, problem)
        return give_each_its_vertical(prior, labels, problem)
    if not isinstance(prior, Mapping):
        raise InputError("prior: one pose given with bodies=; give a dict from the labels of bodies to their poses")
    for label, pose in prior.items():
        if label not in labels.names:
            raise InputError(
                f"prior: no body is labelled {label!r}; the labels are {', '.join(map(str, labels.names))}"
            )
        check_prior(pose, problem, f"prior of {label!r}")
    return give_each_its_vertical(prior, labels, problem)


def check_prior(prior: object, problem: Problem, name: str = "prior") -> None:
    """Refuse anything but a pose with a covariance, or what is known of one, of a plane for two point sets of one."""
    flat = problem.source_dimension == 2
    if flat and not problem.takes_motion_prior:
        raise InputError(f"{name}: points of a plane given; only a motion of points in space can be predicted")
    where, size, rows = ("a plane", 2, problem.predicted_rows - 3) if flat else ("space", 3, problem.predicted_rows)
    if isinstance(prior, PosePrior):
        parts = [one for one in (prior.rotation, prior.position, prior.vertical) if one is not None]
        if len(np.asarray(parts[0][0])) != size:
            raise InputError(f"{name}: points of {where} given; give R ({size}, {size}) and t ({size},)")
        return
    if not isinstance(prior, Pose):
        raise InputError(
            f"{name}: {type(prior).__name__} given; give rootmatch.Pose(R, t, covariance) or rootmatch.PosePrior"
        )
    sizes = sorted({3 if flat else 6, rows})
    if len(prior.R) != size or prior.covariance is None or len(prior.covariance) not in sizes:
        shapes = " or ".join(f"({size}, {size})" for size in sizes)
        raise InputError(f"{name}: a pose in {where} with a covariance {shapes} is needed; give Pose(R, t, covariance)")
    if len(sizes) == 1 and prior.scale != 1.0:
        raise InputError(f"{name}: a scale of {prior.scale:g} given, but {problem.name} has none; leave it out")


def check_followed(problem: Problem, source: ArrayLike) -> None:
    """Refuse what a tracker does not follow: no pose of a body, or a reflected one."""
    check_problem(problem)
    problem = problem.for_points(source)
    if problem.takes_prior or (problem.takes_motion_prior and not getattr(problem, "mirror", False)):
        return
    raise InputError(
        f"problem: {problem!r} given; a tracker follows rotations and translations: give P3P, UP2P, or Rigid() or "
        "Similarity() without mirror"
    )


@cache_by_identity(16)
def problem_vertical(problem: Problem) -> PosePrior | None:
    """The vertical that a problem has by itself."""
    if not isinstance(problem, UP2P):
        return None
    directions = unit_direction(problem.vertical_world, "up2p"), unit_direction(problem.vertical_camera, "up2p")
    return PosePrior.unchecked(vertical=(*directions, float(problem.vertical_noise)))


def give_each_its_vertical(prior: Any, labels: BodyLabels | None, problem: Problem) -> tuple[Problem, Any]:
    """The problem and the prior of each body, as they were checked, where a body has a vertical of its own.

    The problem is then `P3P`, and every body has one known vertical: its own, or that of `UP2P`.
    """
    given: dict[Any, Prior] = dict(prior) if isinstance(prior, Mapping) else {None: prior}
    upright = problem_vertical(problem)
    if upright is None or not any(isinstance(one, PosePrior) and one.vertical for one in given.values()):
        return problem, prior
    for label in (None,) if labels is None else labels.names:
        one = given.get(label, upright)
        if isinstance(one, Pose):
            given[label] = upright.with_prediction(one)
        elif one.vertical is None:
            given[label] = copy_with(one, vertical=upright.vertical)
        else:
            given[label] = one
    return P3P(problem.camera), given[None] if labels is None else given  # type: ignore[attr-defined]


def prior_attributes(prior: object) -> dict[str, Any]:
    """The attributes of a task that hold a prior, or those of several bodies by label."""
    if isinstance(prior, Pose):
        return {"prior_pose": prior, "known": None, "priors": {}}
    known = prior if isinstance(prior, PosePrior) else None
    return {"prior_pose": None, "known": known, "priors": dict(prior) if isinstance(prior, Mapping) else {}}
