"""Two copies of a body in view, of which one was asked for: nothing tells which."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rootmatch as rm


@pytest.mark.parametrize("seed", [1009, 1016])
def test_another_copy_is_looked_for_once_one_is_found(seed: int) -> None:
    """The search of the first frame may end by its budget with the copy of which more is seen, before the other."""
    rng = np.random.default_rng(seed)
    body = rng.uniform(-0.1, 0.1, (9, 3))
    camera = rm.Camera(800.0, 800.0, 320.0, 240.0, size=(640, 480))
    turns, places = Rotation.random(2, random_state=seed).as_matrix(), ((-0.17, 0.0, 0.9), (0.2, 0.05, 1.1))
    tracker, told = rm.Tracker(body, rm.P3P(camera), noise=0.25), list[rm.Status]()
    for frame in range(8):
        sway = Rotation.from_rotvec([0.0, 0.0, 0.01 * frame]).as_matrix()
        seen = [
            camera.project((body - body.mean(axis=0)) @ (R @ sway).T + t) for R, t in zip(turns, places, strict=True)
        ]
        image = np.concatenate([one[rng.random(9) < 0.9] for one in seen])
        image = image[rng.permutation(len(image))] + rng.normal(0.0, 0.25, image.shape)
        told.append(tracker.update(image, time=frame / 60.0).status)
    assert told[0] in (rm.Status.MATCHED, rm.Status.AMBIGUOUS)
    assert told[2:] == [rm.Status.AMBIGUOUS] * 6
