"""The rules that decide the paper's statements: for each, its cases and the figures that decide them.

The rules and their thresholds (`rootmatch.research.paper.verdict`) were written before any result was seen, with one
exception: methods at chance level decide nothing, because a verdict that no result could have changed says nothing.
Where no sample size is named, it is the largest. Intervals are 95 % bootstrap intervals over the instances.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from rootmatch.arrays import Bools, Floats
from rootmatch.research.bootstrap import Estimate, difference, estimate
from rootmatch.research.paper.plan import DENSE, Table
from rootmatch.research.paper.rho import SPARSE, Rule
from rootmatch.research.paper.settings import (
    BASELINES,
    NOISES,
    OUTLIERS,
    PANELS,
    TITLES,
    Setting,
    has_svd,
    problem_settings,
)
from rootmatch.research.paper.verdict import EQUAL, FEW, FULL, GOOD, LOST, RAPID, Case

Judge = Callable[[Table, Rule], list[Case]]
"""The cases of a statement, from a table and the rule by which ρ is chosen."""

NOISY = NOISES[1:]
SHORT, LONG = BASELINES


def _percent(value: float) -> str:
    return f"{100.0 * value:.1f} %"


def _text(e: Estimate) -> str:
    return f"{_percent(e.mean)} [{100 * e.low:.1f}, {100 * e.high:.1f}]"


def _points(e: Estimate) -> str:
    return f"{100 * e.mean:+.1f} [{100 * e.low:+.1f}, {100 * e.high:+.1f}] points"


def _are_at_chance(*accuracies: Floats) -> bool:
    """Whether all of these accuracies are at chance level."""
    return all(float(found.mean()) <= LOST for found in accuracies)


def _lead(name: str, first: Floats, second: Floats, figures: str, lead: Estimate) -> Case:
    """Whether the first leads the second; undecidable if both are at chance level."""
    if _are_at_chance(first, second):
        return Case(name, None, f"{figures}; both at chance level")
    return Case(name, lead.low > 0.0, figures)


def _paired_lead(name: str, first: Floats, second: Floats) -> Case:
    """Whether the first leads the second on the same instances."""
    lead = estimate(first - second)
    return _lead(name, first, second, _points(lead), lead)


def _judge_good(name: str, accuracy: Floats) -> Case:
    """Whether a method is good."""
    found = estimate(accuracy)
    return Case(name, found.mean >= GOOD, _text(found))


def _judge_pipeline_under_full(name: str, accuracy: Floats) -> Case:
    """Whether the default pipeline stays under 100 % too."""
    found = estimate(accuracy)
    return Case(name, found.mean < FULL, f"default pipeline {_text(found)}")


def _judge_under_full(name: str, accuracy: Floats) -> Case:
    """Whether a method stays under 100 %; undecidable at chance level, where it finds nothing at all."""
    found = estimate(accuracy)
    if _are_at_chance(accuracy):
        return Case(name, None, f"{_text(found)}; chance level")
    return Case(name, found.mean < FULL, _text(found))


def _judge_each(case: Callable[[str, Floats], Case], settings: dict[str, Setting]) -> Judge:
    """What a case says of the variant's method on each of some settings, at the largest sample."""
    return lambda table, rule: [case(name, table.paper(s, rule=rule)) for name, s in settings.items()]


def _judge_each_pipeline(settings: dict[str, Setting]) -> Judge:
    """Whether the default pipeline stays under 100 % too on each of some settings, at the largest sample."""
    return lambda table, rule: [_judge_pipeline_under_full(name, table.default(s)) for name, s in settings.items()]


def _judge_each_pair(pairs: dict[str, tuple[Setting, Setting]]) -> Judge:
    """Whether the method leads on the first setting of each pair, on the same instances."""
    return lambda table, rule: [
        _paired_lead(name, *(table.paper(s, rule=rule) for s in two)) for name, two in pairs.items()
    ]


NOISY_P3P = {f"σ = {noise:g}": Setting("p3p", 0, noise) for noise in NOISY}
EXACT_LONG = {"b = 5, σ = 0": Setting("3p1", 0, 0.0, LONG)}

under_full = _judge_each(_judge_under_full, NOISY_P3P)
geometry_is_to_blame = _judge_each_pipeline(NOISY_P3P)
handles_outliers = _judge_each(_judge_good, {f"{k} outliers": Setting("p3p", k) for k in OUTLIERS})
short_is_better = _judge_each_pair(
    {f"σ = {noise:g}": (Setting("3p1", 0, noise, SHORT), Setting("3p1", 0, noise, LONG)) for noise in NOISY}
)
long_under_full = _judge_each(_judge_under_full, EXACT_LONG)
long_is_degenerate = _judge_each_pipeline(EXACT_LONG)
short_is_robust = _judge_each(
    _judge_good,
    {f"{k} outliers, σ = {noise:g}": Setting("3p1", k, noise, SHORT) for k in OUTLIERS for noise in (0.5, 1.0)},
)
two_motions_are_harder = _judge_each_pair(
    {f"σ = {noise:g}": (Setting("up2p", 0, noise), Setting("up2p", 0, noise, motions=2)) for noise in NOISY}
)
two_motions_are_good = _judge_each(
    _judge_good, {f"σ = {noise:g}": Setting("up2p", 0, noise, motions=2) for noise in NOISY}
)


def judge_few_samples(table: Table, rule: Rule) -> list[Case]:
    """Noise-free P3P is full from few samples on."""
    setting, sizes = Setting("p3p"), table.effort.samples
    means = {size: float(table.paper(setting, rule=rule, samples=size).mean()) for size in sizes}
    shown = sorted({1000, 10_000, FEW, table.effort.maximum})
    figures = ", ".join(f"{_percent(means[size])} at {size:,}" for size in shown)
    return [Case("σ = 0", all(means[size] >= FULL for size in sizes if size >= FEW), figures)]


