"""Single-precision twins of kernels, made from the very same code.

A kernel computes in double where it is given single-precision tables: Numba takes every literal and every module
constant for a double, and what a double meets becomes one. A twin has the kernel's own bytecode with its floating-point
constants rounded to single, and calls the twins of the kernels it calls; nothing is written twice. The tables' type
then decides: `rootmatch.jit.dispatch` gives the twin to tables of single precision.

What follows for a kernel that is to have one: infinity and NaN come from constants of the module (``from math import
inf, nan``), not from ``np.inf``, which is a double; and an integer never meets a float.
"""

from __future__ import annotations

from collections.abc import Callable
from types import CellType, CodeType, FunctionType
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from rootmatch.jit.internal import internal_function

EPSILON = float(np.finfo(np.float32).eps)
MINIMUM, MAXIMUM = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).max)
"""Range of normal single-precision numbers: a constant beyond stands for "next to nothing" or "more than all", and is
clamped to it, so that it neither divides by zero nor is infinite."""
ROUNDING = 16.0
"""Blur of a bearing in units of EPSILON radians; see `rounded`."""

_twins: dict[Any, Any] = {}


def round_constant(value: Any) -> Any:
    """The twin's version of a kernel's constant: floats are rounded, anything else is unchanged."""
    if isinstance(value, float):
        if np.isfinite(value) and value != 0.0:
            value = np.copysign(min(max(abs(value), MINIMUM), MAXIMUM), value)
        return np.float32(value)
    if isinstance(value, tuple):
        return tuple(map(round_constant, value))
    return value


def single_precision_twin(kernel: Any) -> Any:
    """The kernel in single precision: jitted with the kernel's options, or plain where compilation is switched off."""
    if kernel not in _twins:
        remade: Any = _remake_function(getattr(kernel, "py_func", kernel))
        _twins[kernel] = internal_function(**kernel.asked)(remade) if hasattr(kernel, "asked") else remade
    return _twins[kernel]


def _remake_function(function: FunctionType) -> FunctionType:
    """A function with its constants rounded, and twins in the place of the kernels that it refers to."""
    code = function.__code__
    if any(isinstance(part, CodeType) for part in code.co_consts):
        raise TypeError(f"{function.__qualname__}: a kernel with a function inside has no twin")
    names = {
        name: _twin_of_reference(function.__globals__[name]) for name in code.co_names if name in function.__globals__
    }
    cells = tuple(CellType(_twin_of_reference(cell.cell_contents)) for cell in function.__closure__ or ())
    remade = FunctionType(
        code.replace(co_consts=tuple(map(round_constant, code.co_consts))),
        {**names, "__builtins__": function.__globals__["__builtins__"], "__name__": function.__module__},
        function.__name__,
        function.__defaults__,
        cells,
    )
    remade.__qualname__, remade.__module__ = function.__qualname__, function.__module__
    return remade


def _twin_of_reference(value: Any) -> Any:
    """The twin's counterpart of a function or a constant that its kernel refers to."""
    return (
        single_precision_twin(value)
        if hasattr(value, "py_func") or isinstance(value, FunctionType)
        else round_constant(value)
    )


def is_single(tables: Any) -> bool:
    """Whether tables, or their Numba type, hold single-precision numbers."""
    return any(getattr(field, "dtype", None) in (types.float32, np.dtype(np.float32)) for field in tables)


def kernel_for_tables(tables: Any, kernel: Callable[..., Any]) -> Callable[..., Any]:
    """The kernel, or its twin, as the tables ask."""
    return single_precision_twin(kernel) if is_single(tables) else kernel


def round_tables(tables: Any) -> Any:
    """Tables in single precision.

    Rounding blurs a bearing as noise does. So ``variance`` grows by that of `ROUNDING` · EPSILON radians: residuals
    that rounding makes uncertain become small, not random, and a sweep that keeps what is small loses next to none.

    No residual depends on the unit of length. That of ``points`` is chosen such that the errors of the equations are
    about 1, where no product of them leaves the range.
    """
    variance = tables.variance + (ROUNDING * EPSILON) ** 2
    changed = {"variance": variance}
    noise = max(float(np.median(variance)), *(float(v) for v in getattr(tables, "tilt_variance", ())), 0.0)
    # a power of two: no digit changes
    unit = 2.0 ** -round(0.5 * np.log2(noise))
    for field, power in (("points", 1), ("distance2", 2)):
        if field in tables._fields:
            changed[field] = getattr(tables, field) * unit**power
    return type(tables)(*(_round_array(field) for field in tables._replace(**changed)))


def _round_array(field: NDArray[Any]) -> NDArray[Any]:
    return field.astype(np.float32) if field.dtype == np.float64 else field
