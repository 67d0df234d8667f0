"""Repetition among targets, as rooms of a floor and trees of a street have it: a motion puts many of them near others.

Where the object repeats itself, so does what is beside it, and a labelling that is a period off matches that. Against
clutter that lies anywhere, its matches are worth as much as right ones; but what the other targets and the repetition
predict is no coincidence. So a clutter point may also lie about where the motion puts another one, in one of `WIDTHS`
widths, as crowds lie about other targets: see `rootmatch.model.clutter.Clutter`, of whose forests it is one more kind
of descent. A match is then worth by how much it is nearer to its place than that.

Motions that may repeat the targets are those between rival motions of the object. One counts if targets are more
probable with it by more than the number of motions that can be told apart, which is what it takes to name it. The
source names those that it has itself: what is beside the object is like it as probably as not. So the model with
repetitions is another one beside that without, and their evidence tells.

A search ends with what explains most. Of an object that repeats itself that is where its image overlaps it most, and
the right labelling may be more periods away than any that it found. So the motions between rivals also displace each of
them, again and again: what else there is to choose from.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import checkpoint
from rootmatch.model.clutter import MAXIMUM, STEPS, Clutter
from rootmatch.model.compiled.crowds import fit_crowd_shares
from rootmatch.model.point_set_model import Judged, PointSetModel
from rootmatch.model.priors import ALIKE
from rootmatch.model.targets_box import bounding_box
from rootmatch.problems.pose_fit.point_set_fit import FEWEST
from rootmatch.samplers.point_sets.congruent import grow_labellings, label_by_motions
from rootmatch.samplers.point_sets.motions import Motions

RIVALS = 8
"""Most motions of the object between which repetitions are sought. A round value."""
SHARED = 0.3
"""Share of their matches up to which two labellings are of rival motions. A round value."""
WIDTHS = 12
"""Most widths of a repetition, each half as wide as the one before, down to σ: the first is a quarter of the targets'
spacing. A round value."""
REPETITIONS = 6
"""Most repetitions that are kept. A round value."""
TRIED = np.array([0.25, 0.5, 0.75, 0.9])[:, None, None, None]
"""Shares with which a repetition is tried."""
PSEUDO, PSEUDO_REPEATED = 1.0, 0.1
"""Pseudo-counts of clutter without repetitions and of each of them, as of crowds in space."""
DISPLACED = 64
"""Most displaced labellings that are displaced again. A round value; it bounds time."""
ROUNDS = 4
"""Rounds in which labellings are displaced by the motions between them, as long as that finds more. A round value."""


class Repeated(NamedTuple):
    """A model with repetitions among targets, and what it makes of labellings."""

    model: PointSetModel
    judged: Judged
    log_odds: float
    """Logarithm of how much more probable the targets are with them than without, all of them being clutter."""


def find_repetition(model: PointSetModel, proposals: Judged) -> Repeated | None:
    """The model with the repetitions among targets that labellings point to; None without any.

    Either model may be the right one, and what the object explains repeats as it does itself, so both are weighed.
    """
    rivals = select_rival_motions(proposals)
    if len(rivals) < 2 or len(model.clouds.target) > MAXIMUM:
        return None
    found = _build_repetition(model, proposals.take(rivals))
    if found is None:
        return None
    own = replace(model, repeated=found[0], log_unnamed=found[2])
    every = np.ones((1, len(model.clouds.target)), np.bool_)
    without, with_it = (
        float(one.log_density_of_taken(every, np.zeros(every.shape))[0]) for one in (model.clutter, found[0])
    )
    return Repeated(own, own.judge(proposals.fit.assignments), with_it - without - found[1])


def select_rival_motions(found: Judged, minimum: float = 0.0, maximum: int = RIVALS) -> Integers:
    """Labellings of different motions with more than some log-odds, the best first."""
    assignments, kept = found.fit.assignments, list[int]()
    better = np.flatnonzero(found.log_odds > minimum)
    left = better[np.argsort(-found.log_odds[better], kind="stable")]
    while len(left) and len(kept) < maximum:
        one, others = assignments[left[0]], assignments[left]
        kept.append(int(left[0]))
        fewer = np.minimum((others >= 0).sum(axis=1), int((one >= 0).sum()))
        left = left[((others == one) & (one >= 0)).sum(axis=1) < SHARED * fewer]
    return np.array(kept, np.int64)


def repetition_widths(clutter: Clutter) -> Floats:
    """Widths (W,) of repetitions, from a part of the edge of what each target has of the box down to its noise."""
    spacing = float(clutter.uniform[0] * len(clutter.target)) ** (-1.0 / clutter.target.shape[1])
    every = 0.25 * spacing * 0.5 ** np.arange(WIDTHS)
    return np.asarray(every[: 1 + int((every > np.median(clutter.sigma)).sum())])


def _relative_motions(linear: Floats, shift: Floats, *, of_source: bool) -> tuple[Floats, Floats]:
    """Motions y' = S y + b (G, k, k) and (G, k) from each rival's places to another's, or the same of the source."""
    first, second = np.triu_indices(len(shift), 1)
    if of_source:  # T₁⁻¹ T₂
        back = np.linalg.inv(linear[first])
        return back @ linear[second], (back @ (shift[second] - shift[first])[..., None])[..., 0]
    between = linear[second] @ np.linalg.inv(linear[first])
    return between, shift[second] - (between @ shift[first][..., None])[..., 0]


