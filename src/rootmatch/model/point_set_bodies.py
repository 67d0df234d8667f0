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
from rootmatch.model.point_set_posterior import PointSetPosterior, sort_hypotheses
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
    each = [
        *(_body_hypotheses(model, one, count) for model, one in zip(models, best, strict=True)),
        *(one for one in copies if len(one[1])),
    ]
    each_of = joint_marginals([used for used, _ in each], [mass for _, mass in each], models[0].log_odds_of_left)
    return [
        sort_hypotheses(one.assignments, share[: len(one.assignments)], one.sums)
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
    whole = replace(models[0], clouds=clouds, allowed=None, weights=None, prior=prior)
    fit = whole.fit(assignments)
    factors = None if prior is None else whole.log_factors(fit, bodies)
    judged = []
    for model, (rows, points) in zip(models, bodies, strict=True):
        one = fit.of_body(rows, points, model.clouds)
        judged.append(model.judged(one.assignments, one, None if factors is None else factors[:, rows]))
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


def _copy_hypotheses(found: Weighed, count: int) -> tuple[Bools, Floats]:
    """Targets (K, n') and log-odds (K,) of copies that nobody named, where two may be in the scene."""
    used = used_mask(found.assignments, count)
    mass = found.log_odds + math.log(COPY)
    counts = (mass > -COUNTS) & ~(used.astype(np.float32) @ used.T.astype(np.float32) > 0.5).all(axis=1)
    own = np.flatnonzero(counts)[np.argsort(-mass[counts], kind="stable")]
    own = own[_drop_dominated(used[own], mass[own], np.asarray(used.any(axis=0)))]
    return used[own], mass[own]


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
    more = model.judged(parts)
    return found._replace(
        assignments=np.concatenate([found.assignments, more.fit.assignments]),
        log_odds=np.concatenate([found.log_odds, more.log_odds - more.known]),
        log_mass=np.concatenate([found.log_mass, more.log_odds]),
    )
