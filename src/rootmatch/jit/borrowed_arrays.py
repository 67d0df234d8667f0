"""Borrowed arrays: inner loops that count no references.

Numba counts the references to an array whenever a name is given to it or to a part of it, by an atomic instruction that
takes longer than many a kernel's arithmetic. It leaves out what it can prove to cancel, which in a large function is
little, and several threads wait for one another's counts. The caller of a driver holds its arrays until it returns, so
the driver need not count at all: it borrows them. `docs/architecture.md` says what that is worth.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import lower_builtin, type_callable


def borrow(value: Any) -> Any:
    """An array or a (named) tuple of them as it is; in compiled code one whose references are not counted.

    To be called at the beginning of a driver, on its arguments alone: an array that the function itself makes would be
    freed while it is used.
    """
    return value


def _drop_owner(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """LLVM's value without the pointers to what counts references."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value=value)
        array.meminfo = array.meminfo.type(None)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        parts: list[Any] = list(kind)  # type: ignore[call-overload]
        for position, part in enumerate(parts):
            stripped = _drop_owner(context, builder, part, builder.extract_value(value, position))
            value = builder.insert_value(value, stripped, position)
    return value


# Typing and lowering of its own, not an overload, which would be a function to compile for each combination of types, a
# tenth of a second each; least of all with inline="always": where Numba copied the body into its caller it mixed up
# variables of the ascent that are set on several ways through a loop, and the results were wrong.
@type_callable(borrow)
def _typed(context: Any) -> Callable[[Any], Any]:
    def type_of(value: Any) -> Any:
        return value

    return type_of


@lower_builtin(borrow, types.Any)  # type: ignore[no-untyped-call]
def _lowered(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    return _drop_owner(context, builder, signature.args[0], arguments[0])
