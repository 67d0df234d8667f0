"""Which point is which, from geometry alone: minimal problems that share a root, matched as a hypergraph."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

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

if TYPE_CHECKING:
    from rootmatch.problems.derived.measurements import Bearings, Points, Uncalibrated
    from rootmatch.problems.invariants import invariant_affinities, nearest_hyperedges
    from rootmatch.problems.planar_motion import PlanarMotion
    from rootmatch.problems.similarity import Rigid, Similarity
    from rootmatch.problems.symbolic import derive
    from rootmatch.problems.up2pf import UP2PF

_LATER = {
    "Bearings": "derived.measurements",
    "Points": "derived.measurements",
    "Uncalibrated": "derived.measurements",
    "invariant_affinities": "invariants",
    "nearest_hyperedges": "invariants",
    "PlanarMotion": "planar_motion",
    "Rigid": "similarity",
    "Similarity": "similarity",
    "derive": "symbolic",
    "UP2PF": "up2pf",
}
"""Modules of `rootmatch.problems` that are imported when first asked for: most users need none of them."""


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module 'rootmatch' has no attribute {name!r}")
    value = getattr(import_module(f"rootmatch.problems.{_LATER[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


__all__ = [
    "P3P",
    "UP2P",
    "UP2PF",
    "Affinity",
    "AffinityTensor",
    "Bearings",
    "Camera",
    "Guided",
    "InputError",
    "Match",
    "Matcher",
    "PlanarMotion",
    "Points",
    "Problem",
    "Residual",
    "Rigid",
    "RootmatchError",
    "Similarity",
    "Status",
    "ThreePlusOne",
    "Uncalibrated",
    "__version__",
    "derive",
    "invariant_affinities",
    "match",
    "nearest_hyperedges",
    "residuals",
]
