"""Speed and memory on this machine: kernels, contraction and whole matches, for ``rootmatch benchmark``."""

from rootmatch.research.speed.run import NOTE, Plan, Results, run

__all__ = ["NOTE", "Plan", "Results", "run"]
