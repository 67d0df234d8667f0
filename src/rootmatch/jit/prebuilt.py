"""Kernels that come with the package, compiled when its wheel was built.

They are compiled for a generic processor and lie in the folder `FOLDER` with a manifest, which says for which versions
of Python and Numba, processors and sources they are. Where one of these differs they are left alone, and kernels are
compiled at first use as without them.
"""

from __future__ import annotations

import json
import platform
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from llvmlite import binding

from rootmatch.jit import sources

FOLDER = Path(__file__).parent / "prebuilt_kernels"
MANIFEST = "manifest.json"

GENERIC = {
    "x86_64": ("x86-64-v3", ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")),
    "arm64": ("generic", ()),
}
"""The processor that kernels are prebuilt for on each architecture, by its name for LLVM, and what it must have."""


def architecture() -> str:
    """The machine's architecture, by one name on all systems."""
    machine = platform.machine().lower()
    return {"amd64": "x86_64", "aarch64": "arm64"}.get(machine, machine)


def interpreter() -> str:
    """A text that names what compiled code on disk depends on, besides the processor and the sources."""
    return f"{sys.implementation.cache_tag} {sys.platform} {architecture()} numba {numba.__version__}"


def write_manifest(folder: Path) -> None:
    """Write the manifest of a folder: what its kernels were compiled for."""
    files = sources.compiled_sources()
    manifest = {
        "interpreter": interpreter(),
        "cpu": GENERIC[architecture()][0],
        "sources": sources.digest(files),
        "files": [path.relative_to(sources.PACKAGE).as_posix() for path in files],
    }
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=1), encoding="utf-8")


def reason_for_misfit(folder: Path = FOLDER) -> str | None:
    """Why the kernels of a folder cannot be used here, in words; None if they can."""
    if not (folder / MANIFEST).is_file():
        return "none come with this installation"
    try:
        manifest: dict[str, Any] = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        if manifest["interpreter"] != interpreter():
            return f"the prebuilt ones are for {manifest['interpreter']}, and this is {interpreter()}"
        if _manifest_digest(manifest) != manifest["sources"]:
            return "the prebuilt ones are of other sources"
    except (OSError, ValueError, KeyError, TypeError):
        return "the prebuilt ones cannot be read"
    return _cpu_misfit(manifest["cpu"])


def _manifest_digest(manifest: dict[str, Any]) -> str:
    """The digest of the files that a manifest names, as they are now."""
    return sources.digest(sources.PACKAGE / name for name in manifest["files"])


@cache
def stamp() -> str:
    """`rootmatch.jit.sources.stamp`, quicker where a manifest names the files that it is made of."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        manifest: dict[str, Any] = json.loads((FOLDER / MANIFEST).read_text(encoding="utf-8"))
        if _manifest_digest(manifest) == manifest["sources"]:
            return str(manifest["sources"])
    return sources.stamp()


def _cpu_misfit(cpu: str) -> str | None:
    """Why this processor cannot run kernels compiled for the processor of that name; None if it can."""
    config: Any = numba.config
    if config.CPU_NAME is not None or config.CPU_FEATURES is not None:
        return "NUMBA_CPU_NAME or NUMBA_CPU_FEATURES asks for a processor"
    try:
        features = dict(binding.get_host_cpu_features())
    except RuntimeError:  # not known for every processor
        return "this processor's features are unknown"
    name, needed = GENERIC.get(architecture(), ("", ()))
    lacking = [feature for feature in needed if not features.get(feature)]
    if name != cpu or not config.ENABLE_AVX:
        lacking.append(cpu)
    return f"this processor lacks {', '.join(lacking)}" if lacking else None


@cache
def usable_folder() -> Path | None:
    """The folder of kernels that can be used here, looked at once in a process."""
    return FOLDER if reason_for_misfit() is None else None
