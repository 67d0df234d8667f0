"""A figure as the contents of its files: PNG and SVG, which are the same for the same results."""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESOLUTION = 150
"""Resolution of the PNG, in dots per inch."""


def contents(figure: Figure) -> Iterator[tuple[str, bytes]]:
    """Each kind of file, ``"png"`` and ``"svg"``, with its content; the figure has no layout of its own yet.

    Both get one layout, worked out once. A figure that keeps its layout engine is drawn once more for each file.
    """
    import matplotlib as mpl
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    # Text stays text, and the same results give the same file.
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "rootmatch"}):
        ConstrainedLayoutEngine().execute(figure)
        for kind, metadata in (("png", {"Software": None}), ("svg", {"Date": None})):
            buffer = BytesIO()
            figure.savefig(buffer, format=kind, dpi=RESOLUTION, metadata=metadata)
            yield kind, buffer.getvalue()
