"""Table, numbers and figure of the public protocols, next to published results."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rootmatch.io.csv_tables import csv_text
from rootmatch.research.bootstrap import Estimate, estimate
from rootmatch.research.hypergraph.protocol import DEFORMATION, OUTLIERS, POINTS
from rootmatch.research.output_files import count_text, figure_files, markdown_table, write_files
from rootmatch.research.paper.settings import Setting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PUBLISHED = ", published"
"""End of the name of a published result in the figure."""
METHODS = {"power-l1": "TM", "rrwhm-published": "RRWHM", "bcagm": "BCAGM"}
"""Solvers here, and the published methods that they correspond to."""

ACCURACY: dict[tuple[str, float], dict[str, float]] = {
    (DEFORMATION, 0.2): {"TM": 0.71, "RRWHM": 0.80, "BCAGM": 0.79},
    (DEFORMATION, 0.3): {"TM": 0.49, "RRWHM": 0.63, "BCAGM": 0.61},
    (DEFORMATION, 0.4): {"TM": 0.34, "RRWHM": 0.45, "BCAGM": 0.41},
    (OUTLIERS, 20): {"TM": 0.85, "RRWHM": 1.0, "BCAGM": 1.0},
    (OUTLIERS, 100): {"TM": 0.73, "RRWHM": 0.87, "BCAGM": 0.91},
    (OUTLIERS, 200): {"TM": 0.35, "RRWHM": 0.57, "BCAGM": 0.64},
}
"""Mean accuracy over 100 trials, by protocol and σ or number of outliers: read off figures, about two digits."""

MILLISECONDS = {"TM": 190.0, "RRWHM": 30.0, "BCAGM": 10.0}
"""One thread, n = 20, about 0.8 million symmetric nonzeros; another machine."""

COLOURS = {
    "power-dense": "#999999", "power-l1": "#E69F00", "power-l1-balanced": "#F0E442", "hgm": "#CC79A7",
    "rrwhm-published": "#0072B2", "rrwhm": "#000000", "rrwhm-soft": "#56B4E9", "bcagm": "#009E73", "ascent": "#D55E00",
}  # fmt: skip
"""Colour of each solver (the palette of Okabe and Ito)."""
DASHES = dict(zip(COLOURS, ("-", "-", "--", "-", "-", "--", ":", "-", "--"), strict=True))
"""Dashes of each solver, which tell coinciding curves apart."""


@dataclass(frozen=True)
class Results:
    """Accuracies of all instances."""

    settings: dict[str, tuple[Setting, ...]]
    """Those of each protocol."""
    solvers: tuple[str, ...]
    cells: dict[tuple[Setting, str], NDArray[np.float64]]
    """(instances,) of each setting and solver."""
    milliseconds: dict[str, float]
    """Time of each solver at n = 20."""

    @property
    def instances(self) -> int:
        """Instances of each setting."""
        return len(next(iter(self.cells.values())))

    def estimate(self, setting: Setting, solver: str) -> Estimate:
        """Mean accuracy and its interval."""
        return estimate(self.cells[setting, solver])


def level(setting: Setting) -> float:
    """The quantity that a setting's protocol varies: σ, or the number of outliers."""
    return setting.noise if setting.problem == DEFORMATION else float(setting.outliers)


def _title(protocol: str) -> tuple[str, str]:
    """Heading of a protocol and the sign of what it varies."""
    if protocol == DEFORMATION:
        return f"deformation, n = n' = {POINTS[protocol]}", "σ"
    return f"outliers, n = {POINTS[protocol]}, σ = 0.01", "outliers"


