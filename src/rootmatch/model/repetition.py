"""Repetition among targets, as rooms of a floor and trees of a street have it: a motion puts many of them near others.

Where the object repeats itself, so does what is beside it, and a labelling that is a period off matches that. Against
clutter that lies anywhere, its matches are worth as much as right ones; but what the other targets and the repetition
predict is no coincidence. So a clutter point may also lie about where the motion puts another one, in one of `WIDTHS`
widths, as crowds lie about other targets: see `rootmatch.model.clutter.Clutter`, of whose forests it is one more kind
of descent. A match is then worth by how much it is nearer to its place than that.

Motions that may repeat the targets are those between rival motions of the object. One counts if targets are more
probable with it by more than the number of motions that can be told apart, which is what it takes to name it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.model.clutter import MOST, STEPS, Clutter
from rootmatch.model.compiled.crowds import shares_of_crowds
from rootmatch.model.point_set_model import Judged, PointSetModel

RIVALS = 8
"""Most motions of the object between which repetitions are sought. A round value."""
SHARED = 0.3
"""Share of their matches up to which two labellings are of rival motions. A round value."""
WIDTHS = 4
"""Widths of a repetition, each half as wide as the one before; the first is a quarter of the targets' spacing."""
REPETITIONS = 6
"""Most repetitions that are kept. A round value."""
TRIED = np.array([0.25, 0.5, 0.75, 0.9])[:, None, None, None]
"""Shares with which a repetition is tried."""
PSEUDO, PSEUDO_REPEATED = 1.0, 0.1
"""Pseudo-counts of clutter without repetitions and of each of them, as of crowds in space."""


def with_repetition(model: PointSetModel, proposals: Judged) -> PointSetModel:
    """The model with the repetitions among targets that some labellings (K, n) point to; itself if there are none."""
    rivals = _rivals(proposals)
    if len(rivals) < 2 or len(model.clouds.target) > MOST:
        return model
    clutter = _repeated(model.clutter, *_motions_between(model, proposals.take(rivals)))
    return model if clutter is None else replace(model, repeated=clutter)


def _rivals(found: Judged) -> Integers:
    """Labellings of different motions that are better than clutter alone, the best first."""
    assignments, kept = found.fit.assignments, list[int]()
    if len(assignments) == 1:
        return np.empty(0, np.int64)
    better = np.flatnonzero(found.log_odds > 0.0)
    left = better[np.argsort(-found.log_odds[better], kind="stable")]
    while len(left) and len(kept) < RIVALS:
        one, others = assignments[left[0]], assignments[left]
        kept.append(int(left[0]))
        fewer = np.minimum((others >= 0).sum(axis=1), int((one >= 0).sum()))
        left = left[((others == one) & (one >= 0)).sum(axis=1) < SHARED * fewer]
    return np.array(kept, np.int64)


def _motions_between(model: PointSetModel, rivals: Judged) -> tuple[Floats, Floats]:
    """Motions y' = S y + b (G, k, k) and (G, k), along the axes of the box, from each rival's places to another's."""
    middle, axes = model._space[2:]
    linear = axes.T @ (rivals.fit.scale[:, None, None] * rivals.fit.rotation)
    shift = (rivals.fit.shift - middle) @ axes
    first, second = np.triu_indices(len(shift), 1)
    between = linear[second] @ np.linalg.inv(linear[first])
    return between, shift[second] - (between @ shift[first][..., None])[..., 0]


def _repeated(clutter: Clutter, linear: Floats, shift: Floats) -> Clutter | None:
    """Clutter with those motions (G, k, k) and (G, k) that repeat its points; None if none does."""
    target, count, size = clutter.target, len(clutter.target), clutter.target.shape[1]
    span = np.maximum(np.ptp(target, axis=0) * (count + 1) / (count - 1), clutter.sigma.max())
    spacing = float(clutter.uniform[0] * count) ** (-1.0 / size)
    widths = 0.25 * spacing * 0.5 ** np.arange(WIDTHS)
    images = target @ linear.swapaxes(1, 2) + shift[:, None]
    squared = ((target[:, None] - images[:, None]) ** 2).sum(axis=3)
    squared[:, np.arange(count), np.arange(count)] = np.inf
    variance = widths[:, None, None] ** 2 + clutter.sigma[:, None] ** 2 + clutter.sigma**2
    kernels = np.exp(-0.5 * squared[:, None] / variance) / (2.0 * np.pi * variance) ** (0.5 * size)
    kernels = 0.5 * (kernels + kernels.swapaxes(2, 3))  # either of two may be the other's image
    densities = kernels.sum(axis=3) / (count - 1)
    # motions that widths tell apart: places along each axis, and turns
    radius = math.sqrt(float(((target - target.mean(axis=0)) ** 2).sum(axis=1).mean()))
    turns = size * (size - 1) // 2
    cost = np.log(np.maximum(span / widths[:, None], 1.0)).sum(axis=1)
    cost += turns * np.log(np.maximum(2.0 * math.pi * radius / widths, 1.0))
    without = np.exp(clutter.log_density)
    now, chosen, shares = without, list[tuple[int, int]](), np.ones(1)
    while len(chosen) < REPETITIONS:
        tried = np.log((1.0 - TRIED) * now + TRIED * densities).sum(axis=3).max(axis=0) - cost
        best = np.unravel_index(int(tried.argmax()), tried.shape)
        if tried[best] <= np.log(now).sum():
            break
        chosen.append((int(best[0]), int(best[1])))
        densities_of = np.array([without, *(densities[one] for one in chosen)])
        prior = np.array([PSEUDO, *[PSEUDO_REPEATED] * len(chosen)])
        shares = prior / prior.sum()
        shares_of_crowds(densities_of, prior, STEPS, shares)
        now = shares @ densities_of
    if not chosen:
        return None
    about = shares[0] * clutter.about + sum(share * kernels[one] for share, one in zip(shares[1:], chosen, strict=True))
    rest = float(shares[0])
    return replace(
        clutter, about=about, alone=rest * clutter.alone, shares=rest * clutter.shares, repeats=1.0 - rest,
    )  # fmt: skip
