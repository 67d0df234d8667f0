"""Kernels of derived problems as plain Python, which need not be compiled."""

from __future__ import annotations

import pytest

from rootmatch.problems.derived import compile as compile_module
from rootmatch.problems.derived.problem import DerivedProblem
from rootmatch.problems.kernels import ResidualKernels


def interpreted_kernels(problem: DerivedProblem) -> dict[type, ResidualKernels]:
    """The kernels of each kind of residual, by the very text that is compiled."""
    with pytest.MonkeyPatch.context() as patch:
        for decorator in ("kernel", "scalar"):
            patch.setattr(compile_module, decorator, lambda function: function)
        return compile_module.compile_residuals(problem.__dict__["residuals"], problem.generated.functions)
