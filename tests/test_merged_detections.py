"""Detections that a detector joined, where no `resolution=` was given: the advice names it where the model finds so."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm
from rootmatch.explain.merged_detections import find_merged

CAMERA = rm.Camera(800.0, 800.0, 640.0, 480.0)
SIGMA, VIEW = 0.3, np.radians(80.0)


def scene(seed: int, near: float) -> tuple[dict[str, Any], int]:
    """Nine pairs of lamps on a ball before five clutter points, those within ``near`` px joined; how many were."""
    rng = np.random.default_rng(seed)
    outward = rng.normal(size=(9, 3))
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    half = 0.004 * rng.normal(size=(9, 3))
    body, normals = np.vstack([0.12 * outward + half, 0.12 * outward - half]), np.vstack([outward, outward])
    R = Rotation.random(random_state=seed).as_matrix()
    moved = body @ R.T + [rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2), rng.uniform(1.2, 2.0)]
    cosine = -((normals @ R.T) * moved).sum(axis=1) / np.linalg.norm(moved, axis=1)
    (shown,) = np.nonzero(cosine > np.cos(VIEW))
    pixels = CAMERA.project(moved) + rng.normal(0.0, SIGMA, (18, 2))
    spots, joined = list[Any](), 0
    for k in shown[shown < 9].tolist():
        pair = pixels[[k, k + 9]]
        close = bool(np.linalg.norm(pair[0] - pair[1]) < near)
        joined += close
        spots += [pair.mean(axis=0)] if close else [*pair]
    target = np.vstack([*spots, rng.uniform((300, 200), (1000, 760), (5, 2))])
    return {"source": body, "target": target, "problem": rm.P3P(CAMERA), "normals": normals, "view_angle": VIEW}, joined


@pytest.mark.parametrize("seed", [1001, 1006, 1032])
def test_a_resolution_is_named_where_the_image_tells_of_one(seed: int) -> None:
    given, joined = scene(seed, 4.0)
    assert joined >= 2
    match = rm.match(**given, noise=SIGMA)
    assert not match
    found = find_merged(match.finding)
    assert found is not None
    assert 1.0 < found.resolution <= 8.0
    assert f"give `resolution={found.resolution:g}`" in match.advice
    told = rm.match(**given, noise=SIGMA, resolution=4.0)
    assert told
    assert "resolution" not in told.advice


def test_no_resolution_is_named_where_nothing_was_joined() -> None:
    """Of few points that are ambiguous or chance, some of which lie near each other in the image."""
    untrusted = 0
    for seed in range(1000, 1040):
        given, joined = scene(seed, 0.0)
        assert not joined
        match = rm.match(**given, noise=SIGMA)
        untrusted += not match and find_merged(match.finding) is not None
        assert "resolution" not in match.advice
    assert untrusted >= 3
