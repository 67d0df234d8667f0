"""Points that a detector does not resolve: which are one blob, where it is detected, and which point it is."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.model.blobs import (
    assign_blobs,
    average_blobs,
    blob_variance_of,
    find_blobs,
    likeliest_lit_points,
    lit_probabilities,
    swap_to_likeliest,
)
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import weigh_poses

CAMERA = rm.Camera(600.0, 600.0, 320.0, 240.0)
SIGMA = 0.3
APART = 4.0
"""Pixels between the two points that are one detection."""


def joined(pixels: np.ndarray, shown: np.ndarray, resolution: float) -> list[int]:
    """The first point of the blob of each point, by joining two at a time until nothing changes."""
    label = list(range(len(pixels)))
    changed = True
    while changed:
        changed = False
        for i, j in itertools.combinations(range(len(pixels)), 2):
            close = math.dist(pixels[i], pixels[j]) < resolution
            if close and shown[i] and shown[j] and label[i] != label[j]:
                label[i] = label[j] = min(label[i], label[j])
                changed = True
    return label


@pytest.mark.parametrize("seed", range(6))
def test_blobs_are_joined_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pixels = rng.uniform(0.0, 30.0, (5, 14, 2))
    pixels[0, 3], pixels[1, :5] = pixels[0, 7], [[k * 2.9, 0.0] for k in range(5)]  # coincident, and a chain
    shown = rng.random((5, 14)) < 0.8
    found = find_blobs(pixels, shown, 3.0)
    assert found is not None
    for k in range(5):
        assert found[k].tolist() == joined(pixels[k], shown[k], 3.0)


def test_points_far_apart_are_no_blobs() -> None:
    pixels = np.array([[[0.0, 0.0], [3.0, 0.0], [0.0, 3.0]]])
    assert find_blobs(pixels, np.ones((1, 3), np.bool_), 3.0) is None
    assert find_blobs(pixels[:, :0], np.ones((1, 0), np.bool_), 3.0) is None


def drawn(pixels: np.ndarray, lit: np.ndarray, seed: int) -> np.ndarray:
    """Places of a blob whose points are lit by chance, where any is."""
    rng = np.random.default_rng(seed)
    shows = rng.random((200_000, len(lit))) < lit
    shows = shows[shows.any(axis=1)]
    return (shows[:, :, None] * pixels).sum(axis=1) / shows.sum(axis=1)[:, None]


@pytest.mark.parametrize("lit", [[0.9, 0.9], [0.97, 0.97], [0.9, 0.9, 0.9]])
def test_the_moments_of_a_blob_are_those_of_its_mixture(lit: list[float]) -> None:
    pixels, chance = np.array([[0.0, 0.0], [4.0, 0.0], [2.0, 3.0]])[: len(lit)], np.array(lit)
    places = drawn(pixels, chance, 1)
    blob, one = np.zeros((1, len(lit)), np.int64), pixels[None]
    mean = average_blobs(blob, one, chance[None])[0, 0]
    spread = blob_variance_of(blob, one, chance[None])[0, 0]
    np.testing.assert_allclose(mean, places.mean(axis=0), atol=0.05)
    variance = 0.5 * places.var(axis=0).sum()
    assert variance < spread < 1.16 * variance


def test_a_point_by_itself_stays_as_it_is() -> None:
    rng = np.random.default_rng(3)
    blob = np.array([[0, 1, 1, 3]])
    pixels, lit = rng.normal(size=(1, 4, 2)), rng.uniform(0.1, 0.9, (1, 4))
    mean, spread = average_blobs(blob, pixels, lit), blob_variance_of(blob, pixels, lit)
    for alone in (0, 3):
        assert (mean[0, alone] == pixels[0, alone]).all()
        assert spread[0, alone] == 0.0


def test_the_first_point_has_the_detection_of_its_blob() -> None:
    blob = np.array([[0, 0, 2, 0]])
    assert assign_blobs(np.array([[-1, 5, 2, 7]]), blob).tolist() == [[5, -1, 2, -1]]
    assert assign_blobs(np.array([[4, 5, -1, -1]]), blob).tolist() == [[4, -1, -1, -1]]


@pytest.mark.parametrize("place", [-2.0, 0.1, 1.0, 2.0, 3.9, 9.0])
def test_the_chances_of_a_pair_are_those_of_bayes(place: float) -> None:
    pixels, lit, variance = np.array([[0.0, 0.0], [4.0, 0.0]]), np.array([0.9, 0.6]), 0.25
    detection = np.array([place, 0.2])
    states = {(0,): 0.9 * 0.4, (1,): 0.6 * 0.1, (0, 1): 0.9 * 0.6}
    weight = {}
    for state, prior in states.items():
        centre = np.average(pixels[list(state)], axis=0, weights=lit[list(state)])
        weight[state] = prior * math.exp(-0.5 * float(((detection - centre) ** 2).sum()) / variance)
    total = sum(weight.values())
    truth = [sum(value for state, value in weight.items() if k in state) / total for k in (0, 1)]
    np.testing.assert_allclose(lit_probabilities(pixels, lit, detection, variance), truth, rtol=1e-9, atol=1e-12)


def scene(seed: int, both: bool = True) -> tuple[np.ndarray, np.ndarray, list[set[int]], rm.Pose]:
    """Eight points of which two are one detection, or the second of the two is dark: source, target, owners, pose."""
    rng = np.random.default_rng(seed)
    R, t = Rotation.random(random_state=rng).as_matrix(), np.array([0.02, -0.01, 1.2])
    near = np.zeros(1)
    while near.min() < 5.0 * APART:  # of all but the two
        placed = rng.uniform(-0.12, 0.12, (8, 3)) + t
        ray = placed[0] / placed[0, 2]
        placed[1] = (ray + np.array([APART / 600.0, 0.0, 0.0])) * (placed[0, 2] + 0.02)
        pixels = CAMERA.project(placed)
        near = pdist(pixels[[0, *range(2, 8)]])
    spots = [pixels[:2].mean(axis=0) if both else pixels[0], *pixels[2:], [500.0, 90.0], [60.0, 400.0]]
    owners = [{0, 1} if both else {0}, *({k} for k in range(2, 8)), set(), set()]
    order = rng.permutation(len(spots))
    target = np.array(spots)[order] + SIGMA * rng.normal(size=(len(spots), 2))
    return (placed - t) @ R, target, [owners[k] for k in order], rm.Pose(R, t)


def off(pose: rm.Pose, truth: rm.Pose) -> float:
    """Squared deviation of a pose in units of its covariance."""
    assert pose.covariance is not None
    step = np.concatenate([Rotation.from_matrix(truth.R @ pose.R.T).as_rotvec(), truth.t - pose.t])
    return float(step @ np.linalg.solve(pose.covariance, step))


@pytest.mark.parametrize("both", [True, False])
def test_a_blob_is_matched_and_the_pose_stays_true(both: bool) -> None:
    squared = []
    for seed in range(12):
        source, target, owners, truth = scene(seed, both)
        match = rm.match(source, target, rm.P3P(CAMERA), noise=SIGMA, resolution=2.0 * APART)
        assert match
        assert match.pose is not None
        for i, j in match.pairs.tolist():
            assert i in owners[j]
        assert len(match.pairs) == 7
        squared.append(off(match.pose, truth))
    assert np.mean(squared) < 12.0  # 6 of a true covariance; of 12 scenes, 12 is four standard deviations above


def test_without_the_option_a_blob_is_a_misfit() -> None:
    told, known = [], []
    for seed in range(6):
        source, target, _, _ = scene(seed)
        told.append(rm.match(source, target, rm.P3P(CAMERA), noise=SIGMA))
        known.append(rm.match(source, target, rm.P3P(CAMERA), noise=SIGMA, resolution=2.0 * APART))
    assert sum(len(match.pairs) for match in told) < sum(len(match.pairs) for match in known)


def test_nothing_changes_where_all_points_are_resolved() -> None:
    source, target, _, _ = scene(3, both=False)
    apart = source[[0, *range(2, 8)]]
    plain, known = (rm.match(apart, target, rm.P3P(CAMERA), noise=SIGMA, resolution=r) for r in (None, 1e-3))
    np.testing.assert_array_equal(plain.assignment, known.assignment)
    assert plain.probability == known.probability
    assert plain.pose is not None
    assert known.pose is not None
    np.testing.assert_array_equal(plain.pose.R, known.pose.R)


def test_the_label_of_a_blob_follows_its_place() -> None:
    source, target, owners, truth = scene(1, both=False)
    model = DetectionModel(CAMERA, source, target, np.full(len(target), SIGMA), resolution=2.0 * APART)
    R, position = model.centred(truth.R, truth.t)
    named = np.array([next((j for j, own in enumerate(owners) if i in own), -1) for i in range(8)])
    surest, chance = likeliest_lit_points(model, named, (R, position)) or pytest.fail("nothing is merged")
    assert surest.tolist() == list(range(8))
    assert chance[0] > 0.99
    assert (chance[1:] == 1.0).all()
    at_second = model.target.copy()
    at_second[named[0]] = CAMERA.project((source @ truth.R.T + truth.t)[1:2])[0]
    moved, chance = likeliest_lit_points(replace(model, target=at_second), named, (R, position)) or pytest.fail(
        "as before"
    )
    assert moved.tolist() == [1, *range(1, 8)]
    swapped, values = swap_to_likeliest(named, np.arange(8.0), moved)
    assert swapped.tolist() == [-1, named[0], *named[2:]]
    assert values.tolist() == [1.0, 0.0, *range(2, 8)]
    evidence, at = weigh_poses(model, named[None], R[None], position[None])
    assert at.blob is not None
    assert at.blob[0, 1] == 0
    assert np.isfinite(evidence.log_odds).all()
    # among poses of which only some show blobs
    far = Rotation.from_rotvec([0.0, 1.2, 0.0]).as_matrix() @ R
    _, without = weigh_poses(model, named[None], far[None], position[None])
    assert without.blob is None
    several, expected = (
        model.linearise_about(np.array(poses), np.array([position, position])) for poses in ((far, far), (far, R))
    )
    mixed = several.replace_rows(np.array([1]), at)
    for field, values in expected._asdict().items():
        np.testing.assert_allclose(np.asarray(getattr(mixed, field), float), np.asarray(values, float), err_msg=field)
    np.testing.assert_array_equal(expected.replace_rows(np.array([1]), without).blob, np.tile(np.arange(8), (2, 1)))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"resolution": 0.0}, "resolution: 0.0 given; give a positive number"),
        ({"resolution": -2.0}, "resolution: -2.0 given; give a positive number"),
        ({"resolution": math.nan}, "resolution: nan given; give a positive number"),
        ({"resolution": "x"}, "resolution: 'x' given; give a positive number"),
        ({"resolution": 2.0, "motions": 2}, "resolution: not supported with motions=; leave one of them out"),
        ({"resolution": 2.0, "preset": "paper"}, "resolution: not supported with preset=; leave one of them out"),
    ],
)
def test_bad_input_is_one_clear_error(changes: dict[str, object], text: str) -> None:
    source, target, _, _ = scene(0)
    with pytest.raises(rm.InputError) as refused:
        rm.match(source, target, rm.P3P(CAMERA), noise=SIGMA, **changes)  # type: ignore[arg-type]
    assert str(refused.value) == text


def test_rays_have_no_pixels_to_merge() -> None:
    source, target, _, _ = scene(0)
    with pytest.raises(
        rm.InputError, match=r"^resolution: p3p has no camera in whose image points could fall together"
    ):
        rm.match(source, CAMERA.bearings(target), rm.P3P(rm.Bearings()), noise=5e-4, resolution=2.0)
