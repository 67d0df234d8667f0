"""Functions that compiled code replaces by a kernel, selected by the types of their arguments.

A driver calls such a function; while it is compiled a choice, given the types, says what it is. One driver thus serves
every problem, and the on-disk cache of Numba finds it again: a driver that took the kernel as an argument, or closed
over it, would be compiled anew in each process.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import lower_builtin, overload

from rootmatch.jit.options import FORCED

OVERLOADS: list[tuple[Callable[..., Any], Callable[..., Any]]] = []
"""Functions that choose a kernel by type, each with its choice; a backend of another target makes them known there."""


def choose_by_types(function: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorate the choice of what ``function`` is in compiled code, on processors and on every other target."""

    def known(choice: Callable[..., Any]) -> Callable[..., Any]:
        OVERLOADS.append((function, choice))
        options: Any = dict(FORCED)
        result: Callable[..., Any] = overload(function, jit_options=options)(choice)
        return result

    return known


def call_by_types(function: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
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


def dispatch_to_kernel(kernels: Callable[[Any], Any], name: str) -> Callable[..., Any]:
    """A function that is, in compiled code, the kernel of that name among the ``kernels`` of its first argument."""

    def called(tables: Any, *arguments: Any) -> Any:
        return getattr(kernels(tables), name)(tables, *arguments)

    call_by_types(called)(lambda tables, *arguments: getattr(kernels(tables), name))
    return called


def tuple_class(value: Any) -> Any:
    """The class of a NamedTuple that is given as it is, as its class, or as its Numba type."""
    if isinstance(value, type):
        return value
    return getattr(value, "instance_class", None) or type(value)
