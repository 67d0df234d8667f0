"""The paper's figures 2 to 4 and the scan of ρ, drawn with matplotlib.

Colour tells σ (the palette of Okabe and Ito, which all kinds of colour vision keep apart), the marker the number of
outliers and the line the solver: solid sparse, dashed dense, as in the paper. All panels have the same axes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rootmatch.research.bootstrap import estimates
from rootmatch.research.output_files import count_text
from rootmatch.research.paper.plan import DENSE, VARIANT_NAMES, Table, Variant
from rootmatch.research.paper.rho import RULE_NAMES, RULES, SCAN_SOLVERS, SPARSE, Rhos, Rule
from rootmatch.research.paper.settings import NOISES, PANELS, PROBLEMS, TITLES, Method, Panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = dict(zip(NOISES, ("#000000", "#0072B2", "#009E73", "#E69F00", "#D55E00"), strict=True))
"""Colour of each σ: from black without noise to vermilion for one pixel."""
MARKERS = {0: "", 5: "o", 10: "s"}
"""Marker of each number of outliers."""
GRIDS = {"p3p": (1, 2), "3p1": (2, 2), "up2p": (2, 2)}
"""Rows and columns of a figure's panels."""
_DESCRIPTIONS: dict[Variant, str] = {
    "tan": "solver of the text on 3P1 by tan(θ/2)",
    "balanced": "balanced solver (rows and columns where n = n') on the same tensors",
    "pipeline": "default pipeline (joint residual, discrete ascent) on the same samples",
}
FIGURES = {"p3p": "2", "3p1": "3", "up2p": "4"}


def draw(table: Table, problem: str, rule: Rule, beside: Variant | None = None) -> Figure:
    """A problem's figure: one panel a group of settings, mean accuracy against samples with 95 % bootstrap bands.

    Parameters
    ----------
    table : Table
        Its variant, the solver of the text or that of the published code, is drawn.
    problem : str
    rule : Rule
        By which the paper's ρ is chosen.
    beside : Variant, optional
        Added on the same instances; the paper's curves then step back and have no bands.
    """
    from matplotlib.figure import Figure

    rows, columns = GRIDS[problem]
    figure = Figure(figsize=(5.2 * columns + 0.3, 3.9 * rows + 1.3))
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, panel in zip(axes, PANELS[problem], strict=False):
        _panel(axis, table, panel, rule, beside)
    for axis in axes[len(PANELS[problem]) :]:
        axis.set_axis_off()
    for axis in axes[: len(PANELS[problem])]:
        axis.set_ylabel("mean accuracy (%)")
        axis.set_xlabel("sampled hyper-edges")
    rho = table.method(problem, rule=rule).rho
    count = len(table.seeds)
    figure.suptitle(
        f"Figure {FIGURES[problem]}, {TITLES[problem]}: 10 points, {count_text(count, 'instance')}, |R| of QR, "
        f"{VARIANT_NAMES[table.variant]}\nρ = {rho:.3g} ({RULE_NAMES[rule]})"
        + (f", with the {_DESCRIPTIONS[beside]}" if beside else ""),
        fontsize=11,
    )
    _legend(figure, beside)
    return figure


