"""``claims.md``: what of the paper holds, with the figures that decide it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from rootmatch.experiments.claims import CLAIMS, Claim
from rootmatch.experiments.plan import (
    BALANCED,
    COMMON_SAMPLES,
    DENSE,
    IMPROVEMENT_NAMES,
    MOST_SAMPLES,
    SPARSE,
    Improvement,
    Table,
)
from rootmatch.experiments.rho import RESIDUALS, RULE_NAMES, RULES, SCAN_INSTANCES, SCAN_SAMPLES, Rule
from rootmatch.experiments.settings import PANELS, SCAN_SEED, SCAN_SETTINGS, TITLES, Setting, has_svd
from rootmatch.experiments.statistics import estimate
from rootmatch.experiments.verdict import LOST, Case, verdict


@dataclass(frozen=True)
class Judgement:
    """A claim and, for each way to choose ρ, its cases: for the letter of the paper, and for what improves on it.

    The default pipeline has no ρ to choose; its cases stand under the first rule.
    """

    claim: Claim
    cases: dict[Rule, list[Case]]
    improved: dict[Improvement, dict[Rule, list[Case]]] = field(default_factory=dict)

    def verdict(self, rule: Rule) -> str:
        """The verdict on the letter under a rule; empty when the claim does not depend on ρ."""
        return verdict(self.cases[rule]) if rule in self.cases else ""

    def changed(self) -> str:
        """The verdicts on improvements that differ from that on the letter under the same rule."""
        found = []
        for improvement, by_rule in self.improved.items():
            for rule, cases in by_rule.items():
                if (changed := verdict(cases)) != self.verdict(rule):
                    where = f" ({RULE_NAMES[rule]})" if len(by_rule) > 1 else ""
                    found.append(f"{IMPROVEMENT_NAMES[improvement]}{where}: {changed}")
        return ". ".join(found)


def judge_all(table: Table) -> list[Judgement]:
    """Every claim that the problems that were run allow to judge."""
    found = []
    for claim in CLAIMS:
        if claim.can_be_judged(table.problems):
            cases = {rule: claim.judge(table, rule) for rule in claim.rules}
            improved: dict[Improvement, dict[Rule, list[Case]]] = {}
            for improvement in claim.improvements:
                better = replace(table, improvement=improvement)
                rules = claim.rules if improvement == "balanced" else claim.rules[:1]
                improved[improvement] = {rule: claim.judge(better, rule) for rule in rules}
            found.append(Judgement(claim, cases, improved))
    return found


def claims_markdown(table: Table, versions: list[str], seconds: float) -> str:
    """The whole page."""
    judged = judge_all(table)
    lines = ["# The paper's claims, judged", ""]
    lines += _origin(table, versions, seconds)
    lines += ["## Verdicts", ""]
    lines += [
        "On the paper's method by its letter, for each way to choose ρ; the last column has the verdicts that an "
        "improvement in the place of its sparse solver changes. “Undecidable” is what no result could have decided "
        f"otherwise: a comparison of two methods that are lost (at most {100 * LOST:g} %, as by guessing), or a fall "
        "from a height that is less than the fall.",
        "",
    ]
    lines += _markdown_table(
        ("", "claim", *(RULE_NAMES[rule] for rule in RULES), "changed by an improvement"),
        [(str(k), j.claim.title, *(j.verdict(rule) for rule in RULES), j.changed()) for k, j in enumerate(judged, 1)],
    )
    missing = [claim.title for claim in CLAIMS if not claim.can_be_judged(table.problems)]
    if missing:
        lines += [f"Not judged, as they need problems that were not run: {'; '.join(missing)}.", ""]
    lines += ["## ρ", ""]
    lines += _rhos(table)
    lines += ["## Accuracy at the end", ""]
    lines += _accuracies(table)
    lines += ["## What decides each claim", ""]
    for k, judgement in enumerate(judged, 1):
        lines += _details(k, judgement)
    return "\n".join(lines)


def _origin(table: Table, versions: list[str], seconds: float) -> list[str]:
    problems = ", ".join(TITLES[problem] for problem in table.problems)
    lines = [
        f"Generated from {len(table.seeds)} instances (seeds {table.seeds.start} to {table.seeds.stop - 1}) of "
        f"{problems}; {seconds / 60:.0f} minutes of processor time.",
        "Accuracy is the mean over instances of right matches / 10; in brackets the 95 % bootstrap interval. “At the "
        f"end” is at {MOST_SAMPLES:,} sampled hyper-edges. The paper's method is |R₂ₙ,₂ₙ| of QR with tensor power "
        "iteration, sparse (ℓ¹ rows of the source) unless dense is said. The balanced solver normalises rows and "
        "columns where there are as many source as target points, on the same tensors with the same ρ; with outliers "
        "it is the paper's. The default pipeline is the joint residual with the discrete ascent, on the same sampled "
        "hyper-edges.",
        "",
    ]
    for text in versions:
        names = json.loads(text)
        lines += ["Versions: " + ", ".join(f"{name} {value}" for name, value in names.items()) + ".", ""]
    return lines


def _rhos(table: Table) -> list[str]:
    problems = table.rhos.problems
    count = sum(len(SCAN_SETTINGS[problem]) for problem in problems)
    lines = [
        f"Chosen on {', '.join(f'{k} ({residual})' for residual, k in SCAN_INSTANCES.items())} instances, seeds from "
        f"{SCAN_SEED} on, which are not reported, of "
        f"each of {count} settings of {', '.join(TITLES[p] for p in problems)} at {SCAN_SAMPLES:,} samples: "
        "the highest mean accuracy of the sparse solver, of equals the smallest. In brackets the accuracy of the scan, "
        "and on what share of resampled scenes the same ρ is chosen, with the next most frequent choice.",
        "",
    ]
    rows = []
    for residual in RESIDUALS:
        for rule in RULES:
            rows.append((residual, RULE_NAMES[rule], *(_choice(table, residual, p, rule) for p in problems)))
    return lines + _markdown_table(("residual", "ρ", *(TITLES[p] for p in problems)), rows)


def _choice(table: Table, residual: str, problem: str, rule: Rule) -> str:
    """The chosen ρ, its accuracy in the scan, and how firm the choice is."""
    chosen = table.rhos.chosen(residual, problem, rule)
    choices = table.rhos.choices(residual, problem, rule)
    height = table.rhos.curve(residual, problem, rule).max()
    firm = f"{100 * choices.get(chosen, 0.0):.0f} % of resamples"
    others = [rho for rho in choices if rho != chosen]
    other = f", else {others[0]:.0e}" if others else ""
    return f"{chosen:.0e} ({100 * height:.1f} %; {firm}{other})"


def _accuracies(table: Table) -> list[str]:
    """The solvers and the default pipeline at the end, and the residuals where they can be compared, in per cent."""
    ends: list[tuple[str, ...]] = []
    residuals: list[tuple[str, ...]] = []
    for panel in (panel for problem in table.problems for panel in PANELS[problem]):
        for setting in panel.settings:
            pipeline = estimate(table.default(setting))
            ends.append(
                (
                    panel.label,
                    str(setting),
                    _by_rule(table, setting, SPARSE),
                    _by_rule(table, setting, BALANCED),
                    _by_rule(table, setting, DENSE),
                    f"{100 * pipeline.mean:.0f} [{100 * pipeline.low:.0f}, {100 * pipeline.high:.0f}]",
                )
            )
            three = [
                _by_rule(table, setting, SPARSE, residual, COMMON_SAMPLES)
                for residual in RESIDUALS
                if residual != "svd" or has_svd(setting)
            ]
            residuals.append((panel.label, str(setting), *three, *([""] * (len(RESIDUALS) - len(three)))))
    return [
        f"Per cent at {MOST_SAMPLES:,} samples; three figures are: {' / '.join(RULE_NAMES[rule] for rule in RULES)}.",
        "",
        *_markdown_table(("panel", "setting", "sparse", "balanced", "dense", "default pipeline"), ends),
        f"The residuals of the paper with the sparse solver at {COMMON_SAMPLES:,} samples, likewise.",
        "",
        *_markdown_table(("panel", "setting", *RESIDUALS), residuals),
    ]


def _by_rule(table: Table, setting: Setting, solver: str, residual: str = "qr", samples: int = MOST_SAMPLES) -> str:
    """Mean accuracies in per cent with ρ chosen by each rule."""
    means = [100 * table.paper(setting, solver, rule, samples, residual).mean() for rule in RULES]
    return " / ".join(f"{mean:.0f}" for mean in means)


def _details(number: int, judgement: Judgement) -> list[str]:
    claim = judgement.claim
    lines = [f"### {number}. {claim.title}", "", f"> “{claim.quotation}”", "", f"Rule: {claim.rule}", ""]
    for rule, cases in judgement.cases.items():
        head = f"{RULE_NAMES[rule]}: **{verdict(cases)}**" if len(judgement.cases) > 1 else f"**{verdict(cases)}**"
        lines += [head[0].upper() + head[1:], ""]
        lines += _cases(cases)
    for improvement, by_rule in judgement.improved.items():
        for rule, cases in by_rule.items():
            where = f", {RULE_NAMES[rule]}" if len(by_rule) > 1 else ""
            lines += [f"With the {IMPROVEMENT_NAMES[improvement]}{where}: **{verdict(cases)}**", ""]
            if verdict(cases) != judgement.verdict(rule):
                lines += _cases(cases)
    return lines


def _cases(cases: list[Case]) -> list[str]:
    words = {True: "yes", False: "no", None: "undecidable"}
    return _markdown_table(("case", "holds", "figures"), [(c.name, words[c.holds], c.figures) for c in cases])


def _markdown_table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> list[str]:
    def line(cells: tuple[str, ...]) -> str:
        # A bar inside a cell would end it.
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

    return [line(head), "|" + "---|" * len(head), *(line(row) for row in rows), ""]
