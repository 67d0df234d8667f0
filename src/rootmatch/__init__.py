"""Which point is which, from geometry alone: minimal problems that share a root, matched as a hypergraph."""

from rootmatch._version import __version__
from rootmatch.affinity import Affinity, Residual
from rootmatch.camera import Camera
from rootmatch.errors import InputError, RootmatchError
from rootmatch.guided import Guided
from rootmatch.match import Match, Status, match, residuals
from rootmatch.matcher import Matcher
from rootmatch.problems.p3p import P3P
from rootmatch.problems.problem import Problem
from rootmatch.problems.three_plus_one import ThreePlusOne
from rootmatch.problems.up2p import UP2P
from rootmatch.tensor import AffinityTensor

__all__ = [
    "P3P",
    "UP2P",
    "Affinity",
    "AffinityTensor",
    "Camera",
    "Guided",
    "InputError",
    "Match",
    "Matcher",
    "Problem",
    "Residual",
    "RootmatchError",
    "Status",
    "ThreePlusOne",
    "__version__",
    "match",
    "residuals",
]
