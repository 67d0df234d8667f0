"""The build backend: hatchling, with what compiles kernels where a wheel is built.

`build_backend/kernels.py` runs the package itself, so its numerical libraries have to be there; not so for an editable
installation, which has no kernels, and for an sdist.
"""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Any

from hatchling import build
from hatchling.build import *  # noqa: F403  the hooks of PEP 517 and 660, as many as hatchling has here

NEEDED = ("joblib", "numba", "numpy", "scipy")
"""What the kernels' compilation imports."""


def get_requires_for_build_wheel(config_settings: dict[str, Any] | None = None) -> list[str]:
    """PEP 517's hook."""
    required = build.get_requires_for_build_wheel(config_settings)
    if os.environ.get("ROOTMATCH_PREBUILD") == "0":
        return required
    project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]
    return [*required, *(name for name in project["dependencies"] if name.startswith(NEEDED))]