def _repetition_densities(points: Floats, variance: Floats, motions: tuple[Floats, Floats], widths: Floats) -> Floats:
    """Density (G, W, n, n) of points (n, k) about the others' images, and of these about theirs; 0 about itself."""
    linear, shift = motions
    images, own = points @ linear.swapaxes(1, 2) + shift[:, None], np.arange(len(points))
    squared = ((points[:, None] - images[:, None]) ** 2).sum(axis=3)
    squared[:, own, own] = np.inf
    every = widths[:, None, None] ** 2 + variance[:, None] + variance
    density = np.exp(-0.5 * squared[:, None] / every) / (2.0 * np.pi * every) ** (0.5 * points.shape[1])
    return np.asarray(0.5 * (density + density.swapaxes(2, 3)))  # either of two may be the other's image


def _mixture_log_gains(without: Floats, densities: Floats) -> Floats:
    """By how much points are more probable, (G, W), with some share of densities (G, W, n) than without them, (n,)."""
    return np.asarray((np.log((1.0 - TRIED) + TRIED * (densities / without))).sum(axis=3).max(axis=0))


def _build_repetition(model: PointSetModel, rivals: Judged) -> tuple[Clutter, float, float] | None:
    """Clutter with the repetitions between rivals, and what it takes to name those that the source has not.

    And what it takes to name the first of them without the source. None if there are none.
    """
    clutter, clouds = model.clutter, model.clouds
    target, count, size = clutter.target, len(clutter.target), clutter.target.shape[1]
    widths = repetition_widths(clutter)
    # along the axes of the box, as clutter has them
    middle, axes = model._clutter_space[2:]
    linear, shift = rivals.fit.scale[:, None, None] * rivals.fit.rotation, rivals.fit.shift
    between = _relative_motions(axes.T @ linear, (shift - middle) @ axes, of_source=False)
    # a motion that leaves the middle of the object in its place, or brings it back, is a symmetry of it or of a part,
    # and leads to nothing beside it
    centres = (linear @ clouds.source.mean(axis=0) + shift - middle) @ axes
    first, second = (centres[one] for one in np.triu_indices(len(shift), 1))
    again = (between[0] @ second[..., None])[..., 0] + between[1]
    beside = np.minimum(np.linalg.norm(second - first, axis=1), np.linalg.norm(again - first, axis=1)) > widths[0]
    if not beside.any():
        return None
    between = between[0][beside], between[1][beside]
    kernels = _repetition_densities(target, clutter.sigma**2, between, widths)
    densities = kernels.sum(axis=3) / (count - 1)
    # motions that widths tell apart: places along each axis, and turns
    span = np.ptp(target, axis=0) * (count + 1) / (count - 1)
    radius = math.sqrt(float(((target - target.mean(axis=0)) ** 2).sum(axis=1).mean()))
    cost = np.log(np.maximum(span / widths[:, None], 1.0)).sum(axis=1)
    cost += size * (size - 1) // 2 * np.log(np.maximum(2.0 * math.pi * radius / widths, 1.0))
    # the source shows them as well
    scale = float(rivals.fit.scale[0])
    of_source = _relative_motions(linear, shift, of_source=True)
    of_source = of_source[0][beside], of_source[1][beside]
    own = _repetition_densities(clouds.source, clouds.source_variance, of_source, widths / scale)
    n = len(clouds.source)
    anywhere = np.full(n, 1.0 / np.prod(bounding_box(clouds.source, clouds.source_variance)[3]))
    own_odds = _mixture_log_gains(anywhere, own.sum(axis=3) / (n - 1)) - cost + math.log(ALIKE)
    named = np.logaddexp(-np.logaddexp(0.0, -own_odds), -cost)
    without = np.exp(clutter.log_density)
    now, chosen, shares = without, list[tuple[int, int]](), np.ones(1)
    while len(chosen) < REPETITIONS:
        tried = _mixture_log_gains(now, densities) - cost
        best = np.unravel_index(int(tried.argmax()), tried.shape)
        if tried[best] <= 0.0:
            break
        chosen.append((int(best[0]), int(best[1])))
        densities_of = np.array([without, *(densities[one] for one in chosen)])
        prior = np.array([PSEUDO, *[PSEUDO_REPEATED] * len(chosen)])
        shares = prior / prior.sum()
        fit_crowd_shares(densities_of, prior, STEPS, shares)
        now = shares @ densities_of
    if not chosen:
        return None
    repeated = np.asarray(sum(share * kernels[one] for share, one in zip(shares[1:], chosen, strict=True)))
    rest = float(shares[0])
    more = replace(
        clutter, about=rest * clutter.about + repeated, alone=rest * clutter.alone, shares=rest * clutter.shares,
        repeats=1.0 - rest,
    )  # fmt: skip
    of_others = repeated.sum(axis=1) / (count - 1)
    more = replace(more, repeating=of_others * np.exp(-more.log_density))
    return more, -float(sum(named[one] for one in chosen)), -float(named[chosen[0]])


