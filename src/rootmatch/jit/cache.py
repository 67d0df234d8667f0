"""Compiled code on disk: drivers find what is prebuilt, or what an earlier process has compiled, and compile the rest.

Unlike Numba's own cache, a file holds one overload and its name says all that it depends on: types, processor, versions
and the digest of all sources that compiled code is made of (`rootmatch.jit.sources`), not of the driver's file alone. A
file that cannot be read counts as missing. Nothing is imported or set up that only a compiler needs: that would take
longer than to load all kernels of a match.
"""

from __future__ import annotations

import gc
import hashlib
import logging
import pickle
import sys
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import Any

import numba
from numba import config
from numba.core.caching import CompileResultCacheImpl
from numba.core.compiler import CompileResult
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps
from numba.core.sigutils import normalize_signature

from rootmatch.jit import prebuilt
from rootmatch.jit.locks import FileLock
from rootmatch.jit.options import FOR_PYTHON_ALONE
from rootmatch.jit.signals import defer_signals

LOG = logging.getLogger("rootmatch")


@contextmanager
def keep_interrupts() -> Iterator[None]:
    """Raise an interrupt that was lost while C called Python: at the end of the block, or in the place of its error.

    LLVM hands what it has compiled to a function of Numba. An exception in that is printed and forgotten, and what
    misses the code ends with an error of its own.
    """
    lost: list[BaseException] = []
    before = sys.unraisablehook

    def noted(unraisable: Any) -> None:
        if isinstance(unraisable.exc_value, Exception):
            before(unraisable)
        else:
            lost.append(unraisable.exc_value)

    sys.unraisablehook = noted
    try:
        yield
    except Exception:
        if lost:
            raise lost[0] from None
        raise
    finally:
        sys.unraisablehook = before
    if lost:
        raise lost[0]


HASH_SECRET = b"_numba_hashsecret"
"""Name that is found in code that hashes: such code needs what Numba sets up for compiling."""

SUFFIX = ".kernel"


class Settings:
    """Where compiled code is looked for and kept, for a process that compiles ahead of need."""

    into: Path | None = None
    """The only folder, where kernels are prebuilt for a generic processor. If None, the prebuilt ones are read, then
    those in the user's own folder."""
    native: bool = False
    """Whether to do without what is prebuilt, and compile for this very processor."""


def _describe_type(kind: Any) -> str:
    """A description of a Numba type: the same in every process, and different for every type."""
    made_of = getattr(kind, "instance_class", None)
    if made_of is None:
        return str(kind)
    parts = ", ".join(_describe_type(part) for part in kind)
    return f"{made_of.__module__}.{made_of.__qualname__}[{kind}]({parts}){_outside_digest(made_of)}"


def _outside_digest(made_of: type) -> str:
    """Digest of the file of a class from outside this package, whose kernels `sources` does not know; else empty."""
    if made_of.__module__.partition(".")[0] == "rootmatch":
        return ""
    file = getattr(sys.modules.get(made_of.__module__), "__file__", None)
    try:
        return hashlib.sha256(Path(file).read_bytes()).hexdigest() if file else ""
    except OSError:
        return ""


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _announce(driver: str) -> None:
    """Say once per process, in the log and in a terminal, why this match takes longer than the next one."""
    if Settings.into is not None or Settings.native or _announce_once:
        return
    _announce_once.append(driver)
    line = (
        "compiling kernels for this machine, once, in up to a minute "
        f"({prebuilt.reason_for_misfit() or 'a rare one is not prebuilt'}); `rootmatch warmup` does it in advance"
    )
    LOG.info(line)
    if sys.stderr is not None and sys.stderr.isatty():
        print(f"rootmatch: {line}", file=sys.stderr)


_announce_once: list[str] = []


