"""Which point is which, from geometry alone: minimal problems that share a root, matched as a hypergraph."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rootmatch._version import __version__
from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import InputError, RootmatchError
from rootmatch.hypergraph.affinity import Affinity, Residual
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.match import match, residuals
from rootmatch.matcher import Matcher
from rootmatch.problems import MODULES
from rootmatch.problems.base import Problem
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.result import Match, Status
from rootmatch.samplers.guided.sampler import Guided

if TYPE_CHECKING:
    from rootmatch.derivation.derive import derive
    from rootmatch.hypergraph.invariants import invariant_affinities, nearest_hyperedges
    from rootmatch.io.calibrations.reading import read_cameras
    from rootmatch.problems.derived.measurements import Bearings, Points, Uncalibrated
    from rootmatch.problems.p3p import P3P as P3P
    from rootmatch.problems.planar_motion import PlanarMotion as PlanarMotion
    from rootmatch.problems.similarity import Rigid as Rigid
    from rootmatch.problems.similarity import Similarity as Similarity
    from rootmatch.problems.three_plus_one import ThreePlusOne as ThreePlusOne
    from rootmatch.problems.up2p import UP2P as UP2P
    from rootmatch.problems.up2pf import UP2PF as UP2PF

_LATER = {
    **MODULES,
    "Bearings": "problems.derived.measurements",
    "Points": "problems.derived.measurements",
    "Uncalibrated": "problems.derived.measurements",
    "invariant_affinities": "hypergraph.invariants",
    "nearest_hyperedges": "hypergraph.invariants",
    "derive": "derivation.derive",
    "read_cameras": "io.calibrations.reading",
}
"""Modules that are imported when first asked for: most users need none of them."""


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module 'rootmatch' has no attribute {name!r}")
    value = getattr(import_module(f"rootmatch.{_LATER[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


__all__ = [
    *MODULES,
    "Affinity",
    "AffinityTensor",
    "Bearings",
    "Camera",
    "Guided",
    "InputError",
    "Match",
    "Matcher",
    "Points",
    "Pose",
    "Problem",
    "Residual",
    "RootmatchError",
    "Status",
    "Uncalibrated",
    "__version__",
    "derive",
    "invariant_affinities",
    "match",
    "nearest_hyperedges",
    "read_cameras",
    "residuals",
]
