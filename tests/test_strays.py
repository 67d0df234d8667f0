"""Strays in space: what several cameras see in one place is no evidence for a body that has a point there."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp

import instances
import rootmatch as rm
from rootmatch.arrays import Floats, Integers
from rootmatch.explain.image_hypotheses import make_detection_model
from rootmatch.explain.task import MatchingTask
from rootmatch.model.evidence import settle_poses
from rootmatch.model.mode_search import find_modes
from rootmatch.model.modes import used_mask
from rootmatch.model.proposals import Proposals
from rootmatch.model.strays import find_strays, stray_log_gains

CAMERA, CAMERAS, SIGMA = rm.Camera(1900.0, 1900.0, 1024.0, 1024.0), 7, 0.2


class Room(NamedTuple):
    """A body of five points, detections of it and of strays (rows of x, y, camera), the rig, and what is whose.

    ``own`` (C, 5) and ``strays`` (C, S): the detection of each in each camera, −1 for none.
    """

    points: Floats
    rows: Floats
    rig: rm.Rig
    own: Integers
    strays: Integers
    pose: tuple[Floats, Floats]


def room(seed: int, strays: int, *, present: bool = True) -> Room:
    """Seven cameras about a room, a body amid it, and strays in crowds of the body's size; each is missed with .05."""
    rng, views = np.random.default_rng(seed), []
    for angle in 2.0 * np.pi * np.arange(CAMERAS) / CAMERAS + 0.3:
        centre = np.array([4.5 * np.cos(angle), 3.5 * np.sin(angle), 2.6])
        R = instances.look_at(centre, np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0]))
        views.append((CAMERA, R, -R @ centre))
    points, turn = rng.uniform(-0.1, 0.1, (5, 3)), Rotation.random(rng=rng).as_matrix()
    t = np.append(rng.uniform(-1.0, 1.0, 2), 1.1)
    crowds = (
        rng.uniform(-0.1, 0.1, (strays, 3)) + rng.uniform((-1, -1, 0.5), (1, 1, 1.5), (2, 3))[np.arange(strays) % 2]
    )
    every, number = np.concatenate([points @ turn.T + t, crowds]), 0
    seen, rows = np.full((CAMERAS, len(every)), -1), []
    for k, (_, R, shift) in enumerate(views):
        shown = (rng.random(len(every)) > 0.05) & (present | (np.arange(len(every)) >= 5))
        pixels = CAMERA.project(every[shown] @ R.T + shift)
        rows.append(np.column_stack([pixels + rng.normal(0.0, SIGMA, pixels.shape), np.full(len(pixels), k)]))
        seen[k, shown] = number + np.arange(len(pixels))
        number += len(pixels)
    rig = rm.Rig(views, sizes=[(2048, 2048)] * CAMERAS)
    return Room(points, np.concatenate(rows), rig, seen[:, :5], seen[:, 5:], (turn, t))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_strays_are_what_several_cameras_see_in_one_place(seed: int) -> None:
    """The points of the body are some of them, as long as nobody asks for a body."""
    scene = room(seed, 14)
    found = find_strays(make_detection_model(MatchingTask.of(rm.P3P(scene.rig), scene.points, scene.rows, noise=SIGMA)))
    truth = np.concatenate([scene.own, scene.strays], axis=1).T
    assert {tuple(row) for row in found.detections.tolist()} == {tuple(row) for row in truth.tolist()}
    used = found.detections[found.detections >= 0]
    assert len(used) == len(set(used.tolist()))


