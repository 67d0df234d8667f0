"""Settings of the paper's scenes, methods, and the panels of its figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rootmatch.simulation import SCENES, Scene

PROBLEMS = ("p3p", "3p1", "up2p")
TITLES = {"p3p": "P3P", "3p1": "3P1", "up2p": "up2p"}

NOISES = (0.0, 0.1, 0.25, 0.5, 1.0)
"""σ of an image coordinate in pixels; the paper says "from σ=0.1 to σ=1.0" beside the noise-free case."""
OUTLIER_NOISES = (0.0, 0.5, 1.0)
OUTLIERS = (5, 10)
"""50 % and 100 % of the ten points."""
BASELINES = (1.0, 5.0)

SAMPLES = tuple(round(10 ** (3 + k / 2)) for k in range(7))
"""Sampled hyper-edges, 10³ to 10⁶, two a decade; each sample holds those before it."""

GRID = tuple(float(f"1e{k}") for k in range(-16, 1))
"""ρ from 10⁻¹⁶ to 1 in decades: residuals of the three problems lie six decades apart, those of exact data lower."""

SCAN_SEED = 1_000_000
"""The first seed of the scenes on which ρ is chosen; those that are reported lie below."""


@dataclass(frozen=True)
class Effort:
    """How much is run: instances, sample sizes, and the scan of ρ."""

    instances: int = 100
    """Scenes of each setting."""
    quick: bool = False
    """Leave out the sample sizes above 10⁵ and every second ρ, and compare the residuals at 10⁴ samples."""

    @property
    def samples(self) -> tuple[int, ...]:
        """Sample sizes of the curves."""
        return tuple(size for size in SAMPLES if size <= 100_000) if self.quick else SAMPLES

    @property
    def maximum(self) -> int:
        """The largest sample, at which most claims are judged."""
        return max(self.samples)

    @property
    def common(self) -> int:
        """The sample size at which all residuals are compared."""
        return 10_000 if self.quick else 100_000

    @property
    def grid(self) -> tuple[float, ...]:
        """Among which ρ is chosen."""
        return GRID[::2] if self.quick else GRID

    def scan_samples(self, residual: str) -> int:
        """Sample size of the scan of a residual."""
        return self.common if residual in ("qr-both", "svd") else 100_000

    def scan_seeds(self, residual: str) -> range:
        """Seeds on which a residual is scanned: as many as instances are reported, up to 24.

        The residual of the paper's figures, on which most claims rest, has twice as many as those it is compared with.
        """
        count = min(24, self.instances)
        return range(SCAN_SEED, SCAN_SEED + (-(-count // 2) if residual in ("qr-both", "svd") else count))


@dataclass(frozen=True, order=True)
class Setting:
    """How scenes are simulated, all but the seed."""

    problem: str
    """``"p3p"``, ``"3p1"`` or ``"up2p"``."""
    outliers: int = 0
    noise: float = 0.0
    """σ in pixels."""
    baseline: float = 0.0
    """Distance of the two cameras of 3P1; 0 for the problems with one camera."""
    motions: int = 1

    def scene(self, seed: int) -> Scene:
        """The instance of a seed, with the paper's ten points."""
        own: dict[str, Any] = {"baseline": self.baseline} if self.problem == "3p1" else {"motions": self.motions}
        return SCENES[self.problem](outliers=self.outliers, noise=self.noise, seed=seed, **own)

    def __str__(self) -> str:
        parts = [TITLES.get(self.problem, self.problem)]
        if self.baseline:
            parts.append(f"b = {self.baseline:g}")
        if self.motions > 1:
            parts.append(f"{self.motions} motions")
        if self.outliers:
            parts.append(f"{self.outliers} outliers")
        return ", ".join([*parts, f"σ = {self.noise:g}"])


@dataclass(frozen=True, order=True)
class Method:
    """How a scene is matched."""

    residual: str
    """``"qr"``, ``"qr-both"``, ``"svd"`` or ``"joint"``; with ``-cos`` appended, 3P1 by x = cos θ."""
    solver: str
    """A key of `rootmatch.research.paper.work_unit.SOLVERS`."""
    rho: float
    """Spread ρ of the affinity, in units of the residual; 1 for ``"joint"``, which is in units of the noise."""


DEFAULT_PIPELINE = Method("joint", "ascent", 1.0)
"""What `rootmatch.match` does when nothing else is asked for, but on sampled hyper-edges."""


def residual_name(problem: str, residual: str) -> str:
    """How a `Method` names a residual of the paper for a problem: 3P1 is written in cos θ, unless ``"tan"`` is given.

    ``"tan"`` is ``"qr"`` with the unknown tan(θ/2), which up2p has in the paper and 3P1 has by default in this library.
    """
    if residual == "tan":
        return "qr"
    return f"{residual}-cos" if problem == "3p1" else residual


@dataclass(frozen=True)
class Panel:
    """One panel of a figure of the paper."""

    label: str
    title: str
    settings: tuple[Setting, ...]


def _clean_settings(problem: str, **more: float) -> tuple[Setting, ...]:
    return tuple(Setting(problem, 0, noise, **more) for noise in NOISES)  # type: ignore[arg-type]


def _cluttered_settings(problem: str, **more: float) -> tuple[Setting, ...]:
    return tuple(Setting(problem, k, noise, **more) for k in OUTLIERS for noise in OUTLIER_NOISES)  # type: ignore[arg-type]


PANELS: dict[str, tuple[Panel, ...]] = {
    "p3p": (
        Panel("2(a)", "no outliers", _clean_settings("p3p")),
        Panel("2(b)", "5 and 10 outliers", _cluttered_settings("p3p")),
    ),
    "3p1": (
        Panel("3(a)", "b = 1, no outliers", _clean_settings("3p1", baseline=1.0)),
        Panel("3(b)", "b = 5, no outliers", _clean_settings("3p1", baseline=5.0)),
        Panel("3(c)", "b = 1, 5 and 10 outliers", _cluttered_settings("3p1", baseline=1.0)),
        Panel("3(d)", "b = 5, 5 and 10 outliers", _cluttered_settings("3p1", baseline=5.0)),
    ),
    "up2p": (
        Panel("4(a)", "one motion, no outliers", _clean_settings("up2p")),
        Panel("4(b)", "one motion, 5 and 10 outliers", _cluttered_settings("up2p")),
        Panel("4(c)", "two motions, no outliers", _clean_settings("up2p", motions=2)),
    ),
}
"""The panels of the paper's figures 2, 3 and 4, each problem's figure in reading order."""


def problem_settings(problem: str) -> tuple[Setting, ...]:
    """All settings that a problem's figure shows."""
    return tuple(setting for panel in PANELS[problem] for setting in panel.settings)


SCAN_SETTINGS: dict[str, tuple[Setting, ...]] = {
    problem: tuple(s for s in problem_settings(problem) if s.outliers in (0, 5) and s.noise in OUTLIER_NOISES)
    for problem in PROBLEMS
}
"""Settings on which ρ is chosen: of those reported, without noise, with medium and with most, without outliers and
with five."""


def has_svd(setting: Setting) -> bool:
    """Whether the residual ``svd`` is tried on a setting: it has no closed form and costs fifty times as much."""
    return setting.outliers == 0
