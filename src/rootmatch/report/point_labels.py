"""Labels of the points in a picture, placed where they cover little."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST_LABELS = 80
"""Points per side above which labels would only clutter the picture."""


def draw_labels(axes: Any, points: NDArray[np.float64], names: Sequence[str], towards: float) -> None:
    """Label the points, each where the label covers the fewest points and other labels.

    ``towards`` is −1 to try the left first and 1 to try the right first: the side without connecting lines.
    """
    if len(points) > MOST_LABELS:
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