def judge_sparse_over_dense(table: Table, rule: Rule) -> list[Case]:
    """The sparse solver leads the dense one, panel by panel."""
    cases = []
    for problem in table.problems:
        for panel in PANELS[problem]:
            sparse, dense = (
                np.mean(
                    [table.paper(s, how, rule, size) for s in panel.settings for size in table.effort.samples], axis=0
                )
                for how in (SPARSE, DENSE)
            )
            cases.append(_paired_lead(f"{TITLES[problem]} {panel.label}", sparse, dense))
    return cases


def judge_noise_needs_samples(table: Table, rule: Rule) -> list[Case]:
    """The P3P curve of each σ lies below that of the σ before."""
    cases = []
    for less, more in pairwise(NOISES):
        before, after = (
            np.mean(
                [table.paper(Setting("p3p", 0, noise), rule=rule, samples=size) for size in table.effort.samples],
                axis=0,
            )
            for noise in (less, more)
        )
        fall = estimate(before - after)
        cases.append(_lead(f"σ from {less:g} to {more:g}", before, after, f"falls by {_points(fall)}", fall))
    return cases


def judge_qr_equals_svd(table: Table, rule: Rule) -> list[Case]:
    """QR and SVD are equal, panel by panel of those without outliers."""
    cases = []
    for problem in table.problems:
        gaps = {}
        for panel in (panel for panel in PANELS[problem] if all(map(has_svd, panel.settings))):
            gaps[f"{TITLES[problem]} {panel.label}"] = _qr_less_svd(table, rule, panel.settings)
        if problem == "up2p":
            # |R_2n,2n| blows up when the common root lies outside the unit circle; the least singular value does not.
            one_motion = tuple(s for s in problem_settings(problem) if s.motions == 1 and has_svd(s))
            (gap, remark), inside = _qr_less_svd(table, rule, one_motion), _roots_inside(table.seeds)
            for name, part in (("up2p |x| < 1", inside), ("up2p |x| > 1", ~inside)):
                gaps[name] = (None if gap is None else gap[part], remark)
        for name, (gap, remark) in gaps.items():
            if gap is None:
                cases.append(Case(name, None, remark))
            elif len(gap):
                e = estimate(gap)
                equal = e.low >= -EQUAL and e.high <= EQUAL
                cases.append(Case(name, equal, f"QR − SVD {_points(e)}{remark}"))
    return cases


def _qr_less_svd(table: Table, rule: Rule, settings: tuple[Setting, ...]) -> tuple[Floats | None, str]:
    """Accuracy with QR less that with SVD, a mean over settings for each instance, and what was left out.

    Settings in which both are at chance level say nothing; None if there is no other.
    """
    pairs = [
        [table.paper(s, rule=rule, samples=table.effort.common, residual=residual) for residual in ("qr", "svd")]
        for s in settings
    ]
    told = [qr - svd for qr, svd in pairs if not _are_at_chance(qr, svd)]
    if not told:
        return None, "both at chance level in all settings"
    left_out = len(pairs) - len(told)
    remark = f"; {left_out} of {len(pairs)} settings left out: both at chance level" if left_out else ""
    return np.mean(told, axis=0), remark


def _roots_inside(seeds: range) -> Bools:
    """Whether the true root x = tan(θ/2) of each up2p scene has |x| < 1, that is, whether cos θ > 0."""
    return np.array([Setting("up2p").scene(seed).poses[0][0][0, 0] > 0.0 for seed in seeds])


def judge_fall(table: Table, rule: Rule, problem: str, outliers: tuple[int, ...], baseline: float) -> list[Case]:
    """A rapid fall from the noise-free case to the greatest noise."""
    cases = []
    for k in outliers:
        exact, noisy = (table.paper(Setting(problem, k, s, baseline), rule=rule) for s in (0.0, max(NOISES)))
        fall = estimate(exact - noisy)
        figures = f"{_percent(float(exact.mean()))} to {_percent(float(noisy.mean()))}, a fall of {_points(fall)}"
        # From less than that nothing can fall so far.
        rapid = None if exact.mean() < RAPID else bool(fall.mean >= RAPID)
        cases.append(Case(f"{k} outliers" if k else "no outliers", rapid, figures))
    return cases


def judge_up2p_lead(table: Table, rule: Rule, outliers: tuple[int, ...], noises: tuple[float, ...]) -> list[Case]:
    """Give the cases in which up2p leads P3P."""
    cases = []
    for k in outliers:
        for noise in noises:
            up2p, p3p = (table.paper(Setting(problem, k, noise), rule=rule) for problem in ("up2p", "p3p"))
            lead = difference(up2p, p3p)
            name = f"{k} outliers, σ = {noise:g}" if k else f"σ = {noise:g}"
            figures = f"{_percent(float(up2p.mean()))} against {_percent(float(p3p.mean()))}: {_points(lead)}"
            cases.append(_lead(name, up2p, p3p, figures, lead))
    return cases


def judge_one_rho(table: Table, rule: Rule) -> list[Case]:
    """A ρ of its own gains a problem little over the one ρ of a rule."""
    cases = []
    for problem in table.problems:
        pairs = [
            table.paper(s, rule="own" if s.noise > 0.0 else "exact") - table.paper(s, rule=rule)
            for s in problem_settings(problem)
        ]
        gain = estimate(np.mean(pairs, axis=0))
        one, own, exact = (table.method(problem, rule=r).rho for r in (rule, "own", "exact"))
        figures = f"ρ = {own:g} with noise and {exact:g} without, instead of {one:g}, gains {_points(gain)}"
        cases.append(Case(TITLES[problem], gain.mean <= EQUAL, figures))
    return cases
