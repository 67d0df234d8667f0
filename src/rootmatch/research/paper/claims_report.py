"""``claims.md``: which of the paper's claims hold, with the figures that decide them."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

from rootmatch.research.bootstrap import estimate
from rootmatch.research.output_files import count_text, markdown_table
from rootmatch.research.paper.claims import CLAIMS, Claim
from rootmatch.research.paper.plan import BALANCED, DENSE, DENSE_START, VARIANT_NAMES, Table, Variant
from rootmatch.research.paper.rho import ALL_RULES, CONDITIONS, RULE_NAMES, RULES, SCAN_SOLVERS, SPARSE, START, Rule
from rootmatch.research.paper.settings import PANELS, SCAN_SETTINGS, TITLES, Setting, has_svd
from rootmatch.research.paper.verdict import LOST, Case, verdict

COMPARED = ("qr", "qr-both", "svd")
"""Residuals that are compared at one sample size."""
COLUMNS: tuple[tuple[Variant, Rule], ...] = tuple((v, rule) for v in ("text", "published") for rule in RULES)
"""Of the verdicts: the two solvers that may be the paper's, each with both choices of one ρ."""


@dataclass(frozen=True)
class Judgement:
    """A claim and its cases, for each variant of the method and each way to choose ρ.

    The default pipeline has no ρ to choose; its cases stand under the first rule.
    """

    claim: Claim
    cases: dict[tuple[Variant, Rule], list[Case]]

    def verdict(self, rule: Rule = "paper", variant: Variant = "text") -> str:
        """The verdict on a variant under a rule; empty if the claim is not judged for them."""
        return verdict(self.cases[variant, rule]) if (variant, rule) in self.cases else ""

    def changed_verdicts(self) -> str:
        """The verdicts on the other variants that differ from that on the text under the same rule."""
        found = []
        for variant, rule in self.cases:
            said = self.verdict(rule, variant)
            if variant not in ("text", "published") and said != self.verdict(rule):
                where = f" ({RULE_NAMES[rule]})" if (variant, RULES[1]) in self.cases else ""
                found.append(f"{VARIANT_NAMES[variant]}{where}: {said}")
        return ". ".join(found)


def judge_all(table: Table) -> list[Judgement]:
    """Every claim that can be judged by the problems that were run."""
    found = []
    for claim in CLAIMS:
        if claim.can_be_judged(table.problems):
            cases: dict[tuple[Variant, Rule], list[Case]] = {}
            for variant in ("text", *claim.variants):
                for rule in claim.rules if variant != "pipeline" else claim.rules[:1]:
                    cases[variant, rule] = claim.judge(replace(table, variant=variant), rule)
            found.append(Judgement(claim, cases))
    return found


def claims_markdown(table: Table, versions: list[str], seconds: float) -> str:
    """The whole page."""
    judged = judge_all(table)
    lines = ["# The paper's claims, judged", ""]
    lines += _origin(table, versions, seconds)
    lines += ["## Verdicts", ""]
    lines += [
        "Each claim is judged for the solver of the paper's text and for the solver of the code that the paper used, "
        "with two choices of one ρ. The last column lists the verdicts that change if something else is replaced. "
        "“Undecidable” means that no result could have decided it otherwise: two methods at chance level "
        f"(at most {100 * LOST:g} %) cannot be compared, and an accuracy cannot fall by more than it was. "
        "† A threshold of ours decides: the paper shows plots, which we could not see, and gives no number.",
        "",
    ]
    head = ("", "claim", *(f"{VARIANT_NAMES[v]}, {RULE_NAMES[rule]}" for v, rule in COLUMNS), "changed by")
    rows = [
        (
            str(k),
            j.claim.title + (" †" if j.claim.ours else ""),
            *(j.verdict(r, v) for v, r in COLUMNS),
            j.changed_verdicts(),
        )
        for k, j in enumerate(judged, 1)
    ]
    lines += markdown_table(head, rows)
    missing = [claim.title for claim in CLAIMS if not claim.can_be_judged(table.problems)]
    if missing:
        lines += [f"Not judged, because they need problems that were not run: {'; '.join(missing)}.", ""]
    lines += ["## Which solver the results speak for", ""]
    lines += _solvers(judged)
    lines += ["## ρ", ""]
    lines += _rhos(table)
    lines += ["## Accuracy at the largest sample", ""]
    lines += _accuracies(table)
    lines += ["## What decides each claim", ""]
    for k, judgement in enumerate(judged, 1):
        lines += _details(k, judgement)
    return "\n".join(lines)


