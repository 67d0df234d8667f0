"""Poses in the picture of a match: predicted points, residuals to scale, and the axes of the model's frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rootmatch.arrays import Floats, Integers

if TYPE_CHECKING:
    from matplotlib.lines import Line2D

    from rootmatch.cameras.base import CameraModel
    from rootmatch.problems.pose_fit.pose import Pose


COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#000000")
"""Of motions: the palette of Okabe and Ito, distinguishable in every common kind of colour blindness; its vermilion is
kept for errors."""
LONGEST = 0.06
"""Length of the longest residual as drawn, of the extent of the targets, at most."""
STEPS = (1.0, 2.0, 5.0)
AXES = (("x", "#D62728"), ("y", "#2CA02C"), ("z", "#1F77B4"))
RESIDUAL = "#222222"
REACH = 0.6
"""Length of the axes in units of the points' root mean square distance from their centre."""


def draw_poses(
    axes: Any,
    *,
    source: Floats,
    target: Floats,
    match: Integers,
    poses: Sequence[Pose | None],
    camera: CameraModel | None,
) -> list[Line2D]:
    """Draw what the poses predict into the axes of the targets; returns the legend's entries.

    Residuals point from the prediction to the detection and are drawn longer than they are by the factor that the
    legend states.
    """
    from matplotlib.lines import Line2D

    known = [(pose, COLOURS[k % len(COLOURS)]) for k, pose in enumerate(poses) if pose is not None]
    if not known:
        return []
    factor = _residual_factor(target, [pose for pose, _ in known])
    squares = []
    for pose, colour in known:
        predicted, detected = np.asarray(pose.predicted), target[match[pose.points]]
        squares.append(np.asarray(pose.residuals) ** 2)
        axes.plot(*predicted.T, linestyle="none", marker="+", markersize=7, color=colour, zorder=3)
        for start, off in zip(predicted, factor * (detected - predicted), strict=True):
            axes.plot(*np.stack([start, start + off]).T, color=RESIDUAL, linewidth=1.6, zorder=3)
        if source.shape[1] == 3 and len(pose.R) == 3:
            _draw_frame(axes, pose, source[pose.points], camera)
    rms = math.sqrt(float(np.concatenate(squares).mean()))
    colour, unit = known[0][1], " px" if target.shape[1] == 2 else ""
    return [
        Line2D([], [], linestyle="none", marker="+", markersize=7, color=colour, label="predicted"),
        Line2D([], [], color=RESIDUAL, linewidth=1.6, label=f"residual × {factor:g} (RMS {rms:.2g}{unit})"),
    ]


def _residual_factor(target: Floats, poses: Sequence[Pose]) -> float:
    """The factor by which the longest residual is drawn as long as it may be."""
    longest = max(float(np.max(pose.residuals, initial=0.0)) for pose in poses)  # type: ignore[arg-type]
    extent = float(np.max(np.ptp(target, axis=0)))
    if not longest > 1e-9 * extent:
        return 1.0
    return round_factor(LONGEST * extent / longest)


def round_factor(maximum: float) -> float:
    """1, 2 or 5 times a power of ten, not above ``maximum`` but where that is below 1."""
    power = 10.0 ** math.floor(math.log10(maximum))
    return max(power * max(step for step in STEPS if step * power <= maximum * (1.0 + 1e-9)), 1.0)


def _draw_frame(axes: Any, pose: Pose, points: Floats, camera: CameraModel | None) -> None:
    """The axes of the model's frame at the middle of the points, as the camera sees them, or in space."""
    centre = points.mean(axis=0)
    reach = math.sqrt(float(((points - centre) ** 2).mean()))
    ends = pose.transform(np.vstack([centre, centre + REACH * reach * np.eye(3)]))
    if not hasattr(axes, "get_proj"):
        if camera is None or camera.dimension != 2 or not np.all(camera.sees(ends)):
            return
        ends = camera.project(ends)
    for end, (name, colour) in zip(ends[1:], AXES, strict=True):
        axes.plot(*np.stack([ends[0], end]).T, color=colour, linewidth=2.0, alpha=0.8, zorder=2)
        axes.text(*end, name, color=colour, fontsize=8, ha="center", va="center")