def test_the_evidence_of_a_stray_is_an_integral_over_its_place() -> None:
    """By Laplace's method, as that of a body; here by importance sampling, with σ known exactly."""
    scene = room(0, 14)
    task = MatchingTask.of(rm.P3P(scene.rig), scene.points, scene.rows, noise=SIGMA)
    model, detections, position, _ = find_strays(replace(make_detection_model(task), noise_freedom=1e6))
    rng, turn = np.random.default_rng(0), np.eye(3)[None]
    for row, place in zip(detections[:4], position[:4], strict=True):
        found, at = settle_poses(model, row[None], turn, place[None])
        spread = found.covariance[0, 3:, 3:]
        drawn = rng.multivariate_normal(at.position[0], 2.0 * spread, 20_000)
        off = drawn - at.position[0]
        proposal = (
            -0.5 * (off @ np.linalg.inv(2.0 * spread) * off).sum(axis=1) - 0.5 * np.linalg.slogdet(2.0 * spread)[1]
        )
        own = row >= 0
        pixels = model.linearise_about(np.broadcast_to(turn, (20_000, 3, 3)), drawn).pixels[:, own]
        squared = ((model.target[row[own]] - pixels) ** 2).sum(axis=(1, 2)) / SIGMA**2
        _, prior = model.prior.position_terms(drawn)  # type: ignore[attr-defined]
        within = logsumexp(prior - 0.5 * squared - proposal) - np.log(len(drawn)) + 1.5 * np.log(2.0 * np.pi)
        taken = used_mask(row[None], model.shape[1])
        clutter = model.clutter.log_density[row[own]].sum() - model.log_odds_of_left(taken)[0]
        expected = within - own.sum() * np.log(2.0 * np.pi * SIGMA**2) - clutter
        np.testing.assert_allclose(found.place_log_odds[0], expected, atol=0.2)  # crowds that lose a member


def test_a_stray_with_single_sightings_is_no_body() -> None:
    """What the cameras' agreement on one place is worth is taken off; the body itself has nine distances more."""
    scene = room(3, 14)
    model = make_detection_model(MatchingTask.of(rm.P3P(scene.rig), scene.points, scene.rows, noise=SIGMA))
    turn, t = scene.pose
    position = t + turn @ model.centre
    true = find_modes(model, Proposals(scene.own.reshape(1, -1), turn[None], position[None]))
    rival = np.full((CAMERAS, 5), -1)
    rival[:, 2] = scene.strays[:, 0]
    strays = find_strays(model)
    place = strays.position[(strays.detections == scene.strays[:, 0]).all(axis=1)][0]
    alone, at = settle_poses(
        model, rival.reshape(1, -1), turn[None], (place + turn @ (model.centre - scene.points[2]))[None]
    )
    assert alone.log_odds[0] > 20.0  # against clutter that is independent
    modes = true._replace(
        assignments=rival.reshape(1, -1), rotation=at.rotation, position=at.position,
        log_odds=alone.log_odds, log_mass=alone.log_odds,
    )  # fmt: skip
    assert alone.log_odds[0] + np.asarray(stray_log_gains(model, modes))[0] < -10.0
    told = true.log_odds[0] + np.asarray(stray_log_gains(model, true))[0]
    assert 40.0 < told < 120.0


def test_what_no_other_camera_sees_has_no_strays_in_space() -> None:
    scene = room(4, 14)
    rng = np.random.default_rng(4)
    rows = np.column_stack([rng.uniform(0.0, 2048.0, (70, 2)), np.repeat(np.arange(CAMERAS), 10)])
    model = make_detection_model(MatchingTask.of(rm.P3P(scene.rig), scene.points, rows, noise=SIGMA))
    assert (find_strays(model).detections >= 0).sum() <= 6


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_body_among_strays_is_trusted_and_strays_are_not(seed: int) -> None:
    scene = room(seed, 24)
    match = rm.match(scene.points, scene.rows, rm.P3P(scene.rig), noise=SIGMA)
    assert match
    assert match.sightings is not None
    assert np.array_equal(match.sightings.assignment, scene.own)
    scene = room(seed, 24, present=False)
    assert rm.match(scene.points, scene.rows, rm.P3P(scene.rig), noise=SIGMA).status is rm.Status.UNTRUSTED