class KernelCache:
    """The compiled overloads of one driver on disk; the interface is that of Numba's caches."""

    def __init__(self, function: Any) -> None:
        self.function = function
        self.locks: list[FileLock] = []

    @cached_property
    def _numba(self) -> Any:
        """Numba's own cache, which knows the folder of compiled code; None if none can be written."""
        try:
            made: Any = CompileResultCacheImpl(self.function)  # type: ignore[no-untyped-call]
        except RuntimeError:  # no folder can be written
            return None
        return made

    @property
    def cache_path(self) -> str | None:
        """The folder of the code that is compiled for this machine."""
        if Settings.into is not None:
            return str(Settings.into)
        return str(self._numba.locator.get_cache_path()) if self._numba is not None else None

    def flush(self) -> None:
        """Delete the driver's files on disk."""
        if self.cache_path is not None:
            for path in Path(self.cache_path).glob(f"{self._stem}.*{SUFFIX}"):
                path.unlink(missing_ok=True)

    def enable(self) -> None:
        """Do nothing: this cache is always enabled. Part of the interface of Numba's caches."""

    def disable(self) -> None:
        """Do nothing: this cache is never disabled. Part of the interface of Numba's caches."""

    @cached_property
    def _stem(self) -> str:
        """The common beginning of the names of the driver's files."""
        return f"{self.function.__module__}.{self.function.__qualname__}".replace("<locals>", "locals")

    @cached_property
    def _code(self) -> str:
        """A digest of the driver itself and of what it closes over."""
        code = self.function.__code__
        cells = tuple(cell.cell_contents for cell in self.function.__closure__ or ())
        file = Path(code.co_filename)
        text = file.read_bytes() if file.is_file() else b""
        parts = [text, code.co_code, repr(code.co_firstlineno).encode(), dumps(cells) if cells else b""]  # type: ignore[no-untyped-call]
        return hashlib.sha256(b"\0".join(parts)).hexdigest()

    def _name(self, sig: Any, processor: Any) -> str:
        """The name of an overload's file: the driver, a digest of the sources, and a digest of all else."""
        arguments, _ = normalize_signature(sig)  # type: ignore[no-untyped-call]
        types = "; ".join(map(_describe_type, arguments))
        key = _digest(f"{types}\n{processor}\n{prebuilt.interpreter()}\n{self._code}")
        return f"{self._stem}.{prebuilt.stamp()}.{key}{SUFFIX}"

    def _own(self, sig: Any, codegen: Any) -> Path | None:
        """The file of an overload compiled on this machine."""
        if self.cache_path is None:
            return None
        processor = "generic" if Settings.into is not None else codegen.magic_tuple()
        return Path(self.cache_path) / self._name(sig, processor)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function; None if it has to be compiled, with a lock against other processes."""
        own = self._own(sig, target_context.codegen())
        found = self._read(own, target_context)
        if found is None and Settings.into is None and not Settings.native:
            shipped = prebuilt.usable_folder()
            found = self._read(shipped and shipped / self._name(sig, "generic"), target_context)
        if found is None:
            _announce(self._stem)
            if own is not None and (lock := FileLock.taken(own)) is not None:
                self.locks.append(lock)
                found = self._read(own, target_context)  # which another process has compiled meanwhile
        return found

    def _read(self, path: Path | None, target_context: Any) -> Any:
        """The compiled function in a file; None if the file cannot be read."""
        if path is None:
            return None
        try:
            data = path.read_bytes()
        except OSError:
            return None
        with defer_signals():  # a symbol may be missing else, and to write to its address ends the process
            try:
                if HASH_SECRET in data:
                    target_context.refresh()
                rtsys.initialize(target_context)
                return CompileResult._rebuild(target_context, *pickle.loads(data))  # type: ignore[no-untyped-call]
            except Exception:  # pickle runs what it reads: anything can come of a damaged file
                return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write compiled code to disk, and delete the driver's files that belong to other sources."""
        arguments, _ = normalize_signature(sig)  # type: ignore[no-untyped-call]
        passing = any(isinstance(kind, numba.types.Callable) for kind in arguments)  # which has no lasting name
        own = self._own(sig, data.codegen)
        if own is None or passing or not self._numba.check_cachable(data):
            return
        with suppress(OSError):
            own.parent.mkdir(parents=True, exist_ok=True)
            _write(own, dumps(self._numba.reduce(data)))  # type: ignore[no-untyped-call]
            for other in own.parent.glob(f"{self._stem}.*{SUFFIX}"):
                if not other.name.startswith(f"{self._stem}.{prebuilt.stamp()}."):
                    other.unlink(missing_ok=True)

    def release(self, count: int) -> None:
        """Release the newest locks until only ``count`` are held."""
        while len(self.locks) > count:
            self.locks.pop().release()


class DriverDispatcher(CPUDispatcher):
    """A jitted function that Python calls, kept on disk."""

    _cache: KernelCache

    def __init__(self, py_func: Any, *arguments: Any, **options: Any) -> None:
        super().__init__(py_func, *arguments, **options)
        self._cache = KernelCache(py_func)

    def compile(self, sig: Any) -> Any:
        """Load or compile one overload.

        Without garbage collection: a compiler makes millions of objects and few cycles, a tenth of its time.
        """
        with global_compiler_lock, keep_interrupts():
            held, collecting = len(self._cache.locks), gc.isenabled()
            gc.disable()
            try:
                return super().compile(sig)
            finally:
                self._cache.release(held)
                if collecting:
                    gc.enable()


def _write(path: Path, data: bytes) -> None:
    """Write a file atomically: completely or not at all."""
    draft = path.with_name(f".draft-{uuid.uuid4().hex}")
    try:
        draft.write_bytes(data)
        draft.replace(path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


def keep_on_disk(options: dict[str, Any]) -> Callable[[Callable[..., Any]], Any]:
    """Decorator as `numba.njit` with ``cache=True``; without a cache where no folder for it can be written."""

    def decorated(function: Callable[..., Any]) -> Any:
        if config.DISABLE_JIT:  # type: ignore[attr-defined]
            return function
        return DriverDispatcher(
            function, targetoptions={"nopython": True, "boundscheck": None, **FOR_PYTHON_ALONE, **options}
        )

    return decorated
