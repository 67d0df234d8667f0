"""What this machine does in a second: kernels, contraction, whole matches and memory, for ``rootmatch benchmark``."""

from rootmatch.benchmark.run import NOTE, Plan, Results, run

__all__ = ["NOTE", "Plan", "Results", "run"]