def _origin(table: Table, versions: list[str], seconds: float) -> list[str]:
    problems = ", ".join(TITLES[problem] for problem in table.problems)
    effort, minutes = table.effort, count_text(round(seconds / 60.0), "minute")
    minutes = "less than a minute" if seconds < 60.0 else minutes
    lines = [
        f"Generated from {count_text(len(table.seeds), 'instance')} (seeds {table.seeds.start} to "
        f"{table.seeds.stop - 1}) of {problems}; {minutes} of processor time.",
        "Accuracy is the mean over instances of correct matches / 10; the 95 % bootstrap interval is in brackets. "
        f"Unless a sample size is named, it is {effort.maximum:,} hyper-edges.",
        "",
    ]
    if effort.quick:
        lines += [
            "**A quick run.** It leaves out the samples above 10⁵ hyper-edges, where the paper's curves end, and every "
            f"second ρ of the scan; residuals are compared at {effort.common:,} samples. With so few instances many "
            "intervals are too wide to decide anything: read the intervals, not the verdicts.",
            "",
        ]
    lines += [
        "The paper's method is |R₂ₙ,₂ₙ| of QR with tensor power iteration, sparse (ℓ¹ rows of the source) unless dense "
        "is said, and 3P1 is written in cos θ. The *solver of the text* multiplies and normalises, as in the paper's "
        "reference; the *published solver* also adds the start value to each iterate, as the public copies of its "
        "authors' code do. The *balanced solver* normalises rows and columns if there are as many source as target "
        "points, on the tensors of the solver of the text; with outliers it is that solver. The *default pipeline* is "
        "the joint residual with the discrete ascent, on the same sampled hyper-edges.",
        "",
        "Chosen by us, since the paper does not say: the values of σ between 0.1 and 1 px, and those with outliers; "
        "the sample sizes; how often a repeated hyper-edge counts; that weights below 10⁻¹² are dropped; "
        "and that an entry of X without any hyper-edge to support it is set to 0 before the assignment, so that an "
        "empty tensor matches nothing, where the Hungarian method alone would match at chance level.",
        "",
    ]
    for text in versions:
        names = json.loads(text)
        lines += ["Versions: " + ", ".join(f"{name} {value}" for name, value in names.items()) + ".", ""]
    return lines


def _solvers(judged: list[Judgement]) -> list[str]:
    """How many claims hold with either solver; those that need no solver of the paper's are left out."""
    both = [j for j in judged if all(column in j.cases for column in COLUMNS)]
    counts = {}
    for variant, rule in COLUMNS:
        said = [j.verdict(rule, variant) for j in both]
        words = sum(v.startswith("holds") and not v.startswith("holds only") for v in said)
        part = sum(v.startswith("holds only") for v in said)
        counts[variant, rule] = (str(words), str(part), str(len(said) - words - part))
    lines = [
        f"Of {len(both)} claims about the paper's method, for each solver and choice of ρ:",
        "",
        *markdown_table(
            ("solver", "ρ", "hold", "hold in part", "do not hold, or undecidable"),
            [(VARIANT_NAMES[v], RULE_NAMES[rule], *counts[v, rule]) for v, rule in COLUMNS],
        ),
    ]
    apart = [j for j in both if j.verdict("paper", "text") != j.verdict("paper", "published")]
    if apart:
        lines += ["Judged differently with the ρ that the paper needs:", ""]
        for j in apart:
            lines += [f"* {j.claim.title}: {j.verdict()} (text), {j.verdict('paper', 'published')} (published)"]
        lines += [""]
    return lines


def _rhos(table: Table) -> list[str]:
    rhos, effort = table.rhos, table.effort
    count = sum(len(SCAN_SETTINGS[problem]) for problem in rhos.problems)
    of_qr = count_text(len(effort.scan_seeds("qr")), "instance")
    said = "; ".join(CONDITIONS[problem][2] for problem in rhos.problems)
    lines = [
        f"The paper gives no value. Here ρ is chosen among {len(effort.grid)} values on seeds that are not reported, "
        f"from {effort.scan_seeds('qr').start:,} on: {of_qr} of each of {count} "
        f"settings at {effort.scan_samples('qr'):,} samples ({len(effort.scan_seeds('svd'))} at "
        f"{effort.scan_samples('svd'):,} for qr-both and svd).",
        "",
        f"*{RULE_NAMES['paper']}*: among the values that meet what the paper says of its noise-free results ({said}), "
        "the one with the highest mean accuracy. If no value meets all of it, those that meet most are admitted. "
        f"*{RULE_NAMES['one']}*: the highest mean accuracy. The last two columns have a ρ for each problem. "
        "In brackets: the accuracy of the scan, and the share of resampled scenes on which the same ρ is chosen, with "
        "the next most frequent choice.",
        "",
    ]
    rows = []
    for solver in SCAN_SOLVERS:
        for residual in (*COMPARED, *(("tan",) if solver == SPARSE and "3p1" in rhos.problems else ())):
            for rule in ALL_RULES:
                problems = [p for p in rhos.problems if rule in RULES or (residual, solver, p) in rhos.whole]
                shown = problems[:1] if rule in RULES else problems
                cells = [_choice(table, residual, solver, p, rule) for p in shown]
                names = ["all"] if rule in RULES else [TITLES[p] for p in shown]
                rows += [(solver, residual, RULE_NAMES[rule], n, c) for n, c in zip(names, cells, strict=True)]
    lines += markdown_table(("solver", "residual", "rule", "problem", "ρ"), rows)
    lines += ["Which values meet what the paper says, with |R₂ₙ,₂ₙ| of QR:", ""]
    for solver in SCAN_SOLVERS:
        met = rhos.met("qr", solver)
        for problem, which in met.items():
            values = ", ".join(f"{rho:.0e}" for rho, yes in zip(effort.grid, which, strict=True) if yes)
            lines += [f"* {solver}, {CONDITIONS[problem][2]}: {values or 'none'}"]
        every = [rho for k, rho in enumerate(effort.grid) if all(which[k] for which in met.values())]
        lines += [f"* {solver}, all of these: {', '.join(f'{rho:.0e}' for rho in every) or 'none'}"]
    return [*lines, ""]


