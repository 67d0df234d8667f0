"""What poses of minimal sets gather, against the same to first order, one pose at a time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rootmatch as rm
from rig_scenes import NOISE, VIEW, controllers, frame, headset
from rootmatch.explain.image_hypotheses import Candidate, make_detection_model
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.gathering import RATE, gather_assignments, gather_each
from rootmatch.model.prediction import HIDDEN
from rootmatch.model.proposals import MinimalSets, solve_minimal_sets
from rootmatch.problems.limits import GATE
from rootmatch.simulation import p3p_scene

RIG = headset()
POINTS, NORMALS, _ = controllers()
LEDS = len(POINTS) // 2


def gathered_slowly(model: DetectionModel, sources: NDArray, at: Any, visible: NDArray) -> tuple[NDArray, float]:
    """What one pose of the points with ``sources`` gathers, and its log-odds."""
    own = np.flatnonzero(sources >= 0)
    if (visible[own] <= HIDDEN).any():
        return sources, -np.inf
    A = sum(at.jacobian[0, i].T @ at.jacobian[0, i] / model.sigma[sources[i]] ** 2 for i in own)
    covariance = np.linalg.inv(A)
    images = model.images or [np.arange(model.shape[1])]
    out, total, n = sources.copy(), 0.0, model.shape[0] // len(images)
    for camera, detections in enumerate(images):
        part, hit = 0.0, False
        for i in range(camera * n, (camera + 1) * n):
            chance = min(RATE * visible[i], 0.999)
            if visible[i] <= HIDDEN:
                continue
            if sources[i] >= 0:
                part, hit = part + np.log(chance), True
                continue
            values = {}
            for j in detections:
                if j in out:
                    continue
                spread = at.jacobian[0, i] @ covariance @ at.jacobian[0, i].T + model.sigma[j] ** 2 * np.eye(2)
                off = model.target[j] - at.pixels[0, i]
                squared = float(off @ np.linalg.solve(spread, off))
                value = np.log(chance / (1.0 - chance)) - 0.5 * squared - 0.5 * np.log(np.linalg.det(spread))
                if squared <= GATE**2:
                    weight = model.weights_of_pairs[i, j] if len(model.weights_of_pairs) else 0.0
                    values[j] = value - np.log(2.0 * np.pi) - model.clutter.log_density[j] + weight
            best = max(values, key=values.__getitem__, default=None)
            part += np.log1p(-chance)
            if best is not None and values[best] > 0.0:
                out[i], part, hit = best, part + values[best], True
        total += part if hit else 0.0
    return out, total


def compared(model: DetectionModel, sets: MinimalSets) -> int:
    """Compare all poses of some minimal sets; how many lead to an assignment."""
    assignments, gains = gather_each(model, sets.alone)
    for k, one in enumerate(sets.members):
        sources = np.full(model.shape[0], -1)
        sources[one] = sets.proposals.assignments[k, one]
        at = model.linearise_about(sets.proposals.rotation[[k]], sets.proposals.position[[k]])
        expected, gain = gathered_slowly(model, sources, at, model.visibility(at, np.zeros(1))[0])
        assert gains[k] == pytest.approx(gain, rel=1e-6, abs=1e-6)
        if np.isfinite(gain):
            np.testing.assert_array_equal(assignments[k], expected)
    return int(np.isfinite(gains).sum())


@pytest.mark.parametrize("seed", [0, 2, 3, 4])
def test_in_all_cameras_of_a_rig(seed: int) -> None:
    scene = frame(seed, 0, RIG, clutter=2)
    known: dict[str, Any] = {"noise": NOISE, "normals": NORMALS[:LEDS], "view_angle": np.radians(VIEW)}
    model = make_detection_model(MatchingTask.of(rm.P3P(RIG), POINTS[:LEDS], scene.rows, **known))
    camera = int(np.argmax((scene.truth >= 0).sum(axis=1)))
    seen = np.random.default_rng(seed).permutation(np.flatnonzero(scene.truth[camera] >= 0))[:3]
    rows = np.full((2, *scene.truth.shape), -1)
    rows[:, camera, seen] = scene.truth[camera, seen]
    rows[1, camera, seen] = np.roll(scene.truth[camera, seen], 1)  # a false one
    assert compared(model, solve_minimal_sets(model, rows.reshape(2, -1), 3)) >= 1


@pytest.mark.parametrize("weighed", [False, True])
def test_in_one_image_of_hyperedges(weighed: bool) -> None:
    scene = p3p_scene(8, 5, noise=1.0, seed=3)
    task = MatchingTask.of(scene.problem, scene.source, scene.target, noise=1.0)
    if weighed:
        weights = np.random.default_rng(0).uniform(0.2, 1.0, task.shape)
        weights[scene.truth[2] :: 4, 2] = 0.0
        task = MatchingTask.of(scene.problem, scene.source, scene.target, noise=1.0, candidates=weights)
    model = make_detection_model(task)
    rng, rows = np.random.default_rng(1), np.full((6, 8), -1)
    for k, row in enumerate(rows):
        points = rng.permutation(8)[:4]
        row[points] = scene.truth[points] if k < 4 else rng.permutation(13)[:4]
    sets = solve_minimal_sets(model, rows, 4)
    assert compared(model, sets) >= 4
    if not weighed:
        first, *_ = gather_assignments(model, sets.alone, minimum=4, maximum=2).assignments
        assert ((first == scene.truth) | (first < 0)).all()
        assert (first >= 0).sum() >= 7


def test_a_body_among_other_parts_of_a_solution_is_gathered_from_a_hyperedge() -> None:
    """A solver's assignment of all points, four of them to clutter: it fits nowhere, the hyper-edges of the rest do."""
    scene, rng = p3p_scene(12, 6, noise=0.5, seed=5), np.random.default_rng(2)
    truth = np.where(np.arange(12) < 8, scene.truth, -1)
    clutter = np.setdiff1d(np.arange(18), truth)
    target = scene.target.copy()
    target[clutter] = rng.uniform(target.min(axis=0), target.max(axis=0), (len(clutter), 2))
    task = MatchingTask.of(scene.problem, scene.source, target, noise=0.5)
    every = np.array([(0, 1, 2, 3), (2, 3, 4, 5), (4, 5, 6, 7), (1, 3, 5, 7), (6, 7, 8, 9), (8, 9, 10, 11)])
    indices = (every * 18 + scene.truth[every]).astype(np.int32)
    tensor = AffinityTensor.unchecked(indices, np.full(len(every), 0.5), task.shape, None)
    without, found = Candidate.of(task, [scene.truth]), Candidate.of(task, [scene.truth], tensor)
    assert without.modes.log_odds.max(initial=-np.inf) < 0.0
    assert found.modes.log_odds[0] > 5.0
    np.testing.assert_array_equal(found.modes.assignments[0], truth)


def test_nothing_is_gathered_from_an_empty_tensor() -> None:
    scene = p3p_scene(6, 2, noise=1.0, seed=0)
    task = MatchingTask.of(scene.problem, scene.source, scene.target, noise=1.0)
    empty = AffinityTensor.unchecked(np.empty((0, 4), np.int32), np.empty(0), task.shape, None)
    assert Candidate.of(task, []).gather_from_tensor(empty) == []
    assert not len(Candidate.of(replace(task), [], empty).modes.log_odds)
