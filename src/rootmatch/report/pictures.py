"""The picture of a match: both point sets side by side, and a line from each matched point to its counterpart.

Figures use matplotlib's objects only, never the global state of pyplot, so the functions may be called from any thread
and next to a user's own plots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.errors import InputError
from rootmatch.io import written_whole
from rootmatch.report.drawn_poses import draw_poses
from rootmatch.report.point_labels import draw_labels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.transforms import Transform

    from rootmatch.cameras.base import CameraModel
    from rootmatch.problems.pose_fit.pose import Pose

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SUFFIXES = (".png", ".svg", ".pdf")
# Okabe and Ito's palette, distinguishable in every common kind of colour blindness; its vermilion is kept for errors.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P")
WRONG, UNMATCHED = "#D55E00", "#7F7F7F"
WIDTH, TOP, BOTTOM = 12.0, 0.75, 1.05
"""Inches: of the figure, and of its margins for the title and for axis labels and legend."""
ASIDE = np.deg2rad(20.0)
"""Rotation of the 3D view away from the camera's, so that depth shows."""
DEFAULT_VIEW = (30.0, -60.0, 0.0)
"""Matplotlib's default 3D view: elevation, azimuth and roll in degrees."""


def check_picture(path: Path) -> None:
    """Refuse, before any work, a picture whose suffix names no supported format."""
    if path.suffix.lower() not in SUFFIXES:
        given = f"ends in {path.suffix!r}" if path.suffix else "has no suffix"
        raise InputError(f"picture {path}: it {given}; use {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}")


def save_figure(figure: Figure, path: Path) -> None:
    """Save a figure as PNG, SVG or PDF, by the suffix of ``path``, whole or not at all."""
    check_picture(path)
    with written_whole(path) as temporary:
        figure.savefig(temporary, format=path.suffix.lower()[1:], dpi=figure.dpi)


