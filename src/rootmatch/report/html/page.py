"""The report as one file: template, style, script, content and the drawing library, all inside."""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.errors import InputError, RootmatchError, quote_value
from rootmatch.io import check_output, write_atomically
from rootmatch.io.outputs import is_written_through
from rootmatch.report.html.content import list_facts, report_content

if TYPE_CHECKING:
    from rootmatch.result import Match

SUFFIXES = (".html", ".htm")


def check_report(path: Path) -> None:
    """Refuse, before any work, a report that is no HTML file, or for which what it is drawn with is missing.

    Raises
    ------
    InputError
        If the suffix is another.
    RootmatchError
        If the extra ``report`` is not installed.
    """
    if path.suffix.lower() not in SUFFIXES and not is_written_through(path):
        raise InputError(f"report {path}: a report is a page for the browser; give a name that ends in .html")
    _load_libraries()


def write_report(
    match: Match,
    path: str | Path,
    *,
    source_names: Sequence[str] | None = None,
    target_names: Sequence[str] | None = None,
    truth: ArrayLike | None = None,
    photo: str | Path | None = None,
    title: str = "rootmatch report",
) -> None:
    """Write a match as one self-contained HTML file.

    Parameters
    ----------
    match : Match
    path : path
        Of the file, ``.html``.
    source_names, target_names : sequences of str, optional
        Of the points; by default their indices.
    truth : (n,) array, optional
        The true assignment: wrong matches are marked.
    photo : path, optional
        A PNG or JPEG that was detected in, drawn behind the target points.
    title : str
    """
    sides = (("source_names", source_names, len(match.source)), ("target_names", target_names, len(match.target)))
    for name, given, count in sides:
        if given is not None and len(given) != count:
            raise InputError(f"{name}: {len(given)} given; give the names of all {count} points")
    file = Path(path)
    known = None if truth is None else _check_truth(match, truth)
    check_report(file)
    check_output(file, "report")
    content = report_content(
        match,
        source_names=source_names,
        target_names=target_names,
        truth=known,
        photo=None if photo is None else Path(photo),
    )
    page = _render_page(content, list_facts(match), title)
    with write_atomically(file) as temporary:
        # a title from the name of a file may hold what is no character
        temporary.write_text(page, encoding="utf-8", errors="backslashreplace")


def _check_truth(match: Match, truth: ArrayLike) -> NDArray[np.int64]:
    """The true assignment as whole numbers."""
    expected = f"give the index of the target point for each of {len(match.source)} source points, −1 for none"
    try:
        given = np.asarray(truth)
    except ValueError:
        raise InputError(f"truth: {quote_value(truth)} given; {expected}") from None
    if given.shape != match.assignment.shape or given.dtype.kind not in "iu":
        raise InputError(f"truth: {quote_value(truth)} given; {expected}")
    if given.size and (given.min() < -1 or given.max() >= len(match.target)):
        raise InputError(f"truth: an index beyond the {len(match.target)} target points; {expected}")
    return given.astype(np.int64)


def _render_page(content: dict[str, Any], known: Sequence[tuple[str, str]], title: str) -> str:
    environment, plotly = _load_libraries()
    here = files("rootmatch.report.html")
    template = environment.from_string(here.joinpath("page.html.jinja").read_text(encoding="utf-8"))
    # within <script> only "<" could end the element or begin a comment
    data = json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    text: str = template.render(
        title=title,
        css=here.joinpath("page.css").read_text(encoding="utf-8"),
        script=here.joinpath("page.js").read_text(encoding="utf-8"),
        content=data,
        facts=known,
        plotly=plotly,
    )
    return text


def _load_libraries() -> tuple[Any, str]:
    """Jinja's environment, which escapes what it is given, and the source of plotly.js."""
    try:
        from jinja2 import Environment
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise RootmatchError(
            f"report: {error.name} is missing; install the extra: pip install 'rootmatch[report]'"
        ) from None
    return Environment(autoescape=True), get_plotlyjs()
