"""Which kernel serves which problem and residual, decided by types while compiling.

A driver calls `edge_residual` and `slab_residual`; the type of the problem's tables and the type of the kind (both
NamedTuples) choose the kernel. One driver thus serves every problem, and the on-disk cache of Numba finds it again:
a driver that took the kernel as an argument, or closed over it, would be compiled anew in each process.

Tables of single precision get the kernel's twin (`rootmatch.jit.float32`), in `edge_residual`, `fill_panel` and
`slab_residual`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import lower_builtin, overload

OVERLOADS: list[tuple[Callable[..., Any], Callable[..., Any]]] = []
"""Functions that choose a kernel by type, each with its choice; a backend of another target makes them known there."""


def chooses(function: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorate the choice of what ``function`` is in compiled code, on processors and on every other target."""

    def known(choice: Callable[..., Any]) -> Callable[..., Any]:
        OVERLOADS.append((function, choice))
        result: Callable[..., Any] = overload(function, jit_options={"forceinline": True})(choice)
        return result

    return known


def calls(function: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorate the choice, by types, of the kernel that ``function`` is in compiled code on processors.

    Unlike an overload there is no function between the two, which would be optimised for itself once more.
    """

    def known(choice: Callable[..., Any]) -> Callable[..., Any]:
        class Chosen(AbstractTemplate):
            key = function

            def generic(self, arguments: Any, keywords: Any) -> Any:
                return types.Dispatcher(choice(*arguments)).get_call_type(self.context, arguments, keywords)

        infer_global(function, types.Function(Chosen))  # type: ignore[no-untyped-call]

        @lower_builtin(function, types.VarArg(types.Any))  # type: ignore[no-untyped-call]
        def called(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            kernel = types.Dispatcher(choice(*signature.args))
            return context.get_function(kernel, signature)(builder, arguments)

        return choice

    return known
