"""A problem made of a generated module."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rootmatch._version import __version__
from rootmatch.arrays import Floats
from rootmatch.cameras.base import CameraModel
from rootmatch.errors import InputError
from rootmatch.problems.base import Problem
from rootmatch.problems.derived.compile import register_residuals, tag_name
from rootmatch.problems.derived.evaluator import Evaluator
from rootmatch.problems.derived.measurements import Bearings, Measurement, Points
from rootmatch.problems.derived.residuals_text import Residuals
from rootmatch.problems.derived.store import Generated
from rootmatch.problems.derived.tables import DerivedTables, make_tag
from rootmatch.problems.derived.text import Shape
from rootmatch.problems.noise import pixel_equivalent
from rootmatch.problems.points import PointSets


@dataclass(frozen=True)
class DerivedProblem(Problem):
    """A minimal problem whose kernels were generated from equations; made by `rootmatch.derive`.

    Parameters
    ----------
    title : str
        Its name.
    generated : Generated
        The vetted module.
    source, target : Measurement
        What is measured of a point.

    Notes
    -----
    ``"joint"`` holds `constraints` resultants against their covariance, evaluated at the roots of the first minimal
    set; ``"normalised"`` one of them. Both grow where a root is badly determined, so near-degenerate sets fade by
    themselves. Degenerate are the sets that the equations leave undetermined, which only their author can name.
    """

    title: str
    generated: Generated
    source: Measurement
    target: Measurement

    def __post_init__(self) -> None:
        plan = self.generated.plan
        if plan["source"] != self.source.key or plan["target"] != self.target.key:
            raise InputError(
                f"{self.title}: derived for {plan['source']} and {plan['target']}, {self.source.key} and "
                f"{self.target.key} given; measure the same quantities"
            )
        # what other problems say once for their class differs from one derived problem to the next
        self.__dict__.update(
            name=self.title,
            minimal=int(plan["minimal"]),
            degree=int(plan["degree"]),
            constraints=len(plan["orders"]),
            source_dimension=self.source.dimension,
            target_dimension=self.target.dimension,
            noisy_source=self.source.noise_dimensions > 0,
        )
        residuals, tag = _compose_residuals(self.generated, self.source.noise_dimensions, self.target.noise_dimensions)
        self.__dict__.update(residuals=residuals, tag=tag)

    @property
    def sensor(self) -> CameraModel | None:
        """See `Problem.sensor`: the target, if it is unit rays as they are given."""
        return self.target if isinstance(self.target, Bearings) and self.target.camera is None else None

    def noise_pixels(self, source: Floats, target: Floats) -> tuple[float, float]:
        """See `Problem.noise_pixels`: coordinates given as they are have the caller's unit."""
        return (
            pixel_equivalent(source) if isinstance(self.source, Points) else 1.0,
            pixel_equivalent(target) if isinstance(self.target, Points) else 1.0,
        )

    def __repr__(self) -> str:
        return f"DerivedProblem({self.title!r}, source={self.source!r}, target={self.target!r})"

    @property
    def code(self) -> str:
        """Source of the generated formulas."""
        return self.generated.text

    @property
    def stated_constraints(self) -> int | None:
        """Independent constraints that the equations put on a hyper-edge, of which `constraints` are used.

        None if they could not be counted: no unknowns were found that satisfy the equations at the sampler's points.
        """
        stated: int | None = self.generated.plan.get("stated")
        return stated

    @property
    def surplus_constraints(self) -> int | None:
        """Constraints of a minimal set beyond those that determine its unknowns: over-determined if not 0.

        The polynomial holds none of them. None as for `stated_constraints`.
        """
        surplus: int | None = self.generated.plan.get("surplus")
        return surplus

    @property
    def evaluator(self) -> Evaluator:
        """The formulas on arrays."""
        return Evaluator(self.generated.plan, self.generated.functions, self.source, self.target)

    def measured(self, source: Measurement | None = None, target: Measurement | None = None) -> DerivedProblem:
        """A problem of the same equations with other measurements: another camera, or other rotations."""
        return DerivedProblem(self.title, self.generated, source or self.source, target or self.target)

    def tables(self, points: PointSets) -> DerivedTables:
        """Tables for the kernels; see `Problem.tables`."""
        register_residuals(self.__dict__["residuals"], self.generated.functions, self.__dict__["tag"])
        evaluator = self.evaluator
        x, u = self.source.measure(points.source), self.target.measure(points.target)
        dx = self.source.spread(points.source, points.source_noise)
        du = self.target.spread(points.target, points.target_noise)
        return DerivedTables(
            source=evaluator.table("s", x),
            source_pair=evaluator.table("ss", x),
            target=evaluator.table("t", u),
            target_pair=evaluator.table("tt", u),
            source_noise=evaluator.noise_table("s", x, dx),
            source_pair_noise=evaluator.noise_table("ss", x, dx),
            target_noise=evaluator.noise_table("t", u, du),
            target_pair_noise=evaluator.noise_table("tt", u, du),
            tag=make_tag(self.__dict__["tag"]),
        )

    def coefficients(self, source: ArrayLike, target: ArrayLike) -> Floats:
        """Polynomials of minimal sets; see `Problem.coefficients`."""
        result: Floats = self.evaluator.coefficients(np.asarray(source, dtype=float), np.asarray(target, dtype=float))
        return result

    def __reduce__(self) -> Any:
        """Pickled as text, which is vetted again when it is read."""
        return _rebuild_problem, (self.title, self.generated.text, self.source, self.target)


@lru_cache(maxsize=64)
def _compose_residuals(generated: Generated, source_noise: int, target_noise: int) -> tuple[Residuals, str]:
    """Text of the kernels and their tag: the same however the problem is seen, and slower to compose than a match."""
    plan = generated.plan
    residuals = Residuals(Shape(plan, source_noise, target_noise), tuple(plan["orders"]), plan["interval"])
    return residuals, tag_name(residuals, generated.text, __version__)


def _rebuild_problem(title: str, text: str, source: Measurement, target: Measurement) -> DerivedProblem:
    from rootmatch.problems.derived.store import compile_vetted

    return DerivedProblem(title, compile_vetted(text, title), source, target)
