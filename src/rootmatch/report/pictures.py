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

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.errors import InputError
from rootmatch.io import write_atomically
from rootmatch.report.drawn_poses import COLOURS, draw_poses
from rootmatch.report.picture_axes import (
    DEFAULT_VIEW,
    TOP,
    WIDTH,
    axes_frame,
    place_axes,
    project_to_axes,
    show_image,
    show_space,
    view_near_camera,
)
from rootmatch.report.text import point_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from rootmatch.cameras.base import CameraModel
    from rootmatch.problems.pose_fit.pose import Pose

SUFFIXES = (".png", ".svg", ".pdf")
MARKERS = ("o", "s", "^", "D", "v", "P")
WRONG, UNMATCHED = "#D55E00", "#7F7F7F"

MAX_LABELS = 80
"""Points per side above which labels would only clutter the picture."""


def check_picture(path: Path) -> None:
    """Refuse, before any work, a picture whose suffix names no supported format."""
    if path.suffix.lower() not in SUFFIXES:
        given = f"ends in {path.suffix!r}" if path.suffix else "has no suffix"
        raise InputError(f"picture {path}: it {given}; use {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}")


def save_figure(figure: Figure, path: Path) -> None:
    """Save a figure as PNG, SVG or PDF, by the suffix of ``path``, whole or not at all."""
    check_picture(path)
    with write_atomically(path) as temporary:
        figure.savefig(temporary, format=path.suffix.lower()[1:], dpi=figure.dpi)


