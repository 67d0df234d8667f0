"""The paper's statements about its experiments, in its order, each tied to the rule that decides it."""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.research.paper import judges
from rootmatch.research.paper.judges import LONG, Judge
from rootmatch.research.paper.plan import Variant
from rootmatch.research.paper.rho import RULES, Rule
from rootmatch.research.paper.settings import OUTLIERS, PROBLEMS
from rootmatch.research.paper.verdict import EQUAL, FULL, GOOD, RAPID


@dataclass(frozen=True)
class Claim:
    """A statement of the paper."""

    title: str
    quotation: str
    """The paper's words."""
    rule: str
    """What decides each case."""
    problems: tuple[str, ...]
    """Those that must have been run; for some claims any one of them."""
    judge: Judge
    """The cases, from a table and the rule by which ρ is chosen."""
    rules: tuple[Rule, ...] = RULES
    """The ways to choose ρ, or one where it plays no part."""
    any_problem: bool = False
    """Whether one of the problems is enough."""
    variants: tuple[Variant, ...] = ("published", "balanced", "pipeline")
    """Beside the solver of the text, for which the claim can be judged as well."""
    ours: str = ""
    """The threshold of ours that decides, in words; empty if the paper's own words do."""

    def can_be_judged(self, problems: tuple[str, ...]) -> bool:
        """Whether the problems that were run suffice."""
        given = [problem in problems for problem in self.problems]
        return any(given) if self.any_problem else all(given)


_WITH_TAN: tuple[Variant, ...] = ("published", "tan", "balanced", "pipeline")
_EQUAL = f"a difference of {100 * EQUAL:g} points counts as none"
_GOOD = f"{100 * GOOD:g} % counts as good"
_RAPID = f"a fall of {100 * RAPID:g} points counts as rapid"

