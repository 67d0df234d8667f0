"""Estimation of σ for ``noise="auto"``: match with an initial σ, take the residuals of the inliers, match again."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.backends import cpu
from rootmatch.deadline import OutOfTime
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.image_decision import is_modelled
from rootmatch.explain.task import MatchingTask
from rootmatch.explain.zoom_hypotheses import make_candidate
from rootmatch.hypergraph.affinity import Residual
from rootmatch.hypergraph.enumeration import farthest_point_order
from rootmatch.hypergraph.random_tuples import permuted_tuples
from rootmatch.model.evidence import weigh_poses
from rootmatch.model.proposals import Proposals
from rootmatch.samplers.guided.sampler import pays

FIRST_GUESS = 0.004
"""σ of the first match over the diagonal of the image points: 2 pixels of 500. A round value, generous on purpose."""
CUT = 9.0
"""Squared residual beyond which all count alike: three deviations."""
WITHIN = 1.5
"""Factor within which σ is to be as often as possible."""
CENTRE = 4.0 * math.log(WITHIN) / (WITHIN**2 - WITHIN**-2)
"""Of χ² over its degrees of freedom, for that: 0.90, whatever they are, as F(c k² ν) − F(c ν / k²) is largest there."""
SUBSETS = 2000
"""Hyper-edges of one motion that are evaluated, at most."""
SETTLED, ROUNDS = 1.15, 5
"""Factor by which a guess may be off, and matches at most (`benchmarks/noise_estimation.py`)."""
ROUND = 0.5
"""Share of the time left at a deadline for each of those matches."""
RUNGS = (0.25, 1.0, 1.0 / 16.0)
"""First guesses of σ over the generous one, in the order in which they are searched with: detectors are often that
good."""
GROWTH = 4
BUDGETS = tuple(8_000_000 * GROWTH**k for k in range(3))
"""Evaluations that a search with a first guess may take, in turn; of all of them together as many as a search with the
noise stated. 60 points of which 20 are seen take 2 to 17 million with the noise stated, and 500 million at ten times
that (`benchmarks/targets.py --sizes 60 --seen 20`)."""
HALVINGS = 9
"""Of the range of σ² beside a noise of the model, in its logarithm: to within 3 %. A round value."""
MINIMUM = 1e-3
"""Smallest σ relative to the first guess: exact data have none."""


def estimate_noise_and_solve(task: MatchingTask, solve: Callable[[MatchingTask], Finding]) -> Finding:
    """The finding at a σ that is consistent with its own residuals; ``solve`` finds that of a known σ."""
    images = [task.image[0][task.camera_of == k] for k in np.unique(task.camera_of)]
    first = FIRST_GUESS * max(float(np.linalg.norm(np.ptp(image, axis=0))) for image in images)  # by the widest
    found, budget = _try_first_guesses(task, solve, first)
    match, guess = found[0]
    known = [one.assignment for one, _ in found]
    for _ in range(ROUNDS):
        try:
            sigma = estimate_noise(match, guess, known)
        except OutOfTime:
            break
        if math.isnan(sigma) or task.deadline.passed():
            break
        sigma = min(max(sigma, MINIMUM * first), 4.0 * first)
        if max(sigma / guess, guess / sigma) < SETTLED:
            break
        guess = sigma
        found_before = None if budget is None else np.array(known)  # a search that begins with them may end at once
        match = solve(replace(_round_task(task, guess), budget=budget, found_before=found_before))
        known.append(match.assignment)
        budget = None if budget is None else max(budget - match.evaluated, BUDGETS[0])
    return match


def _try_first_guesses(
    task: MatchingTask, solve: Callable[[MatchingTask], Finding], generous: float
) -> tuple[list[tuple[Finding, float]], int | None]:
    """Findings to begin with and the σ of each, the one to go on with first; and the budget of all later searches.

    The more generous σ, the less tells a hypothesis from chance: a search may then miss the right pose, of which the
    image is far more probable at a smaller σ, or a long one end by its budget where one with a smaller σ ends at once.
    So several σ are tried, and a long search is cut short and the next σ tried before more is spent. It ends when the
    body is beyond chance.
    """
    widest = _round_task(task, generous)
    known = task.prior_pose is not None or task.known is not None
    alone = known or task.options.chosen_sampler != "auto" or task.options.motions != 1
    by_search = not alone and task.rig is None and pays(widest.sampling_task)
    if alone or not (by_search or is_modelled(task)):
        return [(solve(widest), generous)], None
    if not by_search:
        every = [(solve(_round_task(task, rung * generous)), rung * generous) for rung in RUNGS]
        return sorted(every, key=_sort_key), None
    found: dict[float, Finding] = {}
    for budget in BUDGETS:
        for rung in RUNGS:
            if rung in found and found[rung].evaluated < budget / GROWTH:
                continue  # that search ended by itself
            found[rung] = solve(replace(_round_task(task, rung * generous), budget=budget))
            if found[rung].status or task.deadline.passed():
                return [(found[rung], rung * generous)], BUDGETS[-1]
        every = sorted([(one, rung * generous) for rung, one in found.items()], key=_sort_key)
        if every[0][0].status is not Status.UNTRUSTED:
            break  # which pose it is, a better σ may tell
    return every, BUDGETS[-1]


def _sort_key(one: tuple[Finding, float]) -> float:
    """By which findings are sorted, those that explain most first."""
    return -(one[0].log_odds or 0.0)


def _round_task(task: MatchingTask, sigma: float) -> MatchingTask:
    """The task with a guess of σ and a part of the remaining time."""
    return replace(task.with_noise(sigma), deadline=task.deadline.part(ROUND))


def estimate_noise(match: Finding, sigma: float, known: Sequence[Integers]) -> float:
    """σ from the residuals inside an assignment that was found with ``sigma``; NaN if there are too few.

    ``known``: what was found at other σ, and may be right in its place.

    If the problem fits poses, σ follows from χ² of the points of each motion about their best pose. Otherwise it is the
    scale at which the squared residuals of their hyper-edges, cut off at 9, have the mean of their distribution.
    """
    problem = match.task.problem
    squares, freedom = [], []
    labels = range(int(match.motion_labels.max(initial=-1)) + 1)
    groups = [np.flatnonzero((match.motion_labels == label) & (match.assignment >= 0)) for label in labels]
    for members in groups:
        if len(members) <= problem.order:
            continue
        scale = _scale(match, members, sigma, known)
        if math.isfinite(scale):
            squares.append(scale * (len(members) - problem.minimal))
            freedom.append(len(members) - problem.minimal)
    if not freedom:
        return math.nan
    return sigma * math.sqrt(sum(squares) / sum(freedom))


def _scale(match: Finding, members: Integers, sigma: float, known: Sequence[Integers]) -> float:
    """Square of the ratio of the true σ to the assumed one, estimated from one group."""
    problem, points = match.task.problem, match.task.points
    one_motion = replace(match.task, options=replace(match.task.options, motions=1))
    if is_modelled(one_motion):
        alone = np.full_like(match.assignment, -1)
        alone[members] = match.assignment[members]
        assignments = [alone]
        if len(members) == (match.assignment >= 0).sum():
            # if σ is far too large, a wrong assignment can seem as good as the right one, which fits far better
            assignments += [other for other in match.others if (other >= 0).sum() >= len(members)]
            assignments += [other for other in known if (other >= 0).sum() > match.task.minimal]
        return _image_scale(one_motion, np.array(assignments), sigma) / CENTRE
    if match.noise_factor is not None:
        return max(match.noise_factor, MINIMUM) ** 2 / CENTRE
    order = members[farthest_point_order(points.source[members])]
    tables = problem.tables(points.subset(order, match.assignment[order]))
    rng = np.random.default_rng(0)
    chosen = np.sort(permuted_tuples(rng, SUBSETS, len(members), problem.order), axis=1)
    residuals = cpu.residuals(tables, Residual("joint").kernel_kind(problem.pair_count), chosen, chosen)
    return solve_scale(residuals**2, truncated_mean(problem.constraints))


def _image_scale(task: MatchingTask, assignments: Integers, sigma: float) -> float:
    """As `_scale`, from the assignment (of K, n) whose pose explains most, each with the noise about its own pose."""
    proposals, found, _ = make_candidate(task, []).fit(assignments)
    scale = np.maximum(found.squared / found.freedom, MINIMUM**2)
    if task.points.source_covariance is not None:
        scale = np.array([_scale_given_source(task, proposals.take(np.array([k])), sigma) for k in range(len(scale))])
    if len(scale) < 2:
        return float(scale[0]) if len(scale) else math.nan
    explained = []
    for k, each in enumerate(sigma * np.sqrt(scale)):
        at_own_noise, _ = weigh_poses(
            make_candidate(task.with_noise(float(each)), []).model, *proposals.take(np.array([k]))
        )
        explained.append(float(at_own_noise.log_odds[0]))
    return float(scale[int(np.argmax(explained))])


def _scale_given_source(task: MatchingTask, proposal: Proposals, sigma: float) -> float:
    """As `_image_scale`, of one assignment with its pose, where a part of the residuals is noise of the model."""
    low, high = MINIMUM**2, 1.0 / MINIMUM**2
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        found, _ = weigh_poses(make_candidate(task.with_noise(sigma * math.sqrt(middle)), []).model, *proposal)
        low, high = (middle, high) if found.squared[0] > found.freedom[0] else (low, middle)
    return math.sqrt(low * high)


def truncated_mean(freedom: int) -> float:
    """Mean of min(χ², CUT) with so many degrees of freedom."""
    from scipy.special import gammainc  # slow to import, rarely needed

    below, weighted = (float(gammainc(0.5 * k, 0.5 * CUT)) for k in (freedom, freedom + 2))
    return freedom * weighted + CUT * (1.0 - below)


def solve_scale(squared: Floats, mean: float) -> float:
    """The s with mean(min(squared / s, CUT)) = mean, by bisection."""
    low, high = 1e-12, 1e12
    for _ in range(100):
        middle = math.sqrt(low * high)
        if float(np.minimum(squared / middle, CUT).mean()) > mean:
            low = middle
        else:
            high = middle
    return math.sqrt(low * high)
