"""What is told of images in which nothing was found: a search of two may have missed a pose if the axes are vague."""

from __future__ import annotations

import math

from rootmatch.problems.base import Problem


def has_vague_axes(problem: Problem) -> bool:
    """Whether the common direction of two images is known so little that a search loses poses by that."""
    if float(getattr(problem, "axis_noise", 0.0)) <= 0.0:
        return False
    from rootmatch.samplers.two_views.covering_sets import NEAR  # slow to import

    return bool(problem.tilt_variance > NEAR**2)  # type: ignore[attr-defined]


def nothing_found_text(problem: Problem) -> str:
    """What it means that a search ended by itself and found nothing."""
    if not has_vague_axes(problem):
        return "no pose explains more of the points than chance would"
    return (
        "nothing that was found is beyond chance, but the search may have missed the pose, as the axes are known to "
        f"{math.degrees(problem.axis_noise):.2g}° only; "  # type: ignore[attr-defined]
        "give a smaller `axis_noise` if that is realistic"
    )