def match_figure(
    source: ArrayLike,
    target: ArrayLike,
    assignment: ArrayLike,
    *,
    motions: ArrayLike | None = None,
    truth: ArrayLike | None = None,
    poses: Sequence[Pose | None] | None = None,
    camera: CameraModel | None = None,
    photo: Path | None = None,
    source_names: Sequence[str] | None = None,
    target_names: Sequence[str] | None = None,
    title: str = "",
    unit: str = "model unit",
) -> Figure:
    """Draw a match.

    Parameters
    ----------
    source : (n, 3) or (n, 2) array
        Points in space, drawn in perspective from near where the camera saw them, or pixels of the first image.
    target : (n', 2) or (n', 3) array
        Pixels, x right and y down, or points in space.
    assignment : (n,) array
        Index into the target, −1 where unmatched.
    motions : (n,) array, optional
        Label of the rigid motion of each source point; each has its own colour and marker.
    truth : (n,) array, optional
        The true assignment: wrong matches are drawn red and dashed.
    poses : sequence of Pose, optional
        Of the motions, as `rootmatch.Match.poses`: predicted points and, to a scale that the legend states, residuals.
    camera : CameraModel, optional
        Of the image, for the axes of the model's frame in it; between point sets in space none is needed.
    photo : path, optional
        Photograph behind the points of the (second) image, in its pixels.
    source_names, target_names : sequences of str, optional
        Labels of the points; by default their indices.
    title : str
        Title of the picture.
    unit : str
        Length unit of the points in space.

    Returns
    -------
    matplotlib.figure.Figure
        Its canvas is Agg; `save_figure` writes it.

    Raises
    ------
    InputError
        If the shapes of the arrays do not fit together.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    source, target = np.asarray(source, dtype=float), np.asarray(target, dtype=float)
    match = np.asarray(assignment, dtype=np.int64)
    labels = np.zeros(len(match), dtype=np.int64) if motions is None else np.asarray(motions, dtype=np.int64)
    true = None if truth is None else np.asarray(truth, dtype=np.int64)
    _check_shapes(source, target, match, labels, true)
    wrong = np.zeros(len(match), dtype=bool) if true is None else (match >= 0) & (match != true)

    in_space, to_space = source.shape[1] == 3, target.shape[1] == 3
    picture = None if photo is None else _pixels(photo)
    frames = [None if in_space else _frame(source, None), None if to_space else _frame(target, picture)]
    layout = _Layout.of(frames)
    figure = Figure(figsize=(WIDTH, layout.height), dpi=120)
    FigureCanvasAgg(figure)
    left: Any = figure.add_axes(layout.left, projection="3d" if in_space else None)
    right: Any = figure.add_axes(layout.right, projection="3d" if to_space else None)
    if frames[0] is None:
        _show_space(left, source, _view(source, target, match, labels), unit)
    else:
        _show_image(left, frames[0])
    if frames[1] is None:
        _show_space(right, target, DEFAULT_VIEW, unit)
    else:
        _show_image(right, frames[1])
        right.yaxis.tick_right()
        right.yaxis.set_label_position("right")  # out of the way of the lines
        if picture is not None:
            rows, columns = picture.shape[:2]
            right.imshow(picture, extent=(-0.5, columns - 0.5, rows - 0.5, -0.5), cmap="gray", alpha=0.6, zorder=-2)
    titles = ("model", "image") if in_space else ("first image", "second image")
    if to_space:
        titles = ("source", "target")
    for axes, name in zip((left, right), titles, strict=True):
        axes.set_title(name, fontsize=10, y=0.94 if hasattr(axes, "get_proj") else None)
    figure.suptitle(title, fontsize=11, y=0.975)

    figure.draw_without_rendering()  # fixes the axes, and with them the projection of the 3D points
    flat, flat_target = _to_axes_plane(left, source), _to_axes_plane(right, target)
    groups = _groups(match, labels, wrong)
    for group in groups:
        _connect(
            figure=figure,
            left=left.transData,
            right=right.transData,
            starts=flat[group.members],
            ends=flat_target[match[group.members]],
            group=group,
        )
        for axes, points in ((left, source[group.members]), (right, target[match[group.members]])):
            axes.plot(*points.T, linestyle="none", clip_on=False, **group.marker)
    handles = [group.handle() for group in groups]
    if poses is not None:
        handles += draw_poses(
            right, source=source, target=target, match=match, poses=poses, colours=COLOURS, camera=camera
        )
    handles += _draw_unmatched((left, right), (source[match < 0], _unmatched_targets(target, match)), titles)
    draw_labels(left, flat, _names(source_names, len(source)), towards=-1.0)
    draw_labels(right, flat_target, _names(target_names, len(target)), towards=1.0)
    figure.legend(handles=handles, loc="lower center", ncols=min(len(handles), 6), fontsize=9, frameon=False)
    return figure


def _check_shapes(source: Floats, target: Floats, match: Integers, labels: Integers, true: Integers | None) -> None:
    if source.ndim != 2 or source.shape[1] not in (2, 3) or target.ndim != 2 or target.shape[1] not in (2, 3):
        raise InputError(f"picture: shapes {source.shape} and {target.shape} given, (n, 3|2) and (n', 2|3) expected")
    for name, array in (("assignment", match), ("motions", labels), ("truth", true)):
        if array is not None and array.shape != (len(source),):
            raise InputError(f"picture: {name} of shape {array.shape} given, ({len(source)},) expected")
    if match.max(initial=-1) >= len(target):
        raise InputError(f"picture: the assignment names target {match.max()}, but there are {len(target)}")


def _names(names: Sequence[str] | None, count: int) -> Sequence[str]:
    return [str(index) for index in range(count)] if names is None else names


def _pixels(photo: Path) -> Floats:
    """The photograph (rows, columns[, 3])."""
    from matplotlib.image import imread

    try:
        return np.asarray(imread(photo))
    except (OSError, ValueError, SyntaxError) as error:
        raise InputError(f"photo {photo}: cannot be read ({error}); give a PNG or JPEG") from None


def check_photo(path: Path) -> None:
    """Refuse, before any work, a photograph that cannot be read."""
    _pixels(path)


def _frame(pixels: Floats, picture: Floats | None) -> Floats:
    """Least and greatest x and y of an image's axes (2, 2): the photograph's, or the points' with room for labels."""
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    margin = 0.08 * max(float(np.max(high - low)), 1.0)
    low, high = low - margin, high + margin
    if picture is not None:
        size = np.array(picture.shape[1::-1]) - 0.5
        low, high = np.minimum(low + margin, -0.5), np.maximum(high - margin, size)
    return np.stack([low, high])


@dataclass(frozen=True)
class _Layout:
    """Height of the figure in inches, and the rectangles of both axes as fractions of it."""

    height: float
    left: tuple[float, float, float, float]
    right: tuple[float, float, float, float]

    @classmethod
    def of(cls, frames: Sequence[Floats | None]) -> _Layout:
        """Axes as high as the images are in their half; a view of space fills all of its half."""
        wide, space = 0.42 * WIDTH, [frame is None for frame in frames]
        heights = [
            0.8 * wide if frame is None else float(wide * (frame[1, 1] - frame[0, 1]) / (frame[1, 0] - frame[0, 0]))
            for frame in frames
        ]
        tall = float(np.clip(max(heights), 3.0, 7.5))
        height = tall + TOP + BOTTOM
        bottom, share = BOTTOM / height, tall / height
        left = (-0.02, bottom - 0.05, 0.52, share + 0.1) if space[0] else (0.055, bottom, 0.42, share)
        right = (0.48, bottom - 0.05, 0.52, share + 0.1) if space[1] else (0.525, bottom, 0.42, share)
        return cls(height, left, right)


def _show_image(axes: Axes, frame: Floats) -> None:
    """An image's axes with y down and equal scales."""
    axes.set_xlim(frame[0, 0], frame[1, 0])
    axes.set_ylim(frame[1, 1], frame[0, 1])
    axes.set_aspect("equal")
    axes.patch.set_alpha(0.0)  # the lines between the axes lie beneath them
    axes.set_xlabel("x (px)", fontsize=9)
    axes.set_ylabel("y (px)", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.25)


