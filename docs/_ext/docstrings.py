"""Conversion of the docstrings of the house to Markdown.

The docstrings are no reStructuredText, so autodoc would misread them.
"""

import inspect
import re
from typing import Any


def markdown(text: str) -> str:
    """A cleaned docstring with its parameters as a list and its examples as code.

    Nothing else is markup.
    """
    text = re.sub(
        r"^(Parameters|Attributes|Returns|Yields|Raises|Examples)\n-{3,}\n",
        "",
        text,
        flags=re.MULTILINE,
    )
    blocks = [_block(block) for block in re.split(r"\n{2,}", text.strip("\n"))]
    return "\n\n".join(blocks)


def _block(block: str) -> str:
    if block.lstrip().startswith(">>>"):
        return f"```python\n{inspect.cleandoc(block)}\n```"
    if all(line.startswith("    ") for line in block.splitlines()):
        return f"```\n{inspect.cleandoc(block)}\n```"
    plain = re.sub(r"(`[^`]*`)|([<$*|\[\]])", lambda match: match[1] or "\\" + match[2], block)
    return re.sub(r"^([A-Za-z_][\w, ]*) : ", r"- `\1`: ", plain, flags=re.MULTILINE)


def documentation(thing: Any) -> str:
    """Return the docstring of a class, function or property as Markdown."""
    return markdown(inspect.getdoc(thing) or "")
