"""What makes a problem fit for proposals, chosen by the type of its tables.

Five functions serve a problem. One is of NumPy, called once for many minimal sets; as in `rootmatch.kernels.dispatch`,
the type of the tables chooses the others while a driver is compiled, so one driver serves all problems and is found
again in the on-disk cache.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rootmatch.kernels.dispatch import calls

_PROPOSERS: dict[type, dict[str, Callable[..., Any]]] = {}


def register_proposer(
    tables: type,
    coordinates: Callable[..., Any],
    solve: Callable[..., Any],
    known: Callable[..., Any],
    hypothesis: Callable[..., Any],
    predict: Callable[..., Any],
) -> None:
    """Make a problem fit for proposals.

    Parameters
    ----------
    tables : type
        Of the problem; it has ``rays`` (3, n') and ``variance`` (n',) of the detections.
    coordinates : ``(tables, sets, others)`` → (S, n − m, 6), (S, m, 3)
        Of sets (S, m) and the other points (S, n − m) of each, in the frame of the set: the others' coordinates, which
        end with their normals, and the normals of the set's own points. Not jitted.
    solve : ``(tables, i, j, scratch)``
        Solve the set ``i`` with the first m − 1 images ``j`` and every last one; ``scratch`` (8, n').
    known : ``(tables, raster, i, j)`` → tuple of numbers
        What `hypothesis` takes from the set before its last image is known.
    hypothesis : ``(tables, raster, known, last, scratch, root)`` → (bool, origin, three axes: 12 numbers)
        The frame of the set in the raster's basis at one root; a point with coordinates α, β, γ lies at
        origin + α e + β f + γ g. Without a branch, so that a loop over the last image vectorises; the rays of the
        raster have the room of the tables.
    predict : ``(tables, i, j, root, out)`` → bool
        Fill ``out`` (13, n) with the predicted bearing of every source point, two axes across it, the covariance along
        them (s11, s12, s22), and whether it can be seen (1 or 0).
    """
    _PROPOSERS[tables] = {
        "coordinates": coordinates, "solve": solve, "known": known, "hypothesis": hypothesis, "predict": predict,
    }  # fmt: skip


def can_propose(tables: type) -> bool:
    """Whether a type of tables is registered."""
    return tables in _PROPOSERS


def set_coordinates(tables: Any, sets: Any, others: Any) -> Any:
    """Coordinates of the other points and the normals of sets; see `register_proposer`."""
    return _PROPOSERS[type(tables)]["coordinates"](tables, sets, others)


def solve_set(tables: Any, i: Any, j: Any, scratch: Any) -> Any:
    """Solutions of a set for every last image; see `register_proposer`."""
    _PROPOSERS[type(tables)]["solve"](tables, i, j, scratch)


def set_known(tables: Any, raster: Any, i: Any, j: Any) -> Any:
    """What is known of a set before its last image; see `register_proposer`."""
    return _PROPOSERS[type(tables)]["known"](tables, raster, i, j)


def set_frame(tables: Any, raster: Any, known: Any, last: Any, scratch: Any, root: Any) -> Any:
    """Frame of a set at one root; see `register_proposer`."""
    return _PROPOSERS[type(tables)]["hypothesis"](tables, raster, known, last, scratch, root)


def predict_set(tables: Any, i: Any, j: Any, root: Any, out: Any) -> Any:
    """Prediction of every point at one root; see `register_proposer`."""
    return _PROPOSERS[type(tables)]["predict"](tables, i, j, root, out)


@calls(solve_set)
def _solve_choice(tables: Any, i: Any, j: Any, scratch: Any) -> Callable[..., Any]:
    return _PROPOSERS[tables.instance_class]["solve"]


@calls(set_known)
def _known_choice(tables: Any, raster: Any, i: Any, j: Any) -> Callable[..., Any]:
    return _PROPOSERS[tables.instance_class]["known"]


@calls(set_frame)
def _hypothesis_choice(tables: Any, raster: Any, known: Any, last: Any, scratch: Any, root: Any) -> Callable[..., Any]:
    return _PROPOSERS[tables.instance_class]["hypothesis"]


@calls(predict_set)
def _predict_choice(tables: Any, i: Any, j: Any, root: Any, out: Any) -> Callable[..., Any]:
    return _PROPOSERS[tables.instance_class]["predict"]
