"""README of the wheel and the sdist, as a package index shows it.

Relative links and pictures lead nowhere there.
"""

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface


def for_an_index(readme: str) -> str:
    """Return Markdown with relative links as plain text, and pictures as their descriptions."""
    pictures = re.sub(r"!\[([^\]]*)\]\((?!https?:)[^)]*\)", r"*\1*", readme)
    return re.sub(r"(?<!!)\[([^\]]*)\]\((?!https?:)[^)]*\)", r"\1", pictures)


class IndexReadme(MetadataHookInterface):
    """Metadata hook of hatchling."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the README."""
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": for_an_index(text)}
