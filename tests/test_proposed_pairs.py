"""Several motions among proposed pairs, most of them false: the pairs that there are are enumerated."""

from __future__ import annotations

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.algebra.rotation import rotation_from_vector
from rootmatch.explain.match_options import MatchOptions
from rootmatch.explain.proposed_pairs import is_worth_drawing
from rootmatch.explain.task import MatchingTask

CAMERA = rm.Camera(1000.0, 1000.0, 320.0, 240.0)
POSES = [
    (rotation_from_vector(np.array([[0.3, -0.4, 0.2]]))[0], np.array([-1.5, 0.2, 12.0])),
    (rotation_from_vector(np.array([[-0.2, 0.9, 0.1]]))[0], np.array([1.6, -0.3, 13.0])),
]


def proposed(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points, pixels, mask and labels: a fifth of the pairs belongs to each of two poses, the rest is false."""
    rng = np.random.default_rng(seed)
    source = rng.uniform(-1.0, 1.0, (count, 3))
    target = rng.uniform((0.0, 0.0), (640.0, 480.0), (count, 2))
    labels = np.full(count, -1)
    for label, (rotation, t) in enumerate(POSES):
        members = np.arange(label * count // 5, (label + 1) * count // 5)
        target[members] = CAMERA.project(source[members] @ rotation.T + t) + rng.normal(0.0, 1.0, (len(members), 2))
        labels[members] = label
    order = rng.permutation(count)
    mask = np.zeros((count, count), np.bool_)
    mask[np.arange(count), np.argsort(order)] = True
    return source, target[order], mask, labels


@pytest.mark.parametrize("motions", [2, "auto"])
def test_both_motions_are_found(motions) -> None:  # type: ignore[no-untyped-def]
    source, target, mask, labels = proposed(300, 0)
    match = rm.match(source, target, rm.P3P(CAMERA), noise=1.0, candidates=mask, motions=motions)
    assert match.status is rm.Status.MATCHED
    assert match.motion_labels.max() == 1
    matched = match.assignment >= 0
    assert mask[np.flatnonzero(matched), match.assignment[matched]].all()
    assert (labels[matched] >= 0).mean() > 0.95
    assert matched[labels >= 0].mean() > 0.95
    assert match.probability is not None
    assert match.probability > 0.9  # of two motions, each with 0.95
    assert match.confidence[matched].min() > 0.95
    for rotation, t in POSES:
        error = min(np.abs(pose.R - rotation).max() + np.abs(pose.t - t).max() for pose in match.poses)
        assert error < 0.1


def test_false_pairs_alone_make_no_motion() -> None:
    source, target, mask, _ = proposed(300, 1)
    mask = mask[:, np.random.default_rng(2).permutation(300)]
    match = rm.match(source, target, rm.P3P(CAMERA), noise=1.0, candidates=mask, motions="auto")
    assert match.status is rm.Status.UNTRUSTED
    assert not (match.assignment >= 0).any()
    assert match.probability == 0.0


def test_where_there_are_many_candidates_nothing_changes() -> None:
    source, target, mask, _ = proposed(80, 3)
    options = MatchOptions(motions=2)

    def task(candidates):  # type: ignore[no-untyped-def]
        return MatchingTask.of(rm.P3P(CAMERA), source, target, candidates=candidates, options=options)

    assert is_worth_drawing(task(mask))
    assert not is_worth_drawing(task(np.ones_like(mask)))
    assert not is_worth_drawing(task(None))
