"""Which point is which, from geometry alone: minimal problems that share a root, matched as a hypergraph."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rootmatch._version import __version__
from rootmatch.errors import InputError, InputWarning, RootmatchError
from rootmatch.problems import MODULES

if TYPE_CHECKING:
    from rootmatch.api import match, residuals
    from rootmatch.cameras.pinhole import Camera
    from rootmatch.cameras.rig import Rig
    from rootmatch.derivation.derive import derive
    from rootmatch.hypergraph.affinity import Affinity, Residual
    from rootmatch.hypergraph.invariants import invariant_affinities, nearest_hyperedges
    from rootmatch.hypergraph.tensor import AffinityTensor
    from rootmatch.io.calibrations.reading import read_cameras
    from rootmatch.matcher import Matcher
    from rootmatch.precompile.ahead_of_time import warmup
    from rootmatch.problems.base import Problem
    from rootmatch.problems.derived.measurements import Bearings, Points, Uncalibrated
    from rootmatch.problems.p3p import P3P as P3P
    from rootmatch.problems.planar_motion import PlanarMotion as PlanarMotion
    from rootmatch.problems.pose_fit.pose import Pose
    from rootmatch.problems.pose_fit.pose_prior import PosePrior
    from rootmatch.problems.similarity import Rigid as Rigid
    from rootmatch.problems.similarity import Similarity as Similarity
    from rootmatch.problems.three_plus_one import ThreePlusOne as ThreePlusOne
    from rootmatch.problems.up2p import UP2P as UP2P
    from rootmatch.problems.up2pf import UP2PF as UP2PF
    from rootmatch.result import Match, Status
    from rootmatch.samplers.guided.sampler import Guided
    from rootmatch.tracking.motion_filter import MotionOptions
    from rootmatch.tracking.tracker import Tracker, TrackingOptions, TrackingState

_LATER = {
    **MODULES,
    "Affinity": "hypergraph.affinity",
    "AffinityTensor": "hypergraph.tensor",
    "Bearings": "problems.derived.measurements",
    "Camera": "cameras.pinhole",
    "Guided": "samplers.guided.sampler",
    "Match": "result",
    "Matcher": "matcher",
    "MotionOptions": "tracking.motion_filter",
    "Points": "problems.derived.measurements",
    "Pose": "problems.pose_fit.pose",
    "PosePrior": "problems.pose_fit.pose_prior",
    "Problem": "problems.base",
    "Residual": "hypergraph.affinity",
    "Rig": "cameras.rig",
    "Status": "result",
    "Tracker": "tracking.tracker",
    "TrackingOptions": "tracking.tracker",
    "TrackingState": "tracking.tracker",
    "Uncalibrated": "problems.derived.measurements",
    "derive": "derivation.derive",
    "read_cameras": "io.calibrations.reading",
    "invariant_affinities": "hypergraph.invariants",
    "match": "api",
    "nearest_hyperedges": "hypergraph.invariants",
    "residuals": "api",
    "warmup": "precompile.ahead_of_time",
}
"""Module of each public name, imported when first asked for: a command that fails early needs none of them, and no
Numba."""


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
    "InputWarning",
    "Match",
    "Matcher",
    "MotionOptions",
    "Points",
    "Pose",
    "PosePrior",
    "Problem",
    "Residual",
    "Rig",
    "RootmatchError",
    "Status",
    "Tracker",
    "TrackingOptions",
    "TrackingState",
    "Uncalibrated",
    "__version__",
    "derive",
    "invariant_affinities",
    "match",
    "nearest_hyperedges",
    "read_cameras",
    "residuals",
    "warmup",
]
