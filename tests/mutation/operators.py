"""Mutation operators: sites in a module's source and the replacement at each.

Source: Jia and Harman, An Analysis and Survey of the Development of Mutation Testing, IEEE TSE 37
(2011).
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ARITHMETIC = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
NEGATIONS = (
    (ast.Lt, ast.GtE),
    (ast.Gt, ast.LtE),
    (ast.Eq, ast.NotEq),
    (ast.In, ast.NotIn),
    (ast.Is, ast.IsNot),
)
COMPARISON = dict((*NEGATIONS, *(pair[::-1] for pair in NEGATIONS)))
SORTING = ("sorted", "argsort")  # of these the order is reversed
OPPOSITES = {
    "min": "max",
    "max": "min",
    "argmin": "argmax",
    "argmax": "argmin",
    "minimum": "maximum",
}
OPPOSITES |= {"maximum": "minimum", "nanmin": "nanmax", "nanmax": "nanmin"}
SCALE = 10


@dataclass(frozen=True)
class Mutant:
    """One changed expression.

    Attributes
    ----------
    path : module, relative to the root of the checkout.
    function : qualified name of the function around it, "" in the body of the module or of a class.
    line : line number of the expression.
    operator : kind of the change.
    start, end : place of the expression in the source, bytes.
    before, after : its text.
    """

    path: str
    function: str
    line: int
    operator: str
    start: int
    end: int
    before: str
    after: str

    def apply_to(self, source: bytes) -> bytes:
        """Return the module's source with this change."""
        return source[: self.start] + self.after.encode() + source[self.end :]


def mutants_of(root: Path, path: Path) -> list[Mutant]:
    """Return every mutant of a module."""
    source = path.read_bytes()
    offsets = [0]
    for line in source.splitlines(keepends=True):
        offsets.append(offsets[-1] + len(line))
    mutants = []
    for node, function in sites(ast.parse(source), ()):
        start = offsets[node.lineno - 1] + node.col_offset
        end = offsets[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0)
        original = source[start:end].decode()
        for operator, replacement in replacements(node):
            place = (str(path.relative_to(root)), function, node.lineno)
            mutants.append(Mutant(*place, operator, start, end, original, replacement))
    return mutants


def sites(node: ast.AST, names: tuple[str, ...]) -> Iterator[tuple[ast.expr, str]]:
    """Yield every expression that is computed, with its function.

    Annotations, messages and changes without an effect are left out: `strict` of zips refuses
    lengths that are equal anyway, `optimize` of einsum changes its time alone, and reshape takes
    any negative length for the unknown one.
    """
    for field, children in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list"):
            continue
        if field == "value" and getattr(node, "arg", "") in ("strict", "optimize"):
            continue
        reshapes = isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "reshape"
        for child in children if isinstance(children, list) else [children]:
            if not isinstance(child, ast.AST) or isinstance(child, ast.JoinedStr):
                continue
            named = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
            inner = (*names, child) if named else names  # type: ignore[arg-type]
            if isinstance(child, ast.expr):
                yield child, enclosing_function(names)
            if not (reshapes and isinstance(child, ast.UnaryOp)):
                yield from sites(child, inner)  # type: ignore[arg-type]


def enclosing_function(definitions: tuple[ast.AST, ...]) -> str:
    """Return the innermost function's `code.co_qualname`, or "" outside functions."""
    if not definitions or isinstance(definitions[-1], ast.ClassDef):
        return ""
    parts = []
    for definition in definitions:
        parts += [definition.name, *([] if isinstance(definition, ast.ClassDef) else ["<locals>"])]  # type: ignore[attr-defined]
    return ".".join(parts[:-1])


def replacements(node: ast.expr) -> Iterator[tuple[str, str]]:
    """Yield (operator, text) of every change of an expression."""
    match node:
        case ast.BinOp(left, operation, right) if type(operation) in ARITHMETIC:
            if not any(
                isinstance(side, ast.Constant) and isinstance(side.value, str)
                for side in (left, right)
            ):
                yield "arithmetic", text_of(ast.BinOp(left, ARITHMETIC[type(operation)](), right))
        case ast.UnaryOp(ast.USub(), operand):
            yield "sign", text_of(operand)
        case ast.UnaryOp(ast.Not(), operand):
            yield "negation", text_of(operand)
        case ast.Compare(left, [operation], comparators):
            yield (
                "comparison",
                text_of(ast.Compare(left, [COMPARISON[type(operation)]()], comparators)),
            )
        case ast.BoolOp(operation, values):
            swapped = ast.Or() if isinstance(operation, ast.And) else ast.And()
            yield "logic", text_of(ast.BoolOp(swapped, values))
        case ast.Constant(bool() as value):
            yield "truth", str(not value)
        case ast.Constant(int() | float() as value):
            yield "constant", repr(SCALE * value) if value else "1"
        case ast.Call(function, arguments, keywords):
            yield from changed_calls(function, arguments, keywords)


def changed_calls(
    function: ast.expr, arguments: list[ast.expr], keywords: list[ast.keyword]
) -> Iterator[tuple[str, str]]:
    """Yield a reversed order and a swapped extreme."""
    name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
    if name in SORTING:
        yield "sorting", f"{text_of(ast.Call(function, arguments, keywords))}[::-1]"
    if name in OPPOSITES:
        swapped = ast.Name(OPPOSITES[name])
        new = (
            ast.Attribute(function.value, OPPOSITES[name])
            if isinstance(function, ast.Attribute)
            else swapped
        )
        yield "extreme", text_of(ast.Call(new, arguments, keywords))


def text_of(node: ast.expr) -> str:
    """Return an expression's text in parentheses."""
    return f"({ast.unparse(ast.fix_missing_locations(node))})"
