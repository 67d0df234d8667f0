"""Permissions that hold for the administrator too, as whom tests may run."""

from __future__ import annotations

import ctypes
import os
import sys

DROP_FROM_BOUNDING_SET, OVERRIDE_PERMISSIONS = 24, 1
CAN_BE_BOUND = hasattr(os, "geteuid") and (os.geteuid() != 0 or sys.platform == "linux")
"""Whether a folder can be read-only for a process that tests start."""


def bound_by_permissions() -> None:
    """To be called in a child before its program: a read-only folder is read-only, whoever runs it."""
    if os.geteuid() == 0:
        ctypes.CDLL(None, use_errno=True).prctl(DROP_FROM_BOUNDING_SET, OVERRIDE_PERMISSIONS, 0, 0, 0)
