"""Size of the package, its tests and its pages, beside that of the last release.

Until the first release the stored numbers are those of the day on which they were first counted.

    python -m tests.size           # print the table
    python -m tests.size --store   # at a release: store the numbers in tests/size.json

Tokens are those of `tokenize` without comments, docstrings, blank lines and indentation. The core
is everything in `lampest/` outside of `apps/`. Licences and promises are written by commands, and
their words are not counted.
"""

import ast
import io
import json
import sys
import tokenize
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
STORED = Path(__file__).with_suffix(".json")
MAX_FUNCTION_LINES = 60
MAX_MODULE_LINES = 600
LAYOUT = (
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
)
GENERATED = ("licences.md", "promises.md")
MEASURES = ("tokens", "lines", "long functions", "long modules", "words")


def python_size(source: str) -> Counter[str]:
    """Return tokens, lines of code, long functions and long modules of a Python source."""
    code = Counter[str]()
    docstrings = _docstring_lines(source)
    lines = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in LAYOUT and token.start[0] not in docstrings:
            code["tokens"] += 1
            lines |= {*range(token.start[0], token.end[0] + 1)}
    code["lines"] = len(lines)
    code["long modules"] = int(len(source.splitlines()) > MAX_MODULE_LINES)
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno is not None
            code["long functions"] += node.end_lineno - node.lineno >= MAX_FUNCTION_LINES
    return code


def _docstring_lines(source: str) -> set[int]:
    """Return the lines on which a statement that is a text begins."""
    return {
        node.lineno
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    }


def room_of(path: Path) -> str:
    """Return the room of a file: a folder of `lampest/` or `lampest/apps/`, tests, or docs."""
    parts = path.relative_to(ROOT).parts
    depth = 3 if parts[:2] == ("lampest", "apps") else 2 if parts[0] == "lampest" else 1
    return "/".join(parts[: min(depth, len(parts) - 1)])


def sizes() -> dict[str, dict[str, int]]:
    """Return the measures of every room, of the core, of the package, and of all pages."""
    rooms: dict[str, Counter[str]] = {}
    for folder in ("lampest", "tests", "docs"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            room = rooms.setdefault(room_of(path), Counter())
            room.update(python_size(path.read_text(encoding="utf-8")))
    pages = [path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts]
    for path in (ROOT / "README.md", *pages):
        if path.name not in GENERATED:
            rooms["docs"]["words"] += len(path.read_text(encoding="utf-8").split())
    package = {room: size for room, size in rooms.items() if room.startswith("lampest")}
    core = (size for room, size in package.items() if not room.startswith("lampest/apps"))
    rooms["core"] = sum(core, Counter())
    rooms["package"] = sum(package.values(), Counter())
    return {room: {measure: size[measure] for measure in MEASURES} for room, size in rooms.items()}


def table(now: dict[str, dict[str, int]], before: dict[str, dict[str, int]]) -> str:
    """Return the sizes of all rooms, each with that of the last release in brackets."""
    lines = ["".join((f"{'room':26}", *(f"{measure:>20}" for measure in MEASURES)))]
    for room, size in now.items():
        cells = (
            f"{size[measure]:,} ({before.get(room, {}).get(measure, 0):,})" for measure in MEASURES
        )
        lines.append("".join((f"{room:26}", *(f"{cell:>20}" for cell in cells))))
    return "\n".join(lines)


if __name__ == "__main__":
    if "--store" in sys.argv[1:]:
        STORED.write_text(json.dumps(sizes(), indent=1) + "\n", encoding="utf-8")
    print(table(sizes(), json.loads(STORED.read_text(encoding="utf-8"))))
