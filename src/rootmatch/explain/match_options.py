"""The options of a match: everything that does not depend on the points, validated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Literal, Self

from rootmatch.arrays import cache_by_identity
from rootmatch.backends import selection
from rootmatch.backends.strongest import Progress
from rootmatch.errors import InputError, quote_value
from rootmatch.explain.decide import MIN_PROBABILITY
from rootmatch.explain.validation import (
    check_callable,
    check_choice,
    check_count,
    check_motions,
    check_positive,
    check_probability,
)
from rootmatch.hypergraph.affinity import NOISE_KINDS, Affinity, Residual, affinity
from rootmatch.model.priors import WRONG_MODEL
from rootmatch.problems.base import Problem
from rootmatch.samplers.base import Sampler
from rootmatch.samplers.guided.sampler import Guided
from rootmatch.solvers import MultiStartAscent, Solver, get_solver

SamplerName = Literal["auto", "exhaustive", "random", "guided"]
AFTER_SEARCH = MultiStartAscent(starts=24, agreement=4, rivals=4)
"""Default solver for the hyper-edges among a search's hypotheses, which are also assessed directly. Round values; the
accuracy with them: benchmarks/constellations.py and benchmarks/matches.py."""
SAMPLER_NAMES: tuple[SamplerName, ...] = ("auto", "exhaustive", "random", "guided")


@dataclass(frozen=True, eq=False, kw_only=True)
class MatchOptions:
    """The options of `rootmatch.match`, under the same names and with the same defaults; see there.

    Everything that does not depend on the points is validated here: options that are not one of the choices, or that
    cannot be combined with another, are refused.
    """

    seed: int = 0
    preset: Literal["paper"] | None = None
    sampler: SamplerName | Sampler | None = None
    samples: int | None = None
    residual: str | Residual | None = None
    rho: float | None = None
    solver: str | Solver | None = None
    motions: int | Literal["auto"] = 1
    backend: selection.Name = "auto"
    max_hyperedges: int = 5_000_000
    max_evaluations: int | None = None
    scheduler: str | None = None
    progress: Progress | None = None
    detection_rate: float | None = None
    resolution: float | None = None
    max_seconds: float | None = None
    min_probability: float | None = None

    @classmethod
    def among(cls, arguments: Mapping[str, Any]) -> Self:
        """Those among the arguments of a call, by their names."""
        return cls(**{one.name: arguments[one.name] for one in fields(cls) if one.name in arguments})

    def __post_init__(self) -> None:
        if self.preset not in (None, "paper"):
            raise InputError(f'preset: {self.preset!r} given; give "paper", or leave it out')
        check_motions(self.motions)
        for name, value in (("seed", self.seed), ("max_hyperedges", self.max_hyperedges)):
            if value is None:
                raise InputError(f"{name}: None given; give a whole number, or leave it out")
        check_count("seed", self.seed, minimum=0)
        check_count("samples", self.samples)
        check_count("max_evaluations", self.max_evaluations)
        check_count("max_hyperedges", self.max_hyperedges)
        check_positive("rho", self.rho)
        check_probability("detection_rate", self.detection_rate)
        check_positive("resolution", self.resolution)
        if self.resolution is not None and (self.motions != 1 or self.is_paper):
            other = "preset" if self.is_paper else "motions"
            raise InputError(f"resolution: not supported with {other}=; leave one of them out")
        check_positive("max_seconds", self.max_seconds)
        check_probability("min_probability", self.min_probability)
        if self.min_probability is not None and self.min_probability >= 1.0 - WRONG_MODEL:
            maximum = 1.0 - WRONG_MODEL
            raise InputError(
                f"min_probability: {float(self.min_probability)!r} given; give less than {maximum:g}: no match is more "
                "probable, as the model itself may be wrong"
            )
        check_choice("backend", self.backend, selection.NAMES)
        check_callable("progress", self.progress, "a function of two numbers, done and total")
        if self.scheduler is not None and not isinstance(self.scheduler, str):
            raise InputError(f"scheduler: {self.scheduler!r} given; give its address, tcp://host:port")
        if isinstance(self.sampler, str):
            check_choice("sampler", self.sampler, SAMPLER_NAMES)
        else:
            check_callable("sampler", self.sampler, f"a sampler, or one of {', '.join(SAMPLER_NAMES)}")
        if self.samples is not None and self.chosen_sampler != "random":
            named = f'"{self.sampler}"' if isinstance(self.sampler, str) else quote_value(self.sampler)
            raise InputError(f'samples: it applies to sampler="random", not to {named}; leave one of them out')
        if self.residual is not None and not isinstance(self.residual, str | Residual):
            raise InputError(f"residual: {self.residual!r} given; give its name or a Residual")
        get_solver("ascent" if self.solver is None else self.solver)

    def check_rig(self) -> None:
        """Refuse options that rigs do not support."""
        searches = self.sampler in (None, "auto", "guided") or isinstance(self.sampler, Guided)
        given = {
            "motions": self.motions != 1,
            "preset": self.preset is not None,
            "solver": self.solver is not None,
            "scheduler": self.scheduler is not None,
            "samples": self.samples is not None,
            "sampler": not searches,
        }
        for name, is_given in given.items():
            if is_given:
                raise InputError(f"{name}: not supported for a rig; leave it out")

    @property
    def required_probability(self) -> float:
        """Probability from which a match is trusted."""
        return MIN_PROBABILITY if self.min_probability is None else self.min_probability

    @cached_property
    def local_options(self) -> MatchOptions:
        """The options for a part of the task, which is matched in this process and reports no progress."""
        if self.progress is None and self.scheduler is None:
            return self
        return replace(self, progress=None, scheduler=None)

    @property
    def is_paper(self) -> bool:
        """Whether the paper's preset is the default for options that are not given."""
        return self.preset == "paper"

    @property
    def chosen_sampler(self) -> SamplerName | Sampler:
        """Which hyper-edges are evaluated."""
        return self.sampler or ("random" if self.is_paper or self.samples is not None else "auto")

    def choose_solver(self, searched: bool) -> Solver:
        """The solver; the default one has fewer starts if a search has named the assignments worth starting from."""
        if searched and self.solver is None and not self.is_paper:
            return AFTER_SEARCH
        return get_solver(self.solver if self.solver is not None else "power-l1" if self.is_paper else "ascent")

    @property
    def packs_motions(self) -> bool:
        """Whether groups of one motion each are packed: for several motions, unless a solver is named."""
        return self.motions != 1 and self.solver is None and not self.is_paper

    @cache_by_identity(64)
    def affinity(self, problem: Problem, exact: bool) -> Affinity:
        """The map from a hyper-edge's residual to its weight, for a problem and data with or without noise."""
        residual = self.residual or ("qr" if self.is_paper else "joint")
        in_noise = (residual.kind if isinstance(residual, Residual) else residual) in NOISE_KINDS
        paper_rho = problem.paper_rho_of_exact_data if exact else problem.paper_rho
        chosen = affinity(residual, self.rho if self.rho is not None or in_noise else paper_rho)
        chosen.residual.kernel_kind(problem.pair_count, problem.name)  # refuses pairs that the problem does not have
        return chosen
