"""``claims.md``: what of the paper holds, with the figures that decide it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

from rootmatch.experiments.claims import CLAIMS, Claim
from rootmatch.experiments.plan import COMMON_SAMPLES, DENSE, MOST_SAMPLES, SPARSE, Table
from rootmatch.experiments.rho import RESIDUALS, RULE_NAMES, RULES, SCAN_INSTANCES, SCAN_SAMPLES, SCAN_SEEDS, Rule
from rootmatch.experiments.settings import PANELS, PROBLEMS, SCAN_SETTINGS, TITLES, Setting, has_svd
from rootmatch.experiments.statistics import estimate
from rootmatch.experiments.verdict import Case, verdict


@dataclass(frozen=True)
class Judgement:
    """A claim and, for each way to choose ρ, its cases."""

    claim: Claim
    cases: dict[Rule, list[Case]]

    def verdict(self, rule: Rule) -> str:
        """The verdict under a rule; empty when the claim does not depend on ρ."""
        return verdict(self.cases[rule]) if rule in self.cases else ""


def judge_all(table: Table) -> list[Judgement]:
    """Every claim that the problems that were run allow to judge."""
    return [
        Judgement(claim, {rule: claim.judge(table, rule) for rule in claim.rules})
        for claim in CLAIMS
        if claim.can_be_judged(table.problems)
    ]


def claims_markdown(table: Table, versions: list[str], seconds: float) -> str:
    """The whole page."""
    judged = judge_all(table)
    lines = ["# The paper's claims, judged", ""]
    lines += _origin(table, versions, seconds)
    lines += ["## Verdicts", ""]
    lines += _markdown_table(
        ("", "claim", *(RULE_NAMES[rule] for rule in RULES)),
        [(str(k), j.claim.title, *(j.verdict(rule) for rule in RULES)) for k, j in enumerate(judged, 1)],
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
        "iteration, sparse (ℓ¹ rows) unless dense is said. The default road is the joint residual with the discrete "
        "ascent, on the same sampled hyper-edges.",
        "",
    ]
    for text in versions:
        names = json.loads(text)
        lines += ["Versions: " + ", ".join(f"{name} {value}" for name, value in names.items()) + ".", ""]
    return lines


def _rhos(table: Table) -> list[str]:
    count = sum(len(SCAN_SETTINGS[problem]) for problem in PROBLEMS)
    lines = [
        f"Chosen on {SCAN_INSTANCES} instances (seeds {SCAN_SEEDS.start} to {SCAN_SEEDS.stop - 1}, not reported) of "
        f"each of {count} settings at {SCAN_SAMPLES:,} samples: the highest mean accuracy of the sparse solver, of "
        "equals the smallest. The accuracy of the scan stands in brackets.",
        "",
    ]
    rows = []
    for residual in RESIDUALS:
        for rule in RULES:
            found = [
                (table.rhos.chosen(residual, p, rule), table.rhos.curve(residual, p, rule).max()) for p in PROBLEMS
            ]
            cells = [f"{rho:.0e} ({100 * height:.0f} %)" for rho, height in found]
            rows.append((residual, RULE_NAMES[rule], *cells))
    return lines + _markdown_table(("residual", "ρ", *(TITLES[p] for p in PROBLEMS)), rows)


def _accuracies(table: Table) -> list[str]:
    """Sparse, dense and default road at the end, and the three residuals where they can be compared, in per cent."""
    ends: list[tuple[str, ...]] = []
    residuals: list[tuple[str, ...]] = []
    for panel in (panel for problem in table.problems for panel in PANELS[problem]):
        for setting in panel.settings:
            road = estimate(table.default(setting))
            ends.append(
                (
                    panel.label,
                    str(setting),
                    _by_rule(table, setting, SPARSE),
                    _by_rule(table, setting, DENSE),
                    f"{100 * road.mean:.0f} [{100 * road.low:.0f}, {100 * road.high:.0f}]",
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
        *_markdown_table(("panel", "setting", "qr, sparse", "qr, dense", "default road"), ends),
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
        lines += _markdown_table(
            ("case", "holds", "figures"), [(c.name, "yes" if c.holds else "no", c.figures) for c in cases]
        )
    return lines


def _markdown_table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> list[str]:
    def line(cells: tuple[str, ...]) -> str:
        # A bar inside a cell would end it.
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

    return [line(head), "|" + "---|" * len(head), *(line(row) for row in rows), ""]
