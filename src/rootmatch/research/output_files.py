"""Files of results: tables in CSV and Markdown, and figures, which are the same for the same results."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from rootmatch.errors import InputError
from rootmatch.io import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESOLUTION = 150
"""Resolution of the PNG, in dots per inch."""


def make_folder(path: Path, own: str = "*") -> None:
    """Make the folder of a run's results unless it is there; an `InputError` where that is impossible.

    So is one that holds something, and nothing that matches the pattern ``own``.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        is_foreign = any(path.iterdir()) and not any(path.glob(own))
    except OSError as error:
        raise InputError(f"{path}: cannot be made ({error.strerror}); name another output folder") from None
    if is_foreign:
        raise InputError(f"{path}: the folder is not empty, and no results are in it; name another output folder")


def count_text(count: int, noun: str) -> str:
    """A number of things in words: "1 instance", "2 instances"."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """The lines of a table in Markdown, and an empty one after it."""

    def line(cells: Sequence[str]) -> str:
        # A bar inside a cell would end it.
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

    return [line(head), "|" + "---|" * len(head), *map(line, rows), ""]


def figure_files(stem: str, figure: Figure) -> Iterator[tuple[str, bytes]]:
    """Names and contents of a figure's files, PNG and SVG; the figure has no layout of its own yet.

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
            yield f"{stem}.{kind}", buffer.getvalue()


def write_files(folder: Path, files: Iterable[tuple[str, bytes]]) -> tuple[Path, ...]:
    """Write files as they come; one that is being replaced stays whole until the new one is."""
    written = []
    for name, content in files:
        with write_atomically(folder / name) as temporary:
            temporary.write_bytes(content)
        written.append(folder / name)
    return tuple(written)