def add_displaced(model: PointSetModel, proposals: Judged) -> Judged:
    """Labellings with those that the motions between rivals make of them, as long as these are better than clutter."""
    rivals = select_rival_motions(proposals, maximum=DISPLACED)
    if len(rivals) < 2:
        return proposals
    first, last = _homogeneous_matrices(proposals.take(rivals[:1])), proposals.take(rivals)
    known = set(map(bytes, proposals.fit.assignments))
    for _ in range(ROUNDS):
        checkpoint()
        at = _homogeneous_matrices(last)
        # those with the fewest matches in common reach twice as far in each round
        away = at[np.unique([*range(min(len(at), RIVALS)), *range(max(len(at) - RIVALS, 0), len(at))])]
        away = away @ np.linalg.inv(first)
        away = np.concatenate([away, np.linalg.inv(away)])
        more = _label_about(model, (away[:, None] @ at).reshape(-1, *first.shape[1:]))
        more = more[[bytes(one) not in known for one in more]]
        known.update(map(bytes, more))
        judged = model.judge(more)
        last = judged.take(select_rival_motions(judged, maximum=DISPLACED))
        if not len(last.log_odds):
            break
        proposals = proposals.joined(last)
    return proposals


def _homogeneous_matrices(judged: Judged) -> Floats:
    """The motions of labellings as matrices (K, k + 1, k + 1)."""
    fit, size = judged.fit, judged.fit.rotation.shape[1]
    whole = np.zeros((len(fit.scale), size + 1, size + 1))
    whole[:, :size, :size] = fit.scale[:, None, None] * fit.rotation
    whole[:, :size, size], whole[:, size, size] = fit.shift, 1.0
    return whole


def _label_about(model: PointSetModel, motions: Floats) -> Integers:
    """Labellings (H, n) about motions, given as matrices."""
    linear = motions[:, :-1, :-1]
    scale = np.abs(np.linalg.det(linear)) ** (1.0 / linear.shape[1])
    found = label_by_motions(model.clouds, [Motions(linear, motions[:, :-1, -1], scale)], model.allowed, FEWEST)
    return grow_labellings(model.clouds, found, model.mirror, model.allowed)