def match_figure(
    source: ArrayLike,
    target: ArrayLike,
    assignment: ArrayLike,
    *,
    motions: ArrayLike | None = None,
    motion_names: Sequence[str] | None = None,
    truth: ArrayLike | None = None,
    poses: Sequence[Pose | None] | None = None,
    camera: CameraModel | None = None,
    photo: Path | None = None,
    source_names: Sequence[str] | None = None,
    target_names: Sequence[str] | None = None,
    title: str = "",
    unit: str | None = None,
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
    motion_names : sequence of str, optional
        What the legend calls each motion, such as the label of a body; by default its number.
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
    unit : str, optional
        Length unit of the points in space; by default it is called that of the model, or of each point set.

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
    from matplotlib.patches import ConnectionPatch

    source, target = np.asarray(source, dtype=float), np.asarray(target, dtype=float)
    match = np.asarray(assignment, dtype=np.int64)
    labels = np.zeros(len(match), dtype=np.int64) if motions is None else np.asarray(motions, dtype=np.int64)
    true = None if truth is None else np.asarray(truth, dtype=np.int64)
    _check_shapes(source, target, match, labels, true)
    wrong = np.zeros(len(match), dtype=bool) if true is None else (match >= 0) & (match != true)

    in_space, to_space = source.shape[1] == 3, target.shape[1] == 3
    titles = ("source", "target") if to_space else ("model", "image") if in_space else ("first image", "second image")
    picture = None if photo is None else read_photo(photo)
    frames = [None if in_space else axes_frame(source, None), None if to_space else axes_frame(target, picture)]
    height, places = place_axes(frames)
    figure = Figure(figsize=(WIDTH, height), dpi=120)
    FigureCanvasAgg(figure)
    left: Any = figure.add_axes(places[0], projection="3d" if in_space else None)
    right: Any = figure.add_axes(places[1], projection="3d" if to_space else None)
    if frames[0] is None:
        show_space(left, source, view_near_camera(source, target, match, labels), unit or f"{titles[0]} unit")
    else:
        show_image(left, frames[0])
    if frames[1] is None:
        show_space(right, target, DEFAULT_VIEW, unit or f"{titles[1]} unit")
    else:
        show_image(right, frames[1])
        right.yaxis.tick_right()
        right.yaxis.set_label_position("right")  # out of the way of the lines
        if picture is not None:
            rows, columns = picture.shape[:2]
            right.imshow(picture, extent=(-0.5, columns - 0.5, rows - 0.5, -0.5), cmap="gray", alpha=0.6, zorder=-2)
    for axes, name, place in zip((left, right), titles, places, strict=True):
        if hasattr(axes, "get_proj"):  # the box may reach anywhere but into the corner
            figure.text(place[0] + 0.04, 1.0 - 0.8 * TOP / height, name, fontsize=10)
        else:
            axes.set_title(name, fontsize=10)
    figure.suptitle(title, fontsize=11, y=0.975)

    figure.draw_without_rendering()  # fixes the axes, and with them the projection of the 3D points
    flat, flat_target = project_to_axes(left, source), project_to_axes(right, target)
    groups = _group_matches(match, labels, wrong, motion_names)
    for group in groups:
        ends = zip(flat[group.members].tolist(), flat_target[match[group.members]].tolist(), strict=True)
        style: dict[str, Any] = {"color": group.colour, "linestyle": group.line, "linewidth": 1.0, "alpha": 0.6}
        for start, end in ends:  # beneath both axes
            figure.add_artist(ConnectionPatch(start, end, left.transData, right.transData, zorder=-1, **style))
        for axes, points in ((left, source[group.members]), (right, target[match[group.members]])):
            axes.plot(*points.T, linestyle="none", clip_on=False, **group.marker)
    handles = [group.handle() for group in groups]
    if poses is not None:
        handles += draw_poses(right, source=source, target=target, match=match, poses=poses, camera=camera)
    handles += _draw_unmatched((left, right), (source[match < 0], np.delete(target, match[match >= 0], axis=0)), titles)
    draw_labels(left, flat, point_names(source_names, len(source)), towards=-1.0)
    draw_labels(right, flat_target, point_names(target_names, len(target)), towards=1.0)
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


def read_photo(photo: Path) -> Floats:
    """The photograph (rows, columns[, 3]); an `InputError` if it cannot be read."""
    from matplotlib.image import imread

    try:
        return np.asarray(imread(photo))
    except (OSError, ValueError, SyntaxError) as error:
        raise InputError(f"photo {photo}: cannot be read ({error}); give a PNG or JPEG") from None


@dataclass(frozen=True)
class _Group:
    """Matches drawn in one style."""

    name: str
    colour: str
    symbol: str
    line: Literal["-", "--"]
    members: Integers

    @property
    def marker(self) -> dict[str, Any]:
        return {"color": self.colour, "marker": self.symbol, "markersize": 5.5}

    def handle(self) -> Line2D:
        """Entry in the legend."""
        from matplotlib.lines import Line2D

        return Line2D([], [], linestyle=self.line, label=f"{self.name} ({len(self.members)})", **self.marker)


def _group_matches(match: Integers, labels: Integers, wrong: Bools, names: Sequence[str] | None) -> list[_Group]:
    """The matches of each motion and the wrong ones, without empty groups."""
    kinds = np.unique(labels[match >= 0])
    groups = [
        _Group(
            "matched" if len(kinds) == 1 else f"motion {kind}" if names is None else names[kind],
            COLOURS[k % len(COLOURS)],
            MARKERS[k % len(MARKERS)],
            "-",
            np.flatnonzero((match >= 0) & (labels == kind) & ~wrong),
        )
        for k, kind in enumerate(kinds)
    ]
    groups.append(_Group("wrong", WRONG, "X", "--", np.flatnonzero(wrong)))
    return [group for group in groups if len(group.members)]


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


def draw_labels(axes: Any, points: NDArray[np.float64], names: Sequence[str], towards: float) -> None:
    """Label the points, each where the label covers the fewest points and other labels.

    ``towards`` is −1 to try the left first and 1 to try the right first: the side without connecting lines.
    """
    if len(points) > MAX_LABELS:
        return
    from matplotlib.patheffects import withStroke

    size = 7.0
    page = axes.transData.transform(points) * 72.0 / axes.figure.dpi  # printer's points
    taken = np.column_stack([page - 3.5, page + 3.5])  # boxes left, bottom, right, top
    steps = np.array([(1, 0), (1, 1), (1, -1), (0, 1), (0, -1), (-1, 0), (-1, 1), (-1, -1)]) * [towards, 1.0]
    for index, name in enumerate(names):
        half = np.array([0.31 * size * len(name), 0.5 * size])
        reach = np.where(np.all(steps != 0, axis=1), 3.5, 5.0)[:, None] + half
        offsets = steps * reach
        boxes = np.hstack([page[index] + offsets - half, page[index] + offsets + half])
        others = np.delete(taken, index, axis=0)
        overlap = np.minimum(boxes[:, None, 2:], others[:, 2:]) - np.maximum(boxes[:, None, :2], others[:, :2])
        cost = np.prod(np.maximum(overlap, 0.0), axis=2).sum(axis=1) + 0.01 * np.arange(len(steps))
        best = int(np.argmin(cost))
        axes.annotate(
            name,
            points[index],
            xytext=offsets[best],
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=size,
            parse_math=False,  # a name is a name, dollars and all
            path_effects=[withStroke(linewidth=2.0, foreground="white")],
            annotation_clip=False,
        )
        taken = np.vstack([taken, boxes[best]])
