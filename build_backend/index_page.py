"""The README as a package index shows it, which knows no other file of the repository.

While `pyproject.toml` names no repository, links become plain words, pictures go, and the last line says where the
pages are. As soon as ``[project.urls]`` has a ``Source``, links and pictures become absolute.
"""

from __future__ import annotations

import re

PICTURE = r"!\[([^\]]*)\]\((?![a-z]+:)([^)\s]+)\)"
LINK = r"(?<!!)\[([^\]]*)\]\((?![a-z]+:)([^)\s]+)\)"
COMMENT = re.compile(r"<!--.*?-->\n*", re.DOTALL)
WHERE = """
---

Pages and pictures are part of the source distribution, in the folder `docs`; `docs/index.md` lists them.
"""


def for_index(text: str, source: str | None = None) -> str:
    """The README for an index; ``source`` is the address of the repository, with paths as on GitHub and GitLab."""
    text = COMMENT.sub("", text)
    if source is None:
        return re.sub(LINK, r"\1", re.sub(rf"{PICTURE}\n*", "", text)) + WHERE
    base = source.rstrip("/")
    return re.sub(LINK, rf"[\1]({base}/blob/HEAD/\2)", re.sub(PICTURE, rf"![\1]({base}/raw/HEAD/\2)", text))
