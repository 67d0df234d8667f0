"""Modes that are part of others, against every pair of them compared."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.model.compiled.same_pose import is_same_pose
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.mode_search import NO_STEP, SAME_POSE, _insert_mode, _is_known, _Mode, find_modes
from rootmatch.model.modes import empty_changes
from rootmatch.model.proposals import Proposals


def modes(count: int, seed: int) -> list[_Mode]:
    """Modes at a few places and turns, of which many are the same but for their noise."""
    rng = np.random.default_rng(seed)
    turns, places = Rotation.random(6, rng=rng), rng.normal(size=(3, 3))
    made = []
    for _ in range(count):
        turn = Rotation.from_rotvec(rng.normal(scale=0.05, size=3)) * turns[int(rng.integers(6))]
        odds = float(rng.normal(scale=5.0))
        made.append(
            _Mode(
                assignment=rng.permutation(5), rotation=turn.as_matrix(),
                position=places[rng.integers(3)] + rng.normal(scale=0.05, size=3), covariance=0.05**2 * np.eye(6),
                log_odds=odds, log_mass=odds + float(rng.uniform(0.0, 2.0)), local=np.ones(5), freedom=4.0,
                visible=np.ones(5), detected=5.0, unmatched=np.zeros(5), summed=False, near=empty_changes(5),
            )
        )  # fmt: skip
    return made


def is_same(one: _Mode, other: _Mode) -> bool:
    return bool(is_same_pose(one.pose, other.pose, NO_STEP, SAME_POSE))


def test_modes_that_are_part_of_others_are_those_of_all_pairs() -> None:
    kept: list[_Mode] = []
    known, given_way = 0, 0
    for mode in modes(200, 0):
        expected = any(mode.log_odds <= other.log_mass and is_same(mode, other) for other in kept)
        assert _is_known(mode, kept) == expected
        known += expected
        if not expected:
            left = [other for other in kept if not is_same(other, mode)]
            given_way += len(kept) - len(left)
            kept = _insert_mode(kept, mode)
            assert kept == sorted([*left, mode], key=lambda one: -one.log_mass)
    assert min(known, given_way, len(kept)) > 10


def test_a_mode_that_gains_a_match_grows_however_many_are_as_good_before() -> None:
    """Twelve turns of a bolt circle explain its bolts alike, and one its key as well, which is farther away there."""
    camera, angle, rng = rm.Camera(900.0, 900.0, 640.0, 480.0), np.arange(12) * np.pi / 6.0, np.random.default_rng(1)
    body = np.array([*np.column_stack([np.cos(angle), np.sin(angle), np.zeros(12)]), [-0.6, -0.1, 0.0]])
    R, t = Rotation.from_rotvec([0.4, 0.5, 0.2]).as_matrix(), np.array([0.3, -0.2, 9.0])
    model = DetectionModel(
        camera, body, camera.project(body @ R.T + t) + rng.normal(0.0, 0.2, (13, 2)), np.full(13, 0.2)
    )
    turns = Rotation.from_rotvec(angle[:, None] * (0.0, 0.0, 1.0)).as_matrix()
    bolts = np.array([[*(np.arange(12) + k) % 12, -1] for k in range(12)])
    position = (R @ turns) @ body.mean(axis=0) + t
    found = find_modes(model, Proposals(bolts, R @ turns, position))
    assert found.assignments[0].tolist() == list(range(13))
    assert found.log_mass[0] > found.log_mass[1] + 5.0
