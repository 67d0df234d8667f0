"""Kernels of a derived problem, compiled from their composed text and known by its tag."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from typing import Any

from rootmatch.algebra import any_degree, bezout
from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.derived.residuals_text import Residuals
from rootmatch.problems.derived.tables import REGISTERED
from rootmatch.problems.kernels import ProblemKernels, ResidualKernels
from rootmatch.problems.limits import UNINFORMATIVE
from rootmatch.problems.pairs import pair_orders
from rootmatch.problems.residual_kinds import QR, SVD, Joint, Normalised, QRBoth

ROOT_GATE = 4.0
"""A complex pair counts, by its real part, while the polynomial there is below so many of its deviations. Not tuned."""
BLUR = 0.3
"""Near a double root the deviation of the root grows without bound, yet the two roots enclose what may be: the square
of the slope is raised by BLUR · |curvature| · deviation of the value. ½ would be full strength; 0.3 is not tuned."""
VAGUE_RATIO = 1e4
"""Ratio of a prediction's variance to the last target point's own beyond which it says nothing. Not tuned."""
NAMED_KINDS = {"qr": QR, "both": QRBoth, "svd": SVD, "normalised": Normalised, "joint": Joint}


@scalar
def scaling_power(size):  # type: ignore[no-untyped-def]
    """The power of two that brings a size to between ½ and 1: exact, and products of many factors stay numbers."""
    return math.ldexp(1.0, -math.frexp(size)[1])


def compile_residuals(residuals: Residuals, formulas: dict[str, Callable[..., Any]]) -> dict[type, ResidualKernels]:
    """Kernels of each kind, from the formulas of a generated module, which are plain Python functions."""
    text = residuals.text
    degree = residuals.shape.degree
    namespace: dict[str, Any] = {
        "kernel": kernel,
        "scalar": scalar,
        **{name: scalar(function) for name, function in formulas.items() if not name.startswith("leaf_")},
        "find_roots": any_degree.make_root_kernel(degree),
        "compare_qr": bezout.make_last_entry_kernel(degree),
        "compare_both": bezout.make_lesser_entry_kernel(degree),
        "ordinary": scaling_power,
        "compare_svd": any_degree.make_singular_value_kernel(degree),
        "ORDERS": pair_orders(residuals.m),
        "BIG": UNINFORMATIVE * UNINFORMATIVE,
        "ONE": Normalised(1),
        "BLUR": BLUR,
        "GATE2": ROOT_GATE * ROOT_GATE,
        "VAGUE": VAGUE_RATIO,
        "math": math,
        # compiled code on disk names its module, which the next process must be able to import
        "__name__": __name__,
    }
    exec(compile(text, "<composed residuals>", "exec"), namespace)
    return {kind: ResidualKernels(namespace[f"edge_{n}"], namespace[f"slab_{n}"]) for n, kind in NAMED_KINDS.items()}


def tag_name(residuals: Residuals, generated: str, version: str) -> str:
    """A name for the kernels: a digest of all text that they are made of."""
    constants = f"{version} {UNINFORMATIVE} {ROOT_GATE} {BLUR} {VAGUE_RATIO}"
    digest = hashlib.sha256("\0".join([constants, generated, residuals.text]).encode())
    return f"k{digest.hexdigest()[:24]}"


def register_residuals(residuals: Residuals, formulas: dict[str, Callable[..., Any]], name: str) -> None:
    """Register the kernels under a tag, once in a process."""
    if name not in REGISTERED:
        REGISTERED[name] = ProblemKernels(compile_residuals(residuals, formulas))
