"""The joint posterior of bodies that compete for the detections of an image: one pose of each, or none.

Every detection has one owner. A joint hypothesis consists of one mode of each body, or its absence, such that no
detection is used twice: see `rootmatch.model.joint`. So no body is trusted on detections that another explains as
well, and a body is not taken to be absent merely because another takes its detections.
An image may also show a copy of a body that nobody named: of two places where it fits, either may be the one asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.model.copy_or_alike import log_alike_factor
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import settle_poses, weigh_assignments
from rootmatch.model.exact_shapes import Copies, exact_shape_log_gains
from rootmatch.model.exchanged import own_prior
from rootmatch.model.joint import joint_marginals, remaining_parts
from rootmatch.model.modes import Modes, empty_changes_each, is_same_place
from rootmatch.model.pose_density import Doubted
from rootmatch.model.posterior import Posterior
from rootmatch.model.priors import COPY, COUNTS, PRESENT_ODDS, WRONG_MODEL
from rootmatch.model.strays import stray_log_gains, unpredicted
from rootmatch.model.unrecognised import odds_of_unrecognised

Value = TypeVar("Value")
IN_PLACE = 0.25
"""Distance of a body's points from where they are in another pose, over its radius, below which all are in one place.
A round value."""
KEPT = 16
"""Modes of each body that are weighed together. A round value."""


def joint_posterior(
    models: Sequence[DetectionModel],
    every: Sequence[Modes],
    copies: Sequence[Copies] | None = None,
    firsts: Sequence[int] | None = None,
) -> list[Posterior]:
    """The marginal posteriors of several bodies in one image.

    Parameters
    ----------
    models : sequence of DetectionModel
        Of the bodies, with the same detections.
    every : sequence of Modes
        The modes of each body, proposed without regard to the others.
    copies : sequence of sequence, optional
        For each body, the others that may be copies of it, and which of their points are its own. None if no body's
        points have errors: then none is of an exact shape that they hide.
    firsts : sequence of int, optional
        For each body the first that is weighed alike, with the same modes; itself by default.

    Returns
    -------
    list of Posterior
        The modes of each, those among them that leave detections to others, and the marginal of each.
    """
    count, leaders = models[0].shape[1], list(range(len(models)) if firsts is None else firsts)
    distinct = list(dict.fromkeys(leaders))
    are_distinct = len(distinct) == len(leaders)
    same = [] if are_distinct else [[k for k, first in enumerate(leaders) if first == one] for one in distinct]

    def of_each(work_out: Callable[[int], Value]) -> list[Value]:
        found = list(map(work_out, distinct))
        if are_distinct:
            return found
        by_first = dict(zip(distinct, found, strict=True))
        return [by_first[k] for k in leaders]

    has_gains = copies is not None or len(models[0].images) > 1
    alike_to: Sequence[Copies | None] = [None] * len(models) if copies is None else copies
    modes = of_each(lambda k: _sort_by_gains(models[k], every[k], alike_to[k])) if has_gains else every
    best = of_each(lambda k: modes[k].uses(count)[:KEPT])

    def choices(k: int) -> tuple[Modes, Bools, Floats, Integers | None, Floats | None]:
        own = _add_partial_modes(models[k], modes[k], k, best)
        used = best[k] if len(best[k]) == len(own.log_odds) else own.uses(count)
        of = _prediction_indices(models[k], own)
        return own, used, own.log_mass + PRESENT_ODDS, of, _copy_log_odds(models[k], own, used, of)

    parts, uses, masses, origins, as_copies = map(list, zip(*of_each(choices), strict=True))
    named = [(k, mass) for k, mass in enumerate(as_copies) if mass is not None]

    def add(gains: Sequence[Floats | float]) -> None:
        masses[:] = [mass + gain for mass, gain in zip(masses, gains, strict=True)]
        named[:] = [(k, mass + gains[k]) for k, mass in named]

    def weighed(named: Sequence[tuple[int, Floats]]) -> list[Floats]:
        of, of_copies = [k for k, _ in named], [mass for _, mass in named]
        return joint_marginals(
            [*uses, *[uses[k] for k in of]], [*masses, *of_copies], models[0].log_odds_of_left,
            images=models[0].image_indices, given=[-1] * len(parts) + of, same=same,
        )  # fmt: skip

    if copies is not None:
        add(of_each(lambda k: exact_shape_log_gains(models[k], parts[k], copies[k])))
    shares = weighed(named)
    # strays in space, and a copy of a body that is hidden, only make less of what no prediction told
    if (has_gains or named) and any(
        shares[k][:-1][unpredicted(models[k], parts[k], origins[k])].max(initial=0.0) >= WRONG_MODEL for k in distinct
    ):
        strays = of_each(lambda k: stray_log_gains(models[k], parts[k], origins[k]))
        hidden = of_each(lambda k: _hidden_log_odds(models[k], parts[k], origins[k]))
        if any(np.any(one) for one in [*strays, *hidden]):  # not before one camera that is told no pose
            add(strays)
            named[:] = [(k, mass + hidden[k]) for k, mass in named]
            shares = weighed(named)
    # a body may be in another place than that of its best mode
    probable = [(k, shares[k][:-1]) for k, _ in named]
    if disputed := {k for k, of in probable if of[~(uses[k] @ uses[k][int(of.argmax())])].sum() >= WRONG_MODEL}:
        best_uses = np.array([of_modes[:1].any(axis=0) for of_modes in uses])

        def if_alike(k: int) -> Floats | float:
            others = np.asarray(np.delete(best_uses, k, axis=0).any(axis=0))
            return _alike_factors(models[k], parts[k], uses[k], origins[k], others) if k in disputed else 0.0

        alike = of_each(if_alike)
        shares = weighed([(k, mass + alike[k]) for k, mass in named])
    of_copy = {k: 1.0 - float(share[-1]) for (k, _), share in zip(named, shares[len(parts) :], strict=True)}

    def told(k: int) -> Posterior:
        each, of = (1.0 - WRONG_MODEL) * shares[k], origins[k]
        copy = min(of_copy[k], float(each[-1])) if k in of_copy else 0.0
        mine, chances = parts[k], each[:-1]
        if np.count_nonzero(chances[1:] > chances[:-1]):  # they are in order nearly always
            order = (-chances).argsort(kind="stable")
            mine, chances, of = mine.take(order), chances[order], None if of is None else of[order]
        return Posterior(mine, chances, float(each[-1]), origins=of, copy=copy, copies=leaders.count(leaders[k]))

    return of_each(told)


def _sort_by_gains(model: DetectionModel, modes: Modes, copies: Copies | None) -> Modes:
    """Modes, the most probable first if the body may be of an exact shape, and clutter has strays in space."""
    if len(modes.log_mass) <= KEPT:
        return modes
    gains = stray_log_gains(model, modes, _prediction_indices(model, modes))
    if copies is not None:
        gains = gains + exact_shape_log_gains(model, modes, copies)
    return modes if np.ndim(gains) == 0 else modes.take(np.argsort(-(modes.log_mass + gains), kind="stable"))


def _prediction_indices(model: DetectionModel, modes: Modes) -> Integers | None:
    """The prediction (M,) that each mode is about, −1 for none; None if nothing is predicted."""
    prior = own_prior(model.prior)
    return prior.prediction_indices(modes.rotation, modes.position) if isinstance(prior, Doubted) else None


def _copy_log_odds(model: DetectionModel, modes: Modes, uses: Bools, of: Integers | None) -> Floats | None:
    """Log-odds of a body's modes as those of something else; None if two cannot be in one image.

    A copy that nobody named, of which what is known of the body tells nothing; or, where a tracker follows the body in
    several places, what it follows in the others: whether that is a copy or clutter that stays, it is expected there.
    (M,), or (M + 1, M) whose rows are of the body's own mode, the last one of no mode, and columns of the other.
    ``uses`` (M, n'): the detections of each mode; ``of``: as of `_prediction_indices`.
    """
    mass, prior, together = modes.log_mass, own_prior(model.prior), ~(uses @ uses.T)
    if (of is None or (of >= 0).all()) and not together.any():
        return None
    if of is None or not isinstance(prior, Doubted):
        return _exclude_same_place(model, modes, together, mass + math.log(COPY))
    at = model.linearise_about(modes.rotation, modes.position)
    anywhere = weigh_assignments(model, modes.assignments, at, prior.without).log_odds
    as_copy = np.asarray(mass - modes.log_odds + anywhere + math.log(COPY))
    if len(prior.predictions) == 1:
        return _exclude_same_place(model, modes, together, as_copy)
    places = np.array(prior.places)
    share = (places[:, None] == places) @ np.exp(prior.log_shares)  # of all that is followed in the place of each
    expected = mass - np.log(np.where(of >= 0, share[of], 1.0)) + math.log(COPY)
    # of what is followed, maybe in another pose
    known = np.append((is_same_place(uses) & (of >= 0)).any(axis=1), False)
    return _exclude_same_place(model, modes, together, np.where((of >= 0) & known[:, None], expected, as_copy))


def _hidden_log_odds(model: DetectionModel, modes: Modes, of: Integers | None) -> Floats | float:
    """What is added to the log-odds (M + 1, M) of copies as of `_copy_log_odds`, as the body may be hidden.

    It is absent where it has no mode, or where it is expected and shows too little.
    """
    prior = own_prior(model.prior)
    if of is None or not isinstance(prior, Doubted) or not (of < 0).any():
        return 0.0
    more, elsewhere = np.zeros((len(of) + 1, len(of))), np.flatnonzero(of < 0)
    hidden = odds_of_unrecognised(model, prior, modes.take(elsewhere))
    more[-1, elsewhere] = np.log1p((1.0 - prior.doubt) * math.exp(PRESENT_ODDS) * hidden)
    return more


def _exclude_same_place(model: DetectionModel, modes: Modes, together: Bools, as_copy: Floats) -> Floats:
    """Log-odds as of `_copy_log_odds` in which a body and its copy are not in one place.

    Their points would be in each other.
    Cameras of a rig that are off see a body in several poses, each with detections of its own. ``together`` (M, M):
    modes that share none.
    """
    if not together.any():
        return as_copy
    placed = np.einsum("kij,nj->kni", modes.rotation, model.points) + modes.position[:, None]
    apart = np.linalg.norm(placed[:, None] - placed, axis=-1).max(axis=-1) >= IN_PLACE * model.radius
    if not (together & ~apart).any():
        return as_copy
    return np.where(np.append(apart, np.ones((1, len(apart)), np.bool_), axis=0), as_copy, -np.inf)


def _alike_factors(model: DetectionModel, modes: Modes, uses: Bools, of: Integers | None, taken: Bools) -> Floats:
    """Logarithms (M + 1, M) of factors on the odds of a copy, in whose place something alike may be.

    Rows and columns are as of `_copy_log_odds`. All modes of a place have the factor of its best one, in the best other
    place of the body: only one copy is in a joint hypothesis. ``taken`` (n',): detections of other bodies.
    """
    more, prior, mass = np.zeros((len(uses) + 1, len(uses))), own_prior(model.prior), modes.log_mass
    if of is not None and isinstance(prior, Doubted) and len(prior.predictions) > 1:
        return more  # frames tell one by one what is in a followed place
    likely = [k for k in np.argsort(-mass, kind="stable").tolist() if mass[k] + math.log(COPY) >= -COUNTS]
    same, apart = is_same_place(uses), ~(uses @ uses.T)
    place = np.full(len(uses), -1)
    for k in likely:
        place[k] = next(one for one in likely if same[k, one])
    best = [k for k in likely if place[k] == k]
    pairs = [(own, next((k for k in best if apart[own, k]), -1)) for own in best]
    weights = [mass[own] + mass[other] if other >= 0 else -math.inf for own, other in pairs]
    for (own, other), weight in zip(pairs, weights, strict=True):
        if other >= 0 and weight >= max(weights) + math.log(WRONG_MODEL):
            factor = log_alike_factor(model, modes, other, (uses[own] | taken) & ~uses[other])
            more[np.ix_(np.append(place == own, False), place == other)] = factor
    return more


def _conflicting_modes(model: DetectionModel, modes: Modes, uses: Bools) -> Bools:
    """Which modes (M, M) are followed in different places, but share detections; ``uses`` (M, n')."""
    prior = own_prior(model.prior)
    if not isinstance(prior, Doubted) or len(prior.predictions) == 1:
        return np.zeros((len(uses), len(uses)), np.bool_)
    followed = prior.prediction_indices(modes.rotation, modes.position) >= 0
    return np.asarray((uses @ uses.T) & ~is_same_place(uses) & followed & followed[:, None])


def _add_partial_modes(model: DetectionModel, modes: Modes, k: int, uses: Sequence[Bools]) -> Modes:
    """The best modes of body k, and what remains of them if others take shared detections.

    Others are other bodies, what is followed in another place, and the best mode, of which another may be a copy.
    ``uses``: the detections (M, n') of the best modes of each body.
    """
    modes = modes.first(KEPT)
    if len(uses) == 1 == len(uses[k]):
        return modes
    others = np.concatenate([uses[k], *uses[:k], *uses[k + 1 :]])
    own = len(uses[k])
    shared = others @ uses[k].T
    shared[:own] = _conflicting_modes(model, modes, uses[k])
    if own:
        best = int(modes.log_mass[:own].argsort()[-1])
        shared[best] |= (uses[k][best] @ uses[k].T) & ~is_same_place(uses[k][[best]], uses[k])[0]
    if not shared.any():
        return modes
    which, assignments = remaining_parts(modes.assignments, others, shared, model.prior.minimum)
    if not len(which):
        return modes
    part_of = modes.take(which)
    # what is another's may have pulled the pose aside
    found, at = settle_poses(model, assignments, part_of.rotation, part_of.position)
    usable = np.isfinite(found.log_odds)
    given = (assignments < 0) & (part_of.assignments >= 0)  # to another body
    lost = part_of._replace(
        assignments=assignments,
        rotation=at.rotation,
        position=at.position,
        covariance=found.covariance,
        log_odds=found.log_odds,
        log_mass=found.log_odds + _gains_beside(part_of, given),
        freedom=found.freedom,
        visible=found.visible,
        detected=found.detected,
        local=np.where(given, 1.0, part_of.local),
        unmatched=np.where(given, 1.0, part_of.unmatched),
        near=empty_changes_each(*assignments.shape),
    )
    return modes.and_(lost.take(usable.nonzero()[0]))


def _gains_beside(modes: Modes, given: Bools) -> Floats:
    """What the changes of modes gain (M,) that leave ``given`` points (M, n) as they are: others would be no change."""
    gains = modes.log_mass - modes.log_odds
    for k in np.flatnonzero(modes.summed):
        changed, log_odds, _ = modes.near[k]
        same = (changed[:, given[k]] == modes.assignments[k, given[k]]).all(axis=1)
        gains[k] = min(gains[k], np.logaddexp.reduce(np.append(log_odds[same] - modes.log_odds[k], 0.0)))
    return gains
