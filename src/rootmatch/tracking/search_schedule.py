"""Searches that go on over frames, so that few take much longer than the others; and the times of frames."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from statistics import median

import numpy as np

from rootmatch.arrays import Bools
from rootmatch.errors import InputWarning
from rootmatch.explain.bodies import SearchPart, is_mostly_shown
from rootmatch.explain.body_labels import Label
from rootmatch.explain.decide import TRUST, Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.match_options import MatchOptions
from rootmatch.frozen import copy_with
from rootmatch.tracking.followed_body import FollowedBody

LONGEST_INTERVAL = 16
"""Interval between frames, relative to `INTERVAL`, beyond which a search takes no longer. A round value."""
INTERVAL = 1.0 / 60.0
"""Seconds between frames for which the budget of a search is stated."""
AMONG_ALL = 60
"""Frames after which one of several bodies that is missing is searched for again on the detections that others of its
shape certainly have. A round value."""
LATELY = 10
"""Frames without a body from which it is not looked for with more noise, unless the last residuals leave a doubt: the
first few would have told, and what is predicted so vaguely takes as long as a search. A round value."""
SLOW = 1.0
"""Seconds between two frames beyond which a time is hardly one in seconds. Not tuned."""
CLOCK_UNITS = ("milliseconds", "1000"), ("microseconds", "1e6"), ("nanoseconds", "1e9")
"""Units in which clocks tell the time, and by what to divide it for seconds, as a warning says it."""
FIRST_STEPS = 5
"""Steps whose median is looked at: a pause among them is no reason to warn. Not tuned."""


def reorder_draws(options: MatchOptions, cut: int) -> MatchOptions:
    """The options of the next search: after so many that were cut short it draws other minimal sets first.

    These are drawn at random, so that two short searches find as much as one of twice the length, and the second one
    finds where the body is now.
    """
    return options if not cut else copy_with(options, seed=options.seed + cut)


def warn_of_time_unit(steps: list[float], step: float) -> None:
    """Count one more of the first steps between frames, and warn the caller of the caller once if most are slow."""
    if len(steps) == FIRST_STEPS:
        return
    steps.append(step)
    if len(steps) == FIRST_STEPS and (usual := median(steps)) > SLOW:
        unit, divisor = probable_unit(usual)
        text = f"time: the frames are {usual:.3g} s apart; if times are in {unit}, divide them by {divisor}"
        warnings.warn(text, InputWarning, stacklevel=3)


def probable_unit(step: float) -> tuple[str, str]:
    """The unit of `CLOCK_UNITS`, the largest one, in which frames would be `SLOW` seconds apart or less."""
    return next((unit for unit in CLOCK_UNITS if step <= SLOW * float(unit[1])), CLOCK_UNITS[-1])


def frame_budget(evaluations: int, gap: float) -> int:
    """Evaluations of a search by those at `INTERVAL`; if seconds between frames (``gap``) are more, there is time."""
    return round(evaluations * min(max(gap / INTERVAL, 1.0), LONGEST_INTERVAL))


def bodies_found_lately(
    bodies: Mapping[Label | None, FollowedBody], predicted: Iterable[Label | None], frame: int, *, doubted: bool
) -> list[Label | None]:
    """The predicted bodies to look for with more noise; none in a frame that was searched, which takes long enough.

    ``doubted``: whether the last residuals suggest more.
    """
    if frame in [body.served for body in bodies.values()]:
        return []
    return [label for label in predicted if doubted or bodies[label].missed < LATELY]


def choose_next_part(
    bodies: Mapping[Label | None, FollowedBody], parts: Mapping[Label | None, Finding], frame: int
) -> SearchPart | None:
    """What a frame searches, judged by the findings about predicted poses; None for nothing.

    A frame searches one image for one body. The search for a body goes on in the next frames until it has come to all
    images; bodies take turns. If all have been searched while the body was followed, the next search is of one image,
    and that after it of another: a pose elsewhere that explains more is seen in several.
    """
    each = list(bodies.values())
    explained, held = np.zeros((2, len(each), next(iter(parts.values())).task.shape[1]), np.bool_)
    for k, part in enumerate(parts.values()):
        if part.status is Status.MATCHED:
            own = part.assignment[part.assignment >= 0]
            explained[k, own] = True
            held[k, own] = part.posterior is None or is_mostly_shown(part.posterior, part.mode)
    free = int(np.count_nonzero(~held.any(axis=0)))
    for body, part in zip(each, parts.values(), strict=True):
        wants = body.needs_joint_search if len(each) > 1 else body.needs_search
        if not body.waiting and wants(part, frame, free):
            body.begun = frame
            others = held[[*bodies_tried(each, body)]]
            images, matched = searchable_images(part, explained, others), part.status is Status.MATCHED
            if images and matched and body.confirmed and body.beside:  # all of them have been searched before
                images = [images[body.agreements % len(images)]]
            body.waiting, body.rest, body.looked = images, body.has_new_detections(part), []
    waiting = [number for number, body in enumerate(each) if body.waiting and not body.is_looked_for(frame)]
    if not waiting:
        return None
    number = min(waiting, key=lambda k: each[k].served)
    body = each[number]
    body.served, image = frame, body.waiting.pop(0)
    body.looked.append(image)
    share = body.search_share(list(parts.values())[number])
    return SearchPart(number, image, body.rest, share, bodies_tried(each, body))


def ended_searches(
    bodies: Mapping[Label | None, FollowedBody], parts: Mapping[Label | None, Finding], frame: int
) -> set[Label | None]:
    """The bodies whose searches end in a frame: with the last image, or if hardly anything as good is left to meet."""
    out = set[Label | None]()
    for label, body in bodies.items():
        if body.served == frame:
            matched = parts[label].status is Status.MATCHED
            if body.waiting and matched and unmet_chance(parts[label], body.looked) <= TRUST.missed:
                body.waiting = []
            if not body.waiting:
                out.add(label)
                if not bodies_tried(list(bodies.values()), body):
                    body.tried = body.begun
    return out


def bodies_tried(bodies: Sequence[FollowedBody], body: FollowedBody) -> tuple[int, ...]:
    """The numbers of those on whose detections a body was tried in vain since they are followed: `SearchPart.tried`.

    Whether it is in the place of one of them is weighed in every frame, as far as they look alike.
    """
    if body.tried is None or body.begun - body.tried >= AMONG_ALL:
        return ()
    return tuple(k for k, one in enumerate(bodies) if one is not body and one.settled and one.since <= body.tried)


def unmet_chance(found: Finding, looked: Sequence[int | None]) -> float:
    """Probability that none of some images shows enough of a pose elsewhere for a search in it to meet that.

    It has as many sightings as what was found, of as many that are visible, and any of these with the same chance.
    """
    cameras = 1 if found.task.rig is None else len(found.task.rig.views)
    visible = found.posterior_and_model[0].modes.visible[found.mode].reshape(cameras, -1)
    used = (found.assignment >= 0).reshape(cameras, -1)
    each = np.maximum(visible.sum(axis=1).round().astype(int), used.sum(axis=1)).tolist()
    total, matched, few = sum(each), int(used.sum()), range(found.task.minimal + 1)
    unmet = 1.0
    for own in (each[k or 0] for k in looked):
        ways = sum(math.comb(own, k) * math.comb(total - own, matched - k) for k in few if k <= matched)
        unmet *= ways / math.comb(total, matched)
    return unmet


def remaining_counts(parts: Mapping[Label | None, Finding]) -> dict[Label | None, int]:
    """For each body, the number of detections that no body has for certain and that it has not itself."""
    free, left = np.ones(next(iter(parts.values())).task.shape[1], np.bool_), {}
    for part in parts.values():
        if part.status is Status.MATCHED:
            free[part.assignment[part.assignment >= 0]] = False
    for label, part in parts.items():
        others = free.copy()
        if part.status is not Status.UNTRUSTED:
            others[part.assignment[part.assignment >= 0]] = False
        left[label] = int(np.count_nonzero(others))
    return left


def searchable_images(found: Finding, explained: Bools, others: Bools) -> list[int | None]:
    """The images in which a body can be searched for: cameras of a rig that show enough.

    Those with the most detections that are not ``explained`` come first. What each of some bodies explains (K, n'), and
    what each of the ``others`` has that is left out.
    """
    if found.task.rig is None:
        return [None]
    shown = np.bincount(found.task.camera_of[~others.any(axis=0)])
    left = np.bincount(found.task.camera_of[~explained.any(axis=0)], minlength=len(shown))
    return [k for k in np.lexsort([-shown, -left]).tolist() if shown[k] >= found.task.minimal]