def _show_space(axes: Any, points: Floats, view: tuple[float, float, float], unit: str) -> None:
    """Points in space with equal scales, viewed from ``view`` (elevation, azimuth, roll in degrees)."""
    low, high = points.min(axis=0), points.max(axis=0)
    widest = max(float(np.max(high - low)), 1e-12)
    size = np.maximum(high - low, 0.12 * widest)  # give a plane some thickness, so that its axis is legible
    middle = (low + high) / 2.0
    for k, (name, centre, width) in enumerate(zip("xyz", middle, size, strict=True)):
        getattr(axes, f"set_{name}lim")(centre - 0.54 * width, centre + 0.54 * width)
        getattr(axes, f"set_{name}label")(f"{name} ({unit})", fontsize=8, labelpad=2)
        axis = getattr(axes, f"{name}axis")
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis._axinfo["grid"].update(color=(0.0, 0.0, 0.0, 0.12), linewidth=0.6)
        if width > 0.4 * widest:
            axis.get_major_locator().set_params(nbins=5)
        else:
            axis.set_ticks([low[k], high[k]] if high[k] - low[k] > 0.05 * widest else [centre])  # no space for more
            axis.set_major_formatter("{x:.3g}")
    axes.set_box_aspect(size, zoom=1.0)
    axes.tick_params(labelsize=7, pad=0)
    axes.view_init(elev=view[0], azim=view[1], roll=view[2])
    axes.patch.set_alpha(0.0)


def _view(source: Floats, target: Floats, match: Integers, labels: Integers) -> tuple[float, float, float]:
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


def _to_axes_plane(axes: Any, points: Floats) -> Floats:
    """Points in axes coordinates (n, 2): image points as they are, 3D points projected."""
    if points.shape[1] == 2:
        return points
    from mpl_toolkits.mplot3d import proj3d  # type: ignore[import-untyped,unused-ignore]

    x, y, _ = proj3d.proj_transform(*points.T, axes.get_proj())
    return np.column_stack([x, y])


@dataclass(frozen=True)
class _Group:
    """Matches drawn in one style."""

    name: str
    colour: str
    symbol: str
    dashes: bool
    members: Integers

    @property
    def marker(self) -> dict[str, Any]:
        return {"color": self.colour, "marker": self.symbol, "markersize": 5.5}

    @property
    def line(self) -> Literal["--", "-"]:
        return "--" if self.dashes else "-"

    def handle(self) -> Line2D:
        """Its legend entry."""
        from matplotlib.lines import Line2D

        return Line2D([], [], linestyle=self.line, label=f"{self.name} ({len(self.members)})", **self.marker)


def _groups(match: Integers, labels: Integers, wrong: NDArray[np.bool_]) -> list[_Group]:
    """The matches of each motion and the wrong ones, without empty groups."""
    kinds = np.unique(labels[match >= 0])
    groups = [
        _Group(
            f"motion {kind}" if len(kinds) > 1 else "matched",
            COLOURS[k % len(COLOURS)],
            MARKERS[k % len(MARKERS)],
            False,
            np.flatnonzero((match >= 0) & (labels == kind) & ~wrong),
        )
        for k, kind in enumerate(kinds)
    ]
    groups.append(_Group("wrong", WRONG, "X", True, np.flatnonzero(wrong)))
    return [group for group in groups if len(group.members)]


def _unmatched_targets(target: Floats, match: Integers) -> Floats:
    """The targets (k, 2) that no source point is matched to."""
    return np.delete(target, match[match >= 0], axis=0)


def _draw_unmatched(axes: Sequence[Axes], points: Sequence[Floats], titles: Sequence[str]) -> list[Line2D]:
    """Draw grey hollow circles on the left and crosses on the right; returns their legend entries."""
    from matplotlib.lines import Line2D

    handles = []
    for one, unmatched, title, symbol in zip(axes, points, titles, ("o", "x"), strict=True):
        if len(unmatched):
            style: dict[str, Any] = {"color": UNMATCHED, "markerfacecolor": "none", "markersize": 5.5, "marker": symbol}
            one.plot(*unmatched.T, linestyle="none", clip_on=False, **style)
            label = f"unmatched in the {title} ({len(unmatched)})"
            handles.append(Line2D([], [], linestyle="none", label=label, **style))
    return handles


def _connect(figure: Figure, left: Transform, right: Transform, starts: Floats, ends: Floats, group: _Group) -> None:
    """Draw lines from the left axes to the right ones, beneath both."""
    from matplotlib.patches import ConnectionPatch

    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        line = ConnectionPatch(
            xyA=(start[0], start[1]),
            xyB=(end[0], end[1]),
            coordsA=left,
            coordsB=right,
            color=group.colour,
            linestyle=group.line,
            linewidth=1.0,
            alpha=0.6,
            zorder=-1,
        )
        figure.add_artist(line)