CLAIMS: tuple[Claim, ...] = (
    Claim(
        "One ρ serves all problems",
        "The parameter ρ was set empirically in our experiments and kept constant for all the instances and problems.",
        f"For each problem, a ρ of its own, one with noise and one without, gains at most {100 * EQUAL:g} points on "
        "average over its settings.",
        PROBLEMS,
        judges.judge_one_rho,
        any_problem=True,
        variants=("published", "balanced"),
        ours=_EQUAL,
    ),
    Claim(
        "QR and SVD do equally well",
        "we experimented with both methods for computing the resultant value and found them to perform equally well",
        f"In each panel without outliers, at the sample size at which residuals are compared, the interval of the "
        f"paired difference lies within ±{100 * EQUAL:g} points.",
        PROBLEMS,
        judges.judge_qr_equals_svd,
        any_problem=True,
        variants=("published", "balanced"),
        ours=_EQUAL,
    ),
    Claim(
        "Sparse beats dense",
        "It is clear that the sparse solver performs significantly better than the dense solver.",
        "In each panel, the interval of the paired difference, averaged over settings and sample sizes, lies above 0.",
        PROBLEMS,
        judges.judge_sparse_over_dense,
        any_problem=True,
        variants=("published", "balanced"),
    ),
    Claim(
        "Noise-free P3P reaches 100 % in few samples",
        "For the noise-free case (σ = 0), we note that the algorithm achieves 100% accuracy in a very small number of "
        "samples",
        f"The mean is at least {100 * FULL:g} % at 10⁵ samples and above.",
        ("p3p",),
        judges.judge_few_samples,
        ours="10⁵ samples count as few",
    ),
    Claim(
        "P3P: more noise needs more samples",
        "noise in the image coordinates interferes with the geometric constraints and hence many more samples are "
        "required",
        "From each σ to the next, the accuracy averaged over sample sizes falls: the interval of the paired fall lies "
        "above 0.",
        ("p3p",),
        judges.judge_noise_needs_samples,
    ),
    Claim(
        "P3P with noise stays under 100 %",
        "the curves asymptote at less [than] 100% accuracy",
        f"For each σ > 0, the mean is below {100 * FULL:g} %.",
        ("p3p",),
        judges.under_full,
    ),
    Claim(
        "… because geometry can do no better",
        "because of the inability of purely geometric constraints derived from noisy observations being able to guide "
        "the matching process",
        f"For each σ > 0, another method that uses only the same hyper-edges (the default pipeline) also stays below "
        f"{100 * FULL:g} %.",
        ("p3p",),
        judges.geometry_is_to_blame,
        rules=("paper",),
        variants=(),
    ),
    Claim(
        "P3P handles many outliers without noise",
        "the approach can handle a large number of outliers in noise-free case",
        f"The mean is at least {100 * GOOD:g} % with 5 and with 10 outliers.",
        ("p3p",),
        judges.handles_outliers,
        ours=_GOOD,
    ),
    Claim(
        "P3P degrades rapidly with outliers and noise",
        "but the performance degrades rapidly when combined with image noise",
        f"From σ = 0 to 1 px the mean falls by at least {100 * RAPID:g} points.",
        ("p3p",),
        lambda table, rule: judges.judge_fall(table, rule, "p3p", OUTLIERS, 0.0),
        ours=_RAPID,
    ),
    Claim(
        "3P1: the shorter baseline is more robust to noise",
        "for the smaller baseline, the points are less likely to confuse with each other and are thus more robust to "
        "noise",
        "For each σ > 0, the interval of the paired difference b = 1 minus b = 5 lies above 0.",
        ("3p1",),
        judges.short_is_better,
        variants=_WITH_TAN,
    ),
    Claim(
        "3P1: b = 5 degrades rapidly with noise",
        "For the larger baseline, the performance degrades rapidly with added noise",
        f"From σ = 0 to 1 px the mean falls by at least {100 * RAPID:g} points.",
        ("3p1",),
        lambda table, rule: judges.judge_fall(table, rule, "3p1", (0,), LONG),
        variants=_WITH_TAN,
        ours=_RAPID,
    ),
    Claim(
        "3P1: b = 5 stays under 100 % without noise",
        "and does not reach 100% accuracy even in the noise-free case",
        f"The mean is below {100 * FULL:g} %.",
        ("3p1",),
        judges.long_under_full,
        variants=_WITH_TAN,
    ),
    Claim(
        "… because it is degenerate",
        "indicating likely degenerate conditions for this problem",
        f"Another method that uses only the same hyper-edges (the default pipeline) also stays below {100 * FULL:g} %.",
        ("3p1",),
        judges.long_is_degenerate,
        rules=("paper",),
        variants=(),
    ),
    Claim(
        "3P1: b = 1 is robust against outliers and noise",
        "The method is quite robust against both outliers and image noise for the shorter baseline",
        f"With 5 and 10 outliers and σ of 0.5 and 1 px, the mean is at least {100 * GOOD:g} %.",
        ("3p1",),
        judges.short_is_robust,
        variants=_WITH_TAN,
        ours=_GOOD,
    ),
    Claim(
        "3P1: b = 5 degrades rapidly with outliers and noise",
        "but the performance degrades rapidly for the larger baseline",
        f"From σ = 0 to 1 px the mean falls by at least {100 * RAPID:g} points.",
        ("3p1",),
        lambda table, rule: judges.judge_fall(table, rule, "3p1", OUTLIERS, LONG),
        variants=_WITH_TAN,
        ours=_RAPID,
    ),
    Claim(
        "up2p is more robust to noise than P3P",
        "for the single motion case, this problem has much better noise handling characteristics than the P3P model",
        "For each σ > 0, the interval of the difference up2p minus P3P lies above 0.",
        ("p3p", "up2p"),
        lambda table, rule: judges.judge_up2p_lead(table, rule, (0,), judges.NOISY),
    ),
    Claim(
        "up2p is more robust than P3P with outliers too",
        "this method is more robust than the P3P problem in this evaluation as well",
        "With 5 and 10 outliers at every σ, the interval of the difference up2p minus P3P lies above 0.",
        ("p3p", "up2p"),
        lambda table, rule: judges.judge_up2p_lead(table, rule, OUTLIERS, (0.0, 0.5, 1.0)),
    ),
    Claim(
        "up2p: two motions are less robust than one",
        "For the dual-motion case (…), the noise robustness is poorer",
        "For each σ > 0, the interval of the paired difference one motion minus two lies above 0.",
        ("up2p",),
        judges.two_motions_are_harder,
    ),
    Claim(
        "up2p: two motions and noise are handled well",
        "but the algorithm still shows good performance even with the combination of two motions and image noise",
        f"For each σ > 0, the mean is at least {100 * GOOD:g} %.",
        ("up2p",),
        judges.two_motions_are_good,
        ours=_GOOD,
    ),
)
