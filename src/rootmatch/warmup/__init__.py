"""Kernels compiled ahead of need: for this machine (`rootmatch warmup`), or for a wheel."""

from rootmatch.warmup.workers import prebuild, warm_up

__all__ = ["prebuild", "warm_up"]