def results_markdown(results: Results) -> str:
    """Mean accuracies, the published ones in brackets, and times."""
    lines = []
    for protocol, settings in results.settings.items():
        title, sign = _title(protocol)
        rows = []
        for setting in settings:
            published = ACCURACY.get((protocol, level(setting)), {})
            means = {solver: results.estimate(setting, solver).mean for solver in results.solvers}
            others = {solver: published.get(name) for solver, name in METHODS.items()}
            cells = [f"{mean:.3f}" + (f" ({others[s]:.2f})" if others.get(s) else "") for s, mean in means.items()]
            maximum = f"{max(published.values()):.2f}" if published else ""
            rows.append([f"{level(setting):g}", *cells, f"{max(means.values()):.3f}", maximum])
        lines += [f"### {title[0].upper()}{title[1:]}", ""]
        lines += markdown_table([sign, *results.solvers, "best here", "best published"], rows)
    times = []
    for solver in results.solvers:
        other = MILLISECONDS.get(METHODS.get(solver, ""))
        times.append((solver, f"{results.milliseconds[solver]:.1f} ms", "" if other is None else f"{other:.0f} ms"))
    lines += ["### Time at n = 20, one thread", "", *markdown_table(("solver", "here", "published"), times)]
    count = count_text(results.instances, "instance")
    note = f"Mean accuracy of {count}; in brackets what is published (TM, RRWHM, BCAGM)."
    return "\n".join(["# Public protocols of hypergraph matching", "", note, "", *lines])


def results_csv(results: Results) -> str:
    """All cells as CSV text: mean accuracy with its 95 % bootstrap interval, and the published one."""
    header = ("protocol", "points", "outliers", "noise", "solver", "instances", "accuracy", "low", "high", "published")
    rows = []
    for protocol, settings in results.settings.items():
        for setting in settings:
            published = ACCURACY.get((protocol, level(setting)), {})
            for solver in results.solvers:
                e = results.estimate(setting, solver)
                where = (protocol, POINTS[protocol], setting.outliers, setting.noise, solver, e.count)
                other = published.get(METHODS.get(solver, ""), "")
                rows.append((*where, round(e.mean, 6), round(e.low, 6), round(e.high, 6), other))
    return csv_text([header, *rows])


def draw(results: Results) -> Figure:
    """A panel for each protocol: accuracy with 95 % bands; crosses are what is published."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.6 * len(results.settings) + 0.4, 5.0))
    axes = figure.subplots(1, len(results.settings), squeeze=False)[0]
    for axis, (protocol, settings) in zip(axes, results.settings.items(), strict=True):
        title, sign = _title(protocol)
        levels = [level(setting) for setting in settings]
        for solver in results.solvers:
            found = [results.estimate(setting, solver) for setting in settings]
            axis.plot(
                levels,
                [e.mean for e in found],
                color=COLOURS[solver],
                linestyle=DASHES[solver],
                label=solver,
                linewidth=1.8,
            )
            low, high = [e.low for e in found], [e.high for e in found]
            axis.fill_between(levels, low, high, color=COLOURS[solver], alpha=0.12, linewidth=0)
            name = METHODS.get(solver)
            points = [(at, ACCURACY[protocol, at][name]) for at in levels if name and (protocol, at) in ACCURACY]
            if points:
                style = {"linestyle": "", "marker": "x", "markersize": 8, "markeredgewidth": 2}
                axis.plot(*zip(*points, strict=True), color=COLOURS[solver], label=f"{name}{PUBLISHED}", **style)
        axis.set_title(title, loc="left", fontsize=10)
        axis.set_xlabel(sign)
        axis.set_ylabel("mean accuracy")
        axis.set_ylim(0, 1.02)
        axis.grid(alpha=0.3)
    by_label = {label: line for axis in axes for line, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    labels = sorted(by_label, key=lambda label: label.endswith(PUBLISHED))  # columns of solvers, then of crosses
    figure.legend(
        [by_label[label] for label in labels], labels, loc="outside lower center", ncols=5, fontsize=9, frameon=False
    )
    return figure


def write(results: Results, output: Path) -> tuple[Path, ...]:
    """Write table, numbers and figure; a file that is being replaced stays whole until the new one is."""
    texts = [("hypergraph.md", results_markdown(results).encode()), ("hypergraph.csv", results_csv(results).encode())]
    return write_files(output, [*texts, *figure_files("hypergraph", draw(results))])