def _choice(table: Table, residual: str, solver: str, problem: str, rule: Rule) -> str:
    """The chosen ρ, its accuracy in the scan, and how firm the choice is."""
    rhos = table.rhos
    chosen = rhos.choose_rho(residual, problem, rule, solver)
    choices = rhos.choices(residual, problem, rule, solver)
    height = rhos.curve(residual, problem, rule, solver)[table.effort.grid.index(chosen)]
    firm = f"{100 * choices.get(chosen, 0.0):.0f} % of resamples"
    others = [rho for rho in choices if rho != chosen]
    other = f", else {others[0]:.0e}" if others else ""
    return f"{chosen:.0e} ({100 * height:.1f} %; {firm}{other})"


def _accuracies(table: Table) -> list[str]:
    """The solvers and the default pipeline, and the residuals at the size at which they are compared, in per cent."""
    ends: list[tuple[str, ...]] = []
    residuals: list[tuple[str, ...]] = []
    other = replace(table, variant="tan")
    for panel in (panel for problem in table.problems for panel in PANELS[problem]):
        for setting in panel.settings:
            pipeline = estimate(table.default(setting))
            ends.append(
                (
                    panel.label,
                    str(setting),
                    _format_with_interval(table, setting),
                    _format_with_interval(replace(table, variant="published"), setting),
                    *(_format_by_rule(table, setting, solver) for solver in (DENSE, DENSE_START, BALANCED)),
                    _format_by_rule(other, setting, SPARSE) if setting.problem == "3p1" else "",
                    f"{100 * pipeline.mean:.0f} [{100 * pipeline.low:.0f}, {100 * pipeline.high:.0f}]",
                )
            )
            each = [
                _format_by_rule(table, setting, solver, residual, table.effort.common)
                if residual != "svd" or has_svd(setting)
                else ""
                for residual in COMPARED
                for solver in (SPARSE, START)
            ]
            residuals.append((panel.label, str(setting), *each))
    two = " / ".join(RULE_NAMES[rule] for rule in RULES)
    return [
        f"Per cent; two figures are: {two}.",
        "",
        *markdown_table(
            (
                "panel",
                "setting",
                "sparse, text",
                "sparse, published",
                "dense, text",
                "dense, published",
                "balanced",
                "text, 3P1 by tan(θ/2)",
                "default pipeline",
            ),
            ends,
        ),
        f"The residuals of the paper with both sparse solvers at {table.effort.common:,} samples, likewise.",
        "",
        *markdown_table(
            ("panel", "setting", *(f"{r}, {how}" for r in COMPARED for how in ("text", "published"))), residuals
        ),
    ]


def _format_with_interval(table: Table, setting: Setting) -> str:
    """Mean accuracies of the sparse solver in per cent with ρ chosen by each rule, and their intervals."""
    found = [estimate(table.paper(setting, rule=rule)) for rule in RULES]
    return " / ".join(f"{100 * e.mean:.0f} [{100 * e.low:.0f}, {100 * e.high:.0f}]" for e in found)


def _format_by_rule(
    table: Table, setting: Setting, solver: str, residual: str = "qr", samples: int | None = None
) -> str:
    """Mean accuracies in per cent with ρ chosen by each rule."""
    means = [100 * table.paper(setting, solver, rule, samples, residual).mean() for rule in RULES]
    return " / ".join(f"{mean:.0f}" for mean in means)


def _details(number: int, judgement: Judgement) -> list[str]:
    claim = judgement.claim
    lines = [f"### {number}. {claim.title}", "", f"> “{claim.quotation}”", "", f"Rule: {claim.rule}", ""]
    if claim.ours:
        lines += [f"A threshold of ours: {claim.ours}. We could not see the paper's plots.", ""]
    for (variant, rule), cases in judgement.cases.items():
        said = verdict(cases)
        name = f"{VARIANT_NAMES[variant]}, {RULE_NAMES[rule]}" if variant != "pipeline" else VARIANT_NAMES[variant]
        lines += [f"{name[0].upper()}{name[1:]}: **{said}**", ""]
        if variant in ("text", "published") or said != judgement.verdict(rule):
            words = {True: "yes", False: "no", None: "undecidable"}
            rows = [(case.name, words[case.holds], case.figures) for case in cases]
            lines += markdown_table(("case", "holds", "figures"), rows)
    return lines
