"""Functions that jitted code calls and Python hardly ever does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import config, njit
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher

from rootmatch.jit.options import WITHOUT_ENTRIES


class LinkedLibrary(JITCodeLibrary):
    """Code that others link, each a copy of its own, and that is not made machine code by itself."""

    @property
    def codegen(self) -> Any:
        """The object that Numba hands a function's environment: this library, which knows whether it needs one."""
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Generate machine code after all if the function reads Python constants from its environment."""
        if environment.consts:
            super()._finalize_final_module()  # type: ignore[no-untyped-call]
            emitting: Any = self._codegen
            emitting.set_env(name, environment)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._verify_declare_only_symbols()  # type: ignore[no-untyped-call]
        self._finalized = True


class LinkedCompiler(Compiler):
    """A compiler whose functions are made for others to link."""

    def compile_extra(self, func: Any) -> Any:
        """Compile a Python function into a library for others to link."""
        codegen = self.state.targetctx.codegen()
        self.state.library = LinkedLibrary(codegen, func.__qualname__)  # type: ignore[no-untyped-call]
        self.state.library.enable_object_caching()
        return super().compile_extra(func)  # type: ignore[no-untyped-call]


class InternalDispatcher(CPUDispatcher):
    """A jitted function without the entries by which Python and C would call it.

    They take half of the time to compile a small function, and each of them would hold a copy of all that is
    inlined. Called from Python all the same, it is compiled for that apart.
    """

    asked: dict[str, Any]
    outer: Callable[..., Any] | None = None

    def __init__(self, py_func: Any, **options: Any) -> None:
        super().__init__(py_func, pipeline_class=LinkedCompiler, **options)

    def __call__(self, *arguments: Any) -> Any:
        """Call the function from Python, with the result that jitted code gets."""
        if self.outer is None:
            self.outer = njit(**self.asked)(self.py_func)
        return self.outer(*arguments)


def internal_function(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator as `numba.njit` with these options, for what jitted code calls; nothing is kept on disk of it alone."""

    def decorated(function: Callable[..., Any]) -> Any:
        if config.DISABLE_JIT:  # type: ignore[attr-defined]
            return function
        made = InternalDispatcher(
            function, targetoptions={"nopython": True, "boundscheck": None, **options, **WITHOUT_ENTRIES}
        )
        made.asked = options
        return made

    return decorated
