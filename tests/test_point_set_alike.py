"""Two sets of one law: not the same points, and how the same points are told from them."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.arrays import Floats, Integers
from rootmatch.model.point_set_alike import weigh_likeness
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.problems.points import PointClouds
from rootmatch.samplers.point_sets.congruent import congruent_labellings

Scene = tuple[Floats, Floats, Integers]


def pair(first: Floats, second: Floats, ends: tuple[float, float], sigma: float, rng: np.random.Generator) -> Scene:
    """Points of one scene up to an end, and of another from an end on, turned; the labels, if both are one scene."""
    own = np.flatnonzero((first[:, 0] < ends[0]) & (rng.random(len(first)) > 0.15))
    others = rng.permutation(np.flatnonzero((second[:, 0] > ends[1]) & (rng.random(len(second)) > 0.15)))
    size = first.shape[1]
    if size == 3:
        turn = Rotation.random(random_state=rng).as_matrix()
    else:
        turn = Rotation.from_euler("z", rng.uniform(-3.0, 3.0)).as_matrix()[:2, :2]
    source = first[own] + rng.normal(0.0, sigma, (len(own), size))
    target = second[others] @ turn.T + rng.normal(0.0, sigma, (len(others), size))
    place = np.full(len(second), -1)
    place[others] = np.arange(len(others))
    return source, target, place[own] if first is second else np.full(len(own), -1)


def street(rng: np.random.Generator, off: float) -> Floats:
    """Trees on both sides, every ten metres, off their places."""
    along = np.arange(16) * 10.0
    trees = np.concatenate([np.stack([along, 0.0 * along], 1), np.stack([along + 3.0, 0.0 * along + 12.0], 1)])
    return trees + rng.normal(0.0, off, trees.shape)


def streets(seed: int, *, same: bool, off: float = 0.25) -> Scene:
    """Two drives along one street, or along two, which have 70 m in common."""
    rng = np.random.default_rng(seed)
    first = street(rng, off)
    second = first if same else street(rng, off)
    middle = rng.uniform(60.0, 90.0)
    return pair(first, second, (middle + 35.0, middle - 35.0), 0.1, rng)


def racks(seed: int) -> Scene:
    """Two halves of a rack of eight bays, whose corners are off by 3 cm."""
    rng = np.random.default_rng(seed)
    corners = np.stack(np.meshgrid(np.arange(8.0), [0.0, 1.0], [0.0, 1.0]), axis=3).reshape(-1, 3) * (1.2, 0.9, 1.6)
    corners = corners + rng.normal(0.0, 0.03, corners.shape)
    middle = rng.uniform(3.0, 5.5)
    return pair(corners, corners, (middle + 2.0, middle - 2.2), 0.015, rng)


def spirals(seed: int) -> Scene:
    """Two parts of one logarithmic spiral with seven points in common, off by .02 of their spacing, in two sizes."""
    rng = np.random.default_rng([seed, 5])
    radius, angle = 10.0 * 1.2 ** np.arange(13), 0.7 * np.arange(13)
    points = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    points += 0.01 * radius[:, None] * rng.normal(size=points.shape)
    turn = np.exp(rng.uniform(-1.0, 1.0)) * Rotation.from_euler("z", rng.uniform(-3.0, 3.0)).as_matrix()[:2, :2]
    others = rng.permutation(np.arange(3, 13))
    target = points[others] @ turn.T + rng.normal(0.0, 0.3, (10, 2))
    place = np.full(13, -1)
    place[others] = np.arange(10)
    return points[:10], target, place[:10]


def model_of(scene: Scene, sigma: float) -> PointSetModel:
    u, v = (np.full(len(points), sigma**2) for points in scene[:2])
    return PointSetModel(PointClouds(scene[0], scene[1], u, v, scaled=False, mirror=False))


def test_streets_that_have_nothing_in_common_are_rarely_trusted() -> None:
    trusted = 0
    for seed in (1022, 1044, *range(1000, 1004)):
        source, target, _ = streets(seed, same=False, off=0.5)
        trusted += bool(rm.match(source, target, rm.Rigid(2), noise=(0.1, 0.1)))
    assert not trusted


def test_racks_are_matched_where_all_else_in_view_is_alike() -> None:
    right = 0
    for seed in (1016, 1018, 1019, 1020, 1025):
        source, target, truth = racks(seed)
        match = rm.match(source, target, rm.Rigid(3), noise=(0.015, 0.015))
        matched = match.assignment >= 0
        is_right = bool(matched.any() and (match.assignment == truth)[matched].all())
        assert is_right or not match
        right += is_right
    assert right >= 4


def test_an_alike_scene_is_more_probable_than_the_same_where_it_is_another() -> None:
    for same in (True, False):
        lead = []
        for seed in (1016, 1011, 1012) if same else (1013, 1022):
            model = model_of(scene := streets(seed, same=same), 0.1)
            proposals = congruent_labellings(model.clouds, mirror=False).proper
            proposals = np.concatenate([scene[2][None], proposals]) if same else proposals
            judged = model.judge(proposals)
            told = weigh_likeness(model, judged)
            assert np.isfinite(told.log_odds)
            best = judged.log_odds + told.log_factors(judged.fit.assignments)
            lead.append(float(best.max()) - told.log_odds)
            if same:
                assert (judged.fit.assignments[best.argmax()] == scene[2]).mean() > 0.8
        assert (np.array(lead) > 4.0).all() if same else (np.array(lead) < 0.0).all()
    # where neither is, the labellings of both models are too many for any to be trusted
    source, target, _ = streets(1010, same=False)
    assert not rm.match(source, target, rm.Rigid(2), noise=(0.1, 0.1))


def test_points_without_a_law_have_nothing_alike() -> None:
    rng = np.random.default_rng(5)
    scene = pair(points := rng.uniform(0.0, 10.0, (24, 2)), points, (7.0, 3.0), 0.05, rng)
    model = model_of(scene, 0.05)
    judged = model.judge(np.concatenate([scene[2][None], congruent_labellings(model.clouds, mirror=False).proper]))
    told = weigh_likeness(model, judged)
    assert told.log_odds < judged.log_odds.max() - 6.0
    assert np.abs(told.log_factors(judged.fit.assignments[:1])).max(initial=0.0) < 0.1


def test_what_is_like_itself_in_another_size_is_not_matched_three_steps_away() -> None:
    """Without sets that are alike none of these has the right labels, and one is trusted."""
    for seed in (0, 4, 9, 11, 13):
        source, target, truth = spirals(seed)
        match = rm.match(source, target, rm.Similarity(2), noise=0.3)
        matched = match.assignment >= 0
        assert matched.any()
        assert (match.assignment == truth)[matched].all()
