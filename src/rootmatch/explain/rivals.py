"""Predicted poses beside the most probable one."""

from __future__ import annotations

from typing import NamedTuple

from rootmatch.arrays import Bools, Floats
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.pose_prior import PosePrior

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

    def given(self, known: PosePrior) -> Rivals:
        """The same poses with partial knowledge."""
        return self._replace(poses=tuple((known.with_prediction(pose), share) for pose, share in self.poses))


NONE = Rivals()
"""Of a pose that is predicted alone."""
