"""A metadata hook of hatchling that sets the description; see `index_page`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface
from index_page import for_index


class ReadmeHook(MetadataHookInterface):  # type: ignore[misc]
    """Makes the description from README.md."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Hatchling's hook."""
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        found = for_index(text, metadata.get("urls", {}).get("Source"))
        metadata["readme"] = {"content-type": "text/markdown", "text": found}
