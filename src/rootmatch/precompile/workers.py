"""The steps shared out among processes, which the compiler, holding one lock, needs to use several cores."""

from __future__ import annotations

import os
from concurrent.futures import as_completed
from functools import cache
from pathlib import Path

from rootmatch.backends.strongest import Progress
from rootmatch.backends.worker_lifetime import pool
from rootmatch.errors import RootmatchError
from rootmatch.jit import prebuilt
from rootmatch.jit.cache import Settings
from rootmatch.precompile.steps import STEPS, Step

MAX_WORKERS = 8
"""A worker takes 300 MB and works for a minute."""


def warm_up(
    chosen: str = "first",
    progress: Progress | None = None,
    workers: int | None = None,
    *,
    folder: Path | None = None,
    environment: dict[str, str] | None = None,
) -> None:
    """Compile kernels for this machine into the user's cache; each step in whichever worker is free.

    Parameters
    ----------
    chosen : str
        A name of `rootmatch.precompile.steps.STEPS`.
    progress : callable, optional
        Called with (done, total) after each step.
    workers : int, optional
        Processes; by default one for each core.
    folder : Path, optional
        Where kernels are left in the place of that cache.
    environment : dict, optional
        Of the workers, which may name another processor.

    Raises
    ------
    RootmatchError
        If a step fails; its error is in the text.
    """
    names = list(STEPS[chosen]())
    if progress is not None:
        progress(0, len(names))
    with pool(workers or min(os.cpu_count() or 1, MAX_WORKERS), environment) as executor:
        waiting = {executor.submit(_compile, chosen, name, folder): name for name in names}
        for done, step in enumerate(as_completed(waiting), start=1):
            try:
                step.result()
            except Exception as error:
                raise RootmatchError(f"warm-up, {waiting[step]}: {error!r}") from error
            if progress is not None:
                progress(done, len(names))


def prebuild(folder: Path, progress: Progress | None = None) -> None:
    """Compile kernels for a generic processor into a folder, for a wheel of this Python and Numba.

    Raises
    ------
    RootmatchError
        On a processor that `rootmatch.jit.prebuilt.GENERIC` does not name, or if a step fails.
    """
    if prebuilt.architecture() not in prebuilt.GENERIC:
        raise RootmatchError(f"no generic processor is known for {prebuilt.architecture()}; install without kernels")
    processor, _ = prebuilt.GENERIC[prebuilt.architecture()]
    folder.mkdir(parents=True, exist_ok=True)
    generic = {"NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": ""}
    warm_up("prebuilt", progress, folder=folder, environment=generic)
    prebuilt.write_manifest(folder)


def _compile(chosen: str, name: str, folder: Path | None) -> None:
    """Run a step in a worker; kernels are left in the folder, or in the user's cache for this machine."""
    Settings.into, Settings.native = folder, folder is None
    _steps(chosen)[name]()


@cache
def _steps(chosen: str) -> dict[str, Step]:
    """A set of steps, whose scenes are made once in a process."""
    return STEPS[chosen]()
