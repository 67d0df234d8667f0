"""A body that is in view, but of which the image shows too little to recognise it; and two views in the same way.

Fewer points than make a mode fit any image: under the prior of all poses each of them lies anywhere, so the sum over
the poses, and over the detections that they may have, is in the mean that of clutter. What is left is how probable it
is that so few are detected, and that so many detections are clutter: with k of the points and n' detections,

    W = Σ_(k ≤ m) P(k | present) · n'! / (n' − k)! · Γ(n' − k + ½) / Γ(n' + ½)

are the odds against clutter alone. P(k | present) is a mean over rates, over turns of the body, of those that show
anything of it, and over what is hidden as a whole.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rootmatch.algebra.rotation import spread_rotations
from rootmatch.arrays import Floats, Integers
from rootmatch.model.compiled.occluder import OCCLUDED
from rootmatch.model.detection_model import HIGHEST_RATE, DetectionModel
from rootmatch.model.pose_density import MINIMUM
from rootmatch.model.priors import PRESENT_ODDS
from rootmatch.model.views import camera_frames

TURNS = 64
"""Turns of a body with normals over which a mean is taken. A round value."""
IN_SIGHT = (1.0 / 6.0, 0.5, 5.0 / 6.0)
"""Parts of a body that an edge or a window leaves in sight, equally probable: any point may be the first it hides."""
SIGHT = np.array([1.0 - OCCLUDED, *[OCCLUDED / len(IN_SIGHT)] * len(IN_SIGHT)])
"""Probabilities (H,) that all of it is in sight, and each of these parts."""
FEW_TURNS = 8
"""Those that tell what is shown of a copy. A round value."""
ANY = 10**9
"""Detections of which there are so many that their number tells nothing."""
RADII = 10.0
"""Distance of a body in its radii at which it is looked at, before an image that is as wide as its focal length, or
wider. A round value between 1 and 100."""


@dataclass(frozen=True, eq=False)
class FewShown:
    """A body of which an image shows too little, if it is in view.

    Parameters
    ----------
    model : DetectionModel
    maximum : int
        Detected points, in each image of a rig, that make no mode.
    counts : (C,) int array
        Detections that each image has for the body.
    unmet : float
        Probability that its search met no mode though it shows more, as that was cut short.
    """

    model: DetectionModel
    maximum: int
    counts: Integers
    unmet: float = 0.0

    def undetected_probability(self) -> Floats:
        """Probability (n,) that each point has no detection, if there is no mode: the body is absent, or shows few.

        Or it shows more, and was not met: with the prior odds of that, as nothing is known of its image.
        """
        visible, (rates, log_weights) = _typical_visibility(self.model), self.model.rate_quadrature
        some = 1.0 - np.prod(1.0 - visible, axis=1)  # what shows no point is not in view
        mean = float(rates @ np.exp(log_weights))
        each = np.concatenate([rates, mean * np.array(IN_SIGHT)])
        shares = np.concatenate([SIGHT[0] * np.exp(log_weights), SIGHT[1:]])
        chance = (visible.T[:, :, None] * each).reshape(len(self.counts), -1, len(visible) * len(each))
        cases = np.outer(some / some.sum(), shares).reshape(-1)
        odds, few = odds_of_few(chance, cases, self.counts, self.maximum)
        present = math.exp(PRESENT_ODDS)
        without, whole = 1.0 + present * odds * few, 1.0 + present * odds
        if self.unmet and (self.counts > self.maximum).any():
            part, own = odds_of_few(chance, cases, np.full_like(self.counts, ANY), self.maximum)
            without += present * self.unmet * np.maximum(1.0 - (chance @ cases).reshape(-1) - part * own, 0.0)
            whole += present * self.unmet * (1.0 - part)
        return np.asarray(without / whole)


@dataclass(frozen=True, eq=False)
class ShownOfCopy:
    """What images may show of a copy of a body beside it: it is as bright, and may be hidden in part."""

    odds: Floats
    """(m + 1, C, S, K) odds that each image shows no more than 0, 1 … points, in S turns and K other cases."""
    weights: Floats
    """(S, K) of the cases."""

    @classmethod
    def of(cls, model: DetectionModel, counts: Integers, matched: int, visible: float) -> ShownOfCopy:
        """That of a body with so many matches of its ``visible`` points, among the detections (C,) that it leaves."""
        visibility, maximum = _typical_visibility(model, FEW_TURNS), int(counts.max())
        few = count_distributions(visibility, model.rate_quadrature[0], len(counts), maximum)
        some = 1.0 - np.prod(1.0 - visibility, axis=1)  # what shows no point is not in view
        told = rate_weights(model, np.array([matched]), np.array([visible]))[0]
        odds = (few * count_ways_to_own(counts, maximum)).cumsum(axis=0).reshape(*few.shape[:2], len(some), -1)
        return cls(odds, np.outer(some / some.sum(), np.outer(told, SIGHT)))

    def unmet_odds(self, maximum: Integers) -> float:
        """Odds, against clutter alone, that it shows no more than so many points (C,), but a minimal set in one image.

        By the numbers of detections; prior odds apart.
        """
        images = np.arange(len(maximum))
        few, fewer = (self.odds[each, images].prod(axis=0) for each in (maximum, np.minimum(maximum, MINIMUM - 1)))
        return float((self.weights * (few - fewer)).sum())


def rate_weights(model: DetectionModel, matched: Integers, visible: Floats) -> Floats:
    """Weights (M, Q) of the nodes of the detection rate, by so many matches (M,) of so many visible points (M,)."""
    rates, log_weights = model.rate_quadrature
    missed = np.maximum(visible - matched, 0.0)
    told = log_weights + np.outer(matched, np.log(rates)) + np.outer(missed, np.log1p(-rates))
    told = np.exp(told - told.max(axis=1)[:, None])
    return np.asarray(told / told.sum(axis=1)[:, None])


def odds_of_few(chance: Floats, weights: Floats, counts: Integers, maximum: int) -> tuple[float, Floats]:
    """Odds W that at most so few points of each of C images are detected, against clutter alone.

    ``chance`` (C, n, H): of each point to be detected, in each of H cases, whose probabilities are ``weights`` (H,);
    ``counts`` (C,): detections of each image.

    Returns
    -------
    float
        W, prior odds of the presence apart.
    (C n,) float array
        Probability that each point is not detected, if that is so.
    """
    log_each, odds, sums, ways, whole = sum_small_subsets(chance, counts, maximum)
    each = weights * np.exp(log_each)
    total = max(float(each.sum()), 1e-300)
    others, detected = np.ones_like(odds), np.zeros(odds.shape[:2])
    for k in range(1, maximum + 1):
        with_it = odds * others
        detected += np.einsum("cph,ch->cp", with_it, each * ways[k] / whole)
        others = sums[k][:, None] - with_it  # the sets of k points without this one
    return total, np.clip(1.0 - detected.reshape(-1) / total, 0.0, 1.0)


def sum_small_subsets(chance: Floats, counts: Integers, maximum: int) -> tuple[Floats, ...]:
    """Logarithms (H,) of the odds that `odds_of_few` sums in each of some cases, and what they are made of.

    Odds (C, n, H) of each point; their products (most + 1, C, H), summed over the sets of 0, 1, … points; and the ways
    (most + 1, C, 1) to own as many detections, with the sum (C, H) of both.
    """
    chance = np.minimum(chance, HIGHEST_RATE)
    odds = chance / (1.0 - chance)
    sums = np.zeros((maximum + 1, len(odds), odds.shape[2]))
    sums[0] = 1.0
    for point in range(odds.shape[1]):
        sums[1:] += odds[:, point] * sums[:-1]
    ways = count_ways_to_own(counts, maximum)
    whole = (ways * sums).sum(axis=0)
    return np.log1p(-chance).sum(axis=(0, 1)) + np.log(whole).sum(axis=0), odds, sums, ways, whole


def count_ways_to_own(counts: Integers, maximum: int) -> Floats:
    """Ways (most + 1, C, 1) to own 0, 1 … of the detections (C,) of images, times the odds that others are clutter."""
    ways = np.ones((maximum + 1, len(counts), 1))
    for k in range(1, maximum + 1):
        left = np.maximum(counts - k + 1, 0)[:, None]
        ways[k] = ways[k - 1] * left / (np.maximum(left, 1) - 0.5)
    return ways


def count_distributions(visible: Floats, rates: Floats, images: int, maximum: int) -> Floats:
    """Probability (most + 1, C, S Q H) that 0, 1 … points of each image are detected, with any part in sight.

    ``visible`` (S, C n): visibility in each pose; ``rates`` (Q,); for the probabilities of the parts see `SIGHT`.
    """
    each = np.minimum((rates[:, None] * np.array((1.0, *IN_SIGHT))).reshape(-1), HIGHEST_RATE)
    few = np.zeros((maximum + 1, images, len(visible), len(each)))
    few[0] = 1.0
    for sighting in np.flatnonzero(visible.any(axis=0)).tolist():  # those that are never visible take longer than all
        own = few[:, sighting // (visible.shape[1] // images)]
        chance = visible[:, sighting, None] * each
        more = own[:-1] * chance
        own *= 1.0 - chance
        own[1:] += more
    return few.reshape(maximum + 1, images, -1)


def _typical_visibility(model: DetectionModel, turns: int = TURNS) -> Floats:
    """Visibility (S, n) of the points in poses anywhere: of all turns alike, before each camera."""
    if model.normals is None and len(camera_frames(model.camera)[0]) == 1:
        return np.ones((1, len(model.points)))
    at = model.linearise_about(spread_rotations(turns), positions_ahead(model, turns))
    return model.visibility(at, np.zeros(turns))


def positions_ahead(model: DetectionModel, count: int) -> Floats:
    """Positions (count, 3) of the body's centre before each camera in turn, from where a narrow image shows it all."""
    rotations, translations = camera_frames(model.camera)
    which = np.arange(count) % len(rotations)
    narrow = np.maximum(model.camera.focal / np.sqrt(model.areas), 1.0)[which]
    place = np.outer(RADII * model.radius * narrow, [0.0, 0.0, 1.0]) - translations[which]
    return np.asarray((place[:, None] @ rotations[which])[:, 0])


def most_visible(model: DetectionModel) -> int:
    """The most of a body's points that can be seen at once in one image: those that face one direction."""
    count = model.shape[0] // max(len(model.images), 1)
    if model.normals is None or model.view_cosine is None:
        return count
    normals = model.normals[:count]
    length = np.linalg.norm(normals, axis=1)
    along = normals @ normals.T >= model.view_cosine[:count] * length * length[:, None]
    return int(along.sum(axis=1).max(initial=0))