def _panel(axis: Axes, table: Table, panel: Panel, rule: Rule, beside: Variant | None) -> None:
    problem = panel.settings[0].problem
    lines: list[tuple[Method, dict[str, Any]]] = [
        (table.method(problem, SPARSE, rule), {"linestyle": "-", "linewidth": 1.0 if beside else 1.8}),
        (table.method(problem, DENSE, rule), {"linestyle": "--", "linewidth": 0.9 if beside else 1.3}),
    ]
    added, sizes = None, table.effort.samples
    if beside:
        added = replace(table, variant=beside).method(problem, SPARSE, rule)
        lines = [(method, style | {"alpha": 0.45}) for method, style in lines]
        lines.append((added, {"linestyle": (0, (4, 1, 1, 1)), "linewidth": 2.4}))
    for setting in panel.settings:
        for method, style in lines:
            columns = np.stack([table.cells[setting, method, size] for size in sizes], axis=1)
            curve = estimates(columns)
            colour = COLOURS[setting.noise]
            mean = [100 * e.mean for e in curve]
            axis.plot(sizes, mean, color=colour, marker=MARKERS[setting.outliers], markersize=4, **style)
            if added is None or method == added:
                low, high = ([100 * getattr(e, end) for e in curve] for end in ("low", "high"))
                axis.fill_between(sizes, low, high, color=colour, alpha=0.12, linewidth=0)
    axis.set_xscale("log")
    axis.set_xlim(sizes[0], sizes[-1])
    axis.set_ylim(0, 102)
    axis.set_yticks(range(0, 101, 20))
    axis.grid(alpha=0.3)
    axis.set_title(f"{panel.label}  {panel.title}", loc="left", fontsize=10)


def _legend(figure: Figure, beside: Variant | None) -> None:
    """One legend for all panels, below them: what colour, marker and line mean."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=COLOURS[noise], linewidth=3, label=f"σ = {noise:g} px") for noise in NOISES]
    handles += [
        Line2D([], [], color="grey", marker=marker, linestyle="", label=f"{k} outliers")
        for k, marker in MARKERS.items()
        if marker
    ]
    handles.append(Line2D([], [], color="grey", linestyle="-", linewidth=1.8, label="sparse (ℓ¹ rows)"))
    handles.append(Line2D([], [], color="grey", linestyle="--", linewidth=1.3, label="dense"))
    if beside:
        name = VARIANT_NAMES[beside]
        line = Line2D([], [], color="grey", linestyle=(0, (4, 1, 1, 1)), linewidth=2.4, label=name)
        handles.append(line)
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=9, frameon=False)


def draw_scan(rhos: Rhos) -> Figure:
    """Mean accuracy of both sparse solvers with |R| of QR against ρ; discs mark the choices."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 4.8))
    colours = dict(zip(PROBLEMS, ("#0072B2", "#E69F00", "#009E73"), strict=True))
    looks: list[tuple[str, Rule, str, dict[str, Any]]] = [
        ("all", "one", "mean of the problems", {"color": "#000000"}),
        ("all", "paper", "ρ that the paper needs", {"color": "#000000", "linestyle": "", "marker": "D"}),
    ]
    for problem in rhos.problems:
        looks.append((problem, "own", TITLES[problem], {"color": colours[problem]}))
        thin = {"color": colours[problem], "linestyle": ":", "linewidth": 1.2, "markerfacecolor": "white"}
        looks.append((problem, "exact", f"{TITLES[problem]}, noise-free scenes alone", thin))
    grid, titles = rhos.effort.grid, ("solver of the text", "published solver")
    for axis, solver, title in zip(figure.subplots(1, 2, sharey=True), SCAN_SOLVERS, titles, strict=True):
        for problem, rule, name, look in looks:
            asked = "qr", problem if rule not in RULES else rhos.problems[0], rule, solver
            curve, chosen = rhos.curve(*asked), rhos.choose_rho(*asked)
            style = {"linewidth": 1.8, "marker": "o", "markersize": 8} | look
            axis.plot(grid, 100 * curve, markevery=[grid.index(chosen)], label=name, **style)
        axis.set_xscale("log")
        axis.set_ylim(0, 102)
        axis.grid(alpha=0.3)
        axis.set_title(title, loc="left", fontsize=10)
        axis.set_xlabel("ρ (units of the residual)")
        axis.set_ylabel("mean accuracy (%)")
    count = count_text(len(rhos.effort.scan_seeds("qr")), "instance")
    figure.suptitle(
        f"Choice of ρ: |R| of QR, {rhos.effort.scan_samples('qr'):,} samples, {count} a setting on seeds "
        "that are not reported; marks show the choices",
        fontsize=11,
    )
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    return figure
