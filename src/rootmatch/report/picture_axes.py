"""The axes of a picture: their layout, an image with y down, and space in perspective from near the camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rootmatch.arrays import Floats, Integers

if TYPE_CHECKING:
    from matplotlib.axes import Axes


WIDTH, TOP, BOTTOM = 12.0, 0.75, 1.05
"""Inches: of the figure, and of its margins for the title and for axis labels and legend."""
ASIDE = np.deg2rad(20.0)
"""Rotation of the 3D view away from the camera's, so that depth shows."""
DEFAULT_VIEW = (30.0, -60.0, 0.0)
"""Matplotlib's default 3D view: elevation, azimuth and roll in degrees."""


def axes_frame(pixels: Floats, picture: Floats | None) -> Floats:
    """Minimum and maximum x and y of an image's axes (2, 2): the photograph's, or the points' with room for labels."""
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    margin = 0.08 * max(float(np.max(high - low)), 1.0)
    low, high = low - margin, high + margin
    if picture is not None:
        size = np.array(picture.shape[1::-1]) - 0.5
        low, high = np.minimum(low + margin, -0.5), np.maximum(high - margin, size)
    return np.stack([low, high])


def place_axes(frames: Sequence[Floats | None]) -> tuple[float, list[tuple[float, float, float, float]]]:
    """Height of the figure in inches, and the rectangles of both axes as fractions of it.

    Axes are as high as the images are in their half; a view of space, for which there is no frame, fills all of it.
    """
    wide = 0.42 * WIDTH
    heights = [
        0.8 * wide if frame is None else float(wide * (frame[1, 1] - frame[0, 1]) / (frame[1, 0] - frame[0, 0]))
        for frame in frames
    ]
    tall = float(np.clip(max(heights), 3.0, 7.5))
    height = tall + TOP + BOTTOM
    bottom, share = BOTTOM / height, tall / height
    return height, [
        (whole, bottom - 0.05, 0.52, share + 0.05) if frame is None else (part, bottom, 0.42, share)
        for frame, whole, part in zip(frames, (-0.02, 0.48), (0.055, 0.525), strict=True)
    ]


def show_image(axes: Axes, frame: Floats) -> None:
    """An image's axes with y down and equal scales."""
    axes.set_xlim(frame[0, 0], frame[1, 0])
    axes.set_ylim(frame[1, 1], frame[0, 1])
    axes.set_aspect("equal")
    axes.patch.set_alpha(0.0)  # the lines between the axes lie beneath them
    axes.set_xlabel("x (px)", fontsize=9)
    axes.set_ylabel("y (px)", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.25)


def show_space(axes: Any, points: Floats, view: tuple[float, float, float], unit: str) -> None:
    """Points in space with equal scales, viewed from ``view`` (elevation, azimuth, roll in degrees)."""
    low, high = points.min(axis=0), points.max(axis=0)
    widest = max(float(np.max(high - low)), 1e-12)
    size = np.maximum(high - low, 0.12 * widest)  # give a plane some thickness, so that its axis is legible
    middle = (low + high) / 2.0
    elevation, azimuth = np.deg2rad(view[:2])
    towards = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    drawn = size * np.sqrt(np.maximum(1.0 - towards**2, 0.0))  # lengths of the axes as the view shortens them
    for k, (name, centre, width) in enumerate(zip("xyz", middle, size, strict=True)):
        getattr(axes, f"set_{name}lim")(centre - 0.54 * width, centre + 0.54 * width)
        getattr(axes, f"set_{name}label")(f"{name} ({unit})", fontsize=8, labelpad=2)
        axis = getattr(axes, f"{name}axis")
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis._axinfo["grid"].update(color=(0.0, 0.0, 0.0, 0.12), linewidth=0.6)
        if drawn[k] > 0.4 * widest:
            axis.get_major_locator().set_params(nbins=5)
        else:  # no space for more
            axis.set_ticks([low[k], high[k]] if min(high[k] - low[k], drawn[k]) > 0.05 * widest else [centre])
            axis.set_major_formatter("{x:.3g}")
    axes.set_box_aspect(size, zoom=1.0)
    axes.tick_params(labelsize=7, pad=0)
    axes.view_init(elev=view[0], azim=view[1], roll=view[2])
    axes.patch.set_alpha(0.0)


def view_near_camera(source: Floats, target: Floats, match: Integers, labels: Integers) -> tuple[float, float, float]:
    """Elevation, azimuth and roll in degrees of a view near the camera's, so that the lines cross little.

    An affine camera is fitted to the largest motion; its rows are the directions of space that run right and down in
    the image. Without enough matches, and for targets in space, the view is matplotlib's own.
    """
    if target.shape[1] == 3:
        return DEFAULT_VIEW
    matched = match >= 0
    if matched.any():
        matched &= labels == np.bincount(labels[matched] - labels[matched].min()).argmax() + labels[matched].min()
    if matched.sum() < 4:
        return DEFAULT_VIEW
    centred = source[matched] - source[matched].mean(axis=0)
    rows = np.linalg.lstsq(centred, target[match[matched]], rcond=1e-6)[0].T
    right = rows[0] / max(float(np.linalg.norm(rows[0])), 1e-300)
    down = rows[1] - (rows[1] @ right) * right
    if np.linalg.norm(down) < 0.05 * np.linalg.norm(rows[0]) or not np.all(np.isfinite(rows)):
        return DEFAULT_VIEW
    down /= np.linalg.norm(down)
    towards = np.cross(down, right)  # from the points to the viewer
    towards = np.cos(ASIDE) * towards + np.sin(ASIDE) * right
    right = np.cross(towards, down)
    elevation, azimuth = np.arcsin(np.clip(towards[2], -1.0, 1.0)), np.arctan2(towards[1], towards[0])
    # matplotlib's own right-hand direction without roll; the roll rotates it onto ours.
    level = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    roll = -np.arctan2(np.cross(level, right) @ towards, level @ right)
    return float(np.rad2deg(elevation)), float(np.rad2deg(azimuth)), float(np.rad2deg(roll))


def project_to_axes(axes: Any, points: Floats) -> Floats:
    """Points in axes coordinates (n, 2): image points as they are, 3D points projected."""
    if points.shape[1] == 2:
        return points
    from mpl_toolkits.mplot3d import proj3d  # type: ignore[import-untyped,unused-ignore]

    x, y, _ = proj3d.proj_transform(*points.T, axes.get_proj())
    return np.column_stack([x, y])
