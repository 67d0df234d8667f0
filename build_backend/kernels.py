"""Kernels for the wheel, compiled while it is built: a build hook of hatchling.

``ROOTMATCH_PREBUILD=0`` leaves them out, ``ROOTMATCH_PREBUILD=1`` insists on them; by default a wheel is made in any
case.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PROGRAM = """
import sys
from pathlib import Path
from rootmatch.precompile import prebuild
prebuild(Path(sys.argv[1]), lambda done, total: print(f"kernels: {done} of {total}", flush=True))
"""
PLACE = "rootmatch/jit/prebuilt_kernels"


class KernelsHook(BuildHookInterface):  # type: ignore[misc]
    """Adds `PLACE` to a wheel, which is then for one Python and one kind of machine."""

    folder: Path | None = None

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile."""
        wanted = os.environ.get("ROOTMATCH_PREBUILD", "")
        if version == "editable" or wanted == "0":
            return
        self.folder = Path(tempfile.mkdtemp(prefix="rootmatch-kernels-"))
        failure = self._compile(self.folder)
        if failure and wanted == "1":
            raise RuntimeError(failure)
        if failure:
            self.app.display_warning(f"{failure}; each user's first match will compile kernels instead")
            return
        build_data["force_include"][str(self.folder)] = PLACE
        build_data["pure_python"] = False
        build_data["infer_tag"] = True

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what is in the wheel now."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)

    def _compile(self, folder: Path) -> str | None:
        """Fill the folder; why it could not be done, or None."""
        if find_spec("numba") is None:
            return "Numba is not installed where the wheel is built"
        self.app.display_info("Compiling kernels; a minute or two")
        with tempfile.TemporaryDirectory(prefix="rootmatch-source-") as copy:
            # from an environment with an editable installation, pip takes its folder off the path, and src with it
            package = Path(self.root) / "src" / "rootmatch"
            shutil.copytree(package, Path(copy) / "rootmatch", ignore=shutil.ignore_patterns("__pycache__"))
            path = os.pathsep.join(filter(None, [copy, os.environ.get("PYTHONPATH")]))
            done = subprocess.run([sys.executable, "-c", PROGRAM, str(folder)], env={**os.environ, "PYTHONPATH": path})
        return f"kernels could not be compiled (exit code {done.returncode})" if done.returncode else None
