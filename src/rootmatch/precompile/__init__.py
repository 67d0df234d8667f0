"""Kernels compiled ahead of need: for this machine (`rootmatch warmup`), or for a wheel."""

from rootmatch.precompile.workers import prebuild, warm_up

__all__ = ["prebuild", "warm_up"]
