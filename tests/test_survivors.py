"""Which survivors of the sequential test are verified."""

from __future__ import annotations

import numpy as np

from rootmatch.samplers.guided.survivors import Survivors

POINTS = np.array([[0, 1], [1, 2], [0, 3]])
"""Three minimal sets of two points."""
KNOWN = np.array([5, 6, 7, -1])
"""An assignment of four points."""


def survivors(*rows: tuple[int, int, int, int, float]) -> Survivors:
    """Of rows with set, root, both images and ratio, in one chunk with a free place."""
    listed = np.array([[*(row[:4] for row in rows), (-1, -1, -1, -1)]])
    ratios = np.array([[*(row[4] for row in rows), -np.inf]])
    return Survivors.of(POINTS, listed, ratios, maximum=4)


def test_survivors_of_the_highest_ratio_come_first() -> None:
    found = survivors((0, 1, 5, 6, 2.0), (2, 0, 1, 2, 9.0), (1, 0, 3, 4, 4.0), (1, 1, 3, 5, 1.0), (0, 0, 8, 9, 3.0))
    assert found.ratios.tolist() == [9.0, 4.0, 3.0, 2.0]
    assert found.points.tolist() == [[0, 3], [1, 2], [0, 1], [0, 1]]
    assert found.images[0].tolist() == [0, 1, 2]


def test_rivals_are_other_poses_with_a_fair_ratio() -> None:
    same, rival, weak = (0, 1, 5, 6, 10.0), (2, 0, 6, 5, 4.0), (1, 0, 3, 4, 1.0)
    left = survivors(same, rival, weak).rivals_of(KNOWN, 0.25)
    assert left.images.tolist() == [[0, 6, 5]]
    # where the known one was not met nothing tells how high its ratio is
    assert len(survivors(rival, weak).rivals_of(KNOWN, 0.25).ratios) == 2


def test_two_roots_with_the_images_of_a_known_assignment_may_be_two_poses() -> None:
    left = survivors((0, 0, 5, 6, 10.0), (0, 1, 5, 6, 9.0), (1, 0, 6, 7, 8.0)).rivals_of(KNOWN, 0.25)
    assert left.sets.tolist() == [0, 0]
