"""A match as text: the table of ``rootmatch match``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rootmatch.arrays import Floats, Integers

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from rootmatch.result import Match


ALTERNATIVES_SHOWN = 5
NARROW = 6
NAMES_SHOWN = 40
"""Points, or differences, listed by name; the rest are counted."""


def point_names(names: Sequence[str] | None, count: int) -> list[str]:
    """Names of points; by default their zero-based row numbers."""
    return [str(name) for name in (range(count) if names is None else names)]


def match_weights(match: Match) -> Floats:
    """Weight (n,) of each source point's match in the soft assignment, 0 where unmatched."""
    matched = match.assignment >= 0
    weights = np.zeros(len(match.assignment))
    weights[matched] = match.soft_assignment[np.flatnonzero(matched), match.assignment[matched]]
    return weights


def match_residuals(match: Match) -> Floats:
    """Distance (n,) of each source point's target from where the pose of its motion predicts it, NaN for none.

    Of a rig that of its first sighting.
    """
    residuals = np.full(len(match.assignment), np.nan)
    for pose in match.poses if match.problem.min_for_pose else []:
        if pose is None or pose.points is None or pose.residuals is None:
            continue
        points, first = pose.points % len(residuals), np.ones(len(pose.points), np.bool_)
        if match.sightings is not None:
            first = match.sightings.assignment.ravel()[pose.points] == match.assignment[points]
        residuals[points[first]] = pose.residuals[first]
    return residuals


def describe_weight(match: Match) -> str:
    """Evidence for a match: its score or, if no hyper-edge was evaluated, its log-odds against clutter."""
    if match.score is not None:
        return f"score {match.score:.4g}"
    return "no score" if match.log_odds is None else f"log-odds {match.log_odds:.4g}"


def summarise_match(match: Match) -> str:
    """One line: the number of matches, the score and the margin."""
    matched = int(np.sum(match.assignment >= 0))
    figures = f"{matched} of {len(match.assignment)} matched, {describe_weight(match)}, margin {match.margin:.2f}"
    return figures if match.probability is None else f"{figures}, probability {_format_probability(match.probability)}"


def print_match(
    match: Match,
    console: Console,
    *,
    source_names: Sequence[str] | None = None,
    target_names: Sequence[str] | None = None,
    truth: Integers | None = None,
    estimated: bool = False,
    advice: str | None = None,
) -> None:
    """Print the table of matches, unmatched points, figures, advice and, unless matched, the alternatives.

    Parameters
    ----------
    match : Match
    console : rich.console.Console
        Where to print.
    source_names, target_names : sequences of str, optional
        Names of the points; by default their zero-based row numbers.
    truth : (n,) array, optional
        The true assignment, −1 for points without an image; each match is then marked right or wrong.
    estimated : bool
        Whether σ was estimated; if so it is printed.
    advice : str, optional
        The advice in other words than those of `Match.advice`.
    """
    sources = point_names(source_names, match.soft_assignment.shape[0])
    targets = point_names(target_names, match.soft_assignment.shape[1])
    console.print(_match_table(match, sources, targets, truth))
    unmatched_sources = [sources[i] for i in np.flatnonzero(match.assignment < 0).tolist()]
    unmatched_targets = [targets[j] for j in np.setdiff1d(np.arange(len(targets)), match.assignment).tolist()]
    for side, unmatched in (("source", unmatched_sources), ("target", unmatched_targets)):
        if unmatched:
            _print_line(console, f"unmatched {side} points: {join_names(unmatched)}")
    if truth is not None:
        _print_line(console, _compare_with_truth(match.assignment, truth))
    _print_line(console, f"{summarise_match(match)}; {match.evaluated:,} hyper-edges in {match.seconds:.3g} s")
    if estimated:
        _print_line(console, f"noise: {match.noise:.3g} px, estimated")
    _print_line(console, advice or match.advice)
    if match.status.name != "MATCHED":
        for rank, (other, score) in enumerate(match.alternatives[:ALTERNATIVES_SHOWN], start=1):
            known = "" if score is None else f", score {score:.4g}"
            _print_line(
                console, f"  alternative {rank}{known}: {_alternative_difference(other, match, sources, targets)}"
            )


def _match_table(match: Match, sources: Sequence[str], targets: Sequence[str], truth: Integers | None) -> Table:
    """The matched points: source, target, weight and, where they apply, confidence, motion and truth."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    multi_motion = len(np.unique(match.motion_labels[match.assignment >= 0])) > 1
    known = bool(np.isfinite(match.confidence).any())
    table = Table(box=SIMPLE_HEAD)
    for name in (
        "source",
        "target",
        "weight",
        *(["confidence"] if known else []),
        *(["motion"] if multi_motion else []),
        *(["truth"] if truth is not None else []),
    ):
        # what a row is about is the last to be cut where the terminal is narrow
        minimum = {"source": _name_width(sources), "target": _name_width(targets)}.get(name)
        table.add_column(name, justify="left" if name == "truth" else "right", min_width=minimum)
    weights = match_weights(match)
    confidence = match.confidence
    for i, j in enumerate(match.assignment.tolist()):
        if j < 0:
            continue
        cells = [Text(sources[i]), Text(targets[j]), Text(f"{weights[i]:.3f}")]
        if known:
            cells.append(Text(_format_probability(float(confidence[i]))))
        if multi_motion:
            cells.append(Text(str(match.motion_labels[i])))
        if truth is not None:
            expected = f"should be {targets[truth[i]]}" if truth[i] >= 0 else "has no image"
            cells.append(Text("right") if truth[i] == j else Text(f"WRONG, {expected}", style="bold red"))
        table.add_row(*cells)
    return table


def _name_width(names: Sequence[str]) -> int:
    """Columns of a terminal that names get at least, however narrow it is."""
    return min(max(len(name) for name in names), NARROW)


def _compare_with_truth(assignment: Integers, truth: Integers) -> str:
    right = int(np.sum((assignment == truth) & (truth >= 0)))
    wrong = int(np.sum((assignment >= 0) & (assignment != truth)))
    missed = int(np.sum((assignment < 0) & (truth >= 0)))
    return f"truth: {right} of {int(np.sum(truth >= 0))} right, {wrong} wrong, {missed} missed"


def _alternative_difference(other: Integers, match: Match, sources: Sequence[str], targets: Sequence[str]) -> str:
    """Differences of an alternative from the assignment, as ``source→target``."""
    parts = [
        f"{sources[i]}→{targets[other[i]] if other[i] >= 0 else '–'}"
        for i in np.flatnonzero(other != match.assignment).tolist()
    ]
    return join_names(parts)


def join_names(names: Sequence[str]) -> str:
    """Names in one line, as many as `NAMES_SHOWN`; the rest are counted."""
    more = len(names) - NAMES_SHOWN
    return ", ".join(names[:NAMES_SHOWN]) + (f" and {more} more" if more > 0 else "")


def _print_line(console: Console, text: str) -> None:
    """Print a line verbatim: no markup, no highlighted numbers, no wrapping that a script would have to undo."""
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def _format_probability(probability: float) -> str:
    """A probability with as many digits as it takes to tell it from 1."""
    if np.isnan(probability):
        return "–"
    digits = next((d for d in (2, 3, 4) if round(probability, d) < 1.0), 0)
    return f"{probability:.{digits}f}" if digits else "> 0.9999"
