"""The joint posterior of bodies that compete for the targets of a space: one labelling of each, or none.

As `rootmatch.model.competition` has it for an image: every target has one owner, and the space may also show a copy of
a body that nobody named.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.model.joint import joint_marginals, remaining_parts
from rootmatch.model.modes import used_mask
from rootmatch.model.motion_prior import stack_priors
from rootmatch.model.point_set_model import Judged, PointSetModel
from rootmatch.model.point_set_posterior import PointSetPosterior, are_in_one_place, sort_hypotheses
from rootmatch.model.priors import COPY, COUNTS
from rootmatch.model.weighed_labellings import NEGLIGIBLE, Weighed
from rootmatch.problems.pose_fit.point_set_fit import FEWEST, concatenate_clouds

KEPT = 64
"""Labellings of each body that are weighed together. A round value."""


def joint_posterior(models: Sequence[PointSetModel], every: Sequence[Weighed]) -> list[PointSetPosterior]:
    """The marginal posteriors of several bodies among the same targets.

    ``every``: the labellings of each, proposed without regard to the others.
    """
    count = len(models[0].clouds.target)
    copies = [_copy_hypotheses(one, count) for one in every]
    taken = [used_mask(one.assignments, count) for one in every]
    wanted = np.array([used.any(axis=0) for used in taken])
    best = []
    for k, one in enumerate(every):
        contested = np.asarray(np.concatenate([np.delete(wanted, k, axis=0), copies[k][0]]).any(axis=0))
        best.append(one.take(_drop_dominated(taken[k], one.log_mass, contested)))
    uses = [used_mask(one.assignments, count) for one in best]
    best = [
        _add_partial_labellings(model, one, k, uses) for k, (model, one) in enumerate(zip(models, best, strict=True))
    ]
    of_bodies = [_body_hypotheses(model, one, count) for model, one in zip(models, best, strict=True)]
    asked = [k for k, copy in enumerate(copies) if len(copy[1])]
    # what stands in the place of its body is no copy of it: the two share a column more, as if it was a target
    shared = [_columns_of_one_place(models[k], best[k], copies[k], count) for k in asked]
    every_use = [used for used, _ in of_bodies] + [copies[k][0] for k in asked]
    places = [np.zeros((len(used), sum(own.shape[1] for own, _ in shared)), np.bool_) for used in every_use]
    at = 0
    for k, row, (own, copy) in zip(asked, range(len(models), len(every_use)), shared, strict=True):
        columns = slice(at, at + own.shape[1])
        places[k][: len(own), columns], places[row][:, columns] = own, copy
        at = columns.stop
    each_of = joint_marginals(
        [np.concatenate(pair, axis=1) for pair in zip(every_use, places, strict=True)],
        [mass for _, mass in of_bodies] + [copies[k][1] for k in asked],
        lambda taken: models[0].log_odds_of_left(taken[:, :count]),
    )
    return [
        sort_hypotheses(one.assignments, share[: len(one.assignments)], one.sums, models[0].twins)
        for one, share in zip(best, each_of, strict=False)  # those of copies follow
    ]


def judge_jointly(models: Sequence[PointSetModel], named: Sequence[Sequence[Integers]]) -> list[Judged]:
    """Named labellings (n,) of each of several bodies, and these without one match, by one fit of them all."""
    every = [np.array([*some, *_leave_one_out(some)]) for some in named]
    row, column = (np.cumsum([0, *some]) for some in ([len(one) for one in every], [one.shape[1] for one in every]))
    bodies = [(slice(*row[k : k + 2]), slice(*column[k : k + 2])) for k in range(len(models))]
    assignments = np.full((row[-1], column[-1]), -1, np.int64)
    for place, some in zip(bodies, every, strict=True):
        assignments[place] = some
    prior = stack_priors([model.prior for model in models], [len(one) for one in every])
    clouds = concatenate_clouds([model.clouds for model in models])
    whole = replace(models[0], clouds=clouds, allowed=None, log_weights=None, prior=prior)
    fit = whole.fit(assignments)
    factors = None if prior is None else whole.log_factors(fit, bodies)
    judged = []
    for model, (rows, points) in zip(models, bodies, strict=True):
        one = fit.of_body(rows, points, model.clouds)
        judged.append(model.judge(one.assignments, one, None if factors is None else factors[:, rows]))
    return judged


def _leave_one_out(labellings: Sequence[Integers]) -> list[Integers]:
    """Labellings (n,) without one of their matches, if enough are left."""
    every = []
    for one in labellings:
        (matched,) = (one >= 0).nonzero()
        for k in matched if len(matched) > FEWEST else ():
            less = one.copy()
            less[k] = -1
            every.append(less)
    return every


def _body_hypotheses(model: PointSetModel, found: Weighed, count: int) -> tuple[Bools, Floats]:
    """Targets (K, n') and log-odds (K,) of a body's labellings, and of its best mirror image, which is no answer."""
    used, odds = used_mask(found.assignments, count), -model.log_absent
    if found.mirrored is None or not math.isfinite(found.log_mirrored):
        return used, found.log_mass + odds
    image = used_mask(found.mirrored[None], count)
    return np.concatenate([used, image]), np.append(found.log_mass, found.log_mirrored) + odds


def _columns_of_one_place(
    model: PointSetModel, found: Weighed, copies: tuple[Bools, Floats, Integers], count: int
) -> tuple[Bools, Bools]:
    """A column for each copy that is where labellings of its body are: of those (K, C), and of the copies (M, C)."""
    used, _, labels = copies
    k, apart = len(found.assignments), ~(used_mask(found.assignments, count) @ used.T)
    asked = np.zeros((k + len(labels),) * 2, np.bool_)
    asked[:k, k:] = apart
    same = are_in_one_place(model, np.concatenate([found.assignments, labels]), asked)[:k, k:]
    some = same.any(axis=0)
    return same[:, some], np.eye(len(labels), dtype=np.bool_)[:, some]


def _copy_hypotheses(found: Weighed, count: int) -> tuple[Bools, Floats, Integers]:
    """Targets (K, n'), log-odds (K,) and labels (K, n) of copies that nobody named, where two may be in the scene."""
    used = used_mask(found.assignments, count)
    mass = found.log_odds + math.log(COPY)
    counts = (mass > -COUNTS) & ~(used.astype(np.float32) @ used.T.astype(np.float32) > 0.5).all(axis=1)
    own = np.flatnonzero(counts)[np.argsort(-mass[counts], kind="stable")]
    own = own[_drop_dominated(used[own], mass[own], np.asarray(used.any(axis=0)))]
    return used[own], mass[own], found.assignments[own]


def _drop_dominated(used: Bools, mass: Floats, contested: Bools) -> Integers:
    """Labellings that may count, at most `KEPT`, the best first; ``contested`` (n',): what anything else may want.

    A labelling does not count if another one is far better and takes nothing contested that it does not take.
    """
    order = np.argsort(-mass, kind="stable")
    wants = (used & contested)[order].astype(np.float32)
    more = wants @ (1.0 - wants).T > 0.5  # (i, j): whether i takes something that j does not
    better = mass[order][:, None] > mass[order] + NEGLIGIBLE
    return order[~(better & ~more).any(axis=0)][:KEPT]


def _add_partial_labellings(model: PointSetModel, found: Weighed, k: int, uses: Sequence[Bools]) -> Weighed:
    """The labellings of body k, and what remains of them if others take shared targets; ``uses``: of each body."""
    others = np.concatenate([uses[k][:0], *uses[:k], *uses[k + 1 :]])
    shared = others.astype(np.float32) @ uses[k].T.astype(np.float32) > 0.5
    _, parts = remaining_parts(found.assignments, others, np.asarray(shared), FEWEST)
    if not len(parts):
        return found
    more = model.judge(parts)
    return found._replace(
        assignments=np.concatenate([found.assignments, more.fit.assignments]),
        log_odds=np.concatenate([found.log_odds, more.log_odds - more.known]),
        log_mass=np.concatenate([found.log_mass, more.log_odds]),
    )
