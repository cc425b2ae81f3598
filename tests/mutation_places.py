"""Where a small change of meaning can be made: comparisons, arithmetic, constants, booleans, bounds, returns."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

LEFT_OUT = ("bench", "cli", "data")
"""Folders of the package in which nothing is changed."""

_COMPARED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_CALCULATED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
}  # fmt: skip
_BOUNDED = {"min": "max", "max": "min", "np.minimum": "np.maximum", "np.maximum": "np.minimum"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    path: Path
    """Of the source, from the root of the repository."""
    line: int
    column: int
    kind: str
    begin: int
    end: int
    """Offsets [bytes] of what is replaced."""
    before: str
    after: str

    @property
    def name(self) -> str:
        return f"{self.path}:{self.line}:{self.column} {self.kind}: {self.before} -> {self.after}"

    def applied(self, source: bytes) -> bytes:
        return source[: self.begin] + f"({self.after})".encode() + source[self.end :]

    def key(self, source: bytes) -> str:
        """The same as long as its line stays: path, line of code, change."""
        line = source.splitlines()[self.line - 1].decode().strip()
        return f"{self.path} | {line} | {self.before} -> {self.after}"


def _changed(node: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Kind, and the expression that replaces this one."""
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in _COMPARED:
        other = _COMPARED[type(node.ops[0])]()
        yield "comparison", ast.Compare(left=node.left, ops=[other], comparators=node.comparators)
    elif isinstance(node, ast.BinOp) and type(node.op) in _CALCULATED and not _is_text(node):
        yield "arithmetic", ast.BinOp(left=node.left, op=_CALCULATED[type(node.op)](), right=node.right)
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield "constant", ast.Constant(value=not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        yield "constant", ast.Constant(value=_another(node.value))
    elif isinstance(node, ast.BoolOp):
        yield "boolean", ast.BoolOp(op=ast.Or() if isinstance(node.op, ast.And) else ast.And(), values=node.values)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield "boolean", node.operand
    elif isinstance(node, ast.Call) and ast.unparse(node.func) in _BOUNDED:
        other = ast.parse(_BOUNDED[ast.unparse(node.func)], mode="eval").body
        yield "bound", ast.Call(func=other, args=node.args, keywords=node.keywords)
    elif isinstance(node, ast.Return) and node.value is not None and not _is_none(node.value):
        yield "return", ast.Constant(value=None)


def _another(value: int | float) -> int | float:
    """A number that nobody takes for rounding."""
    if isinstance(value, float):
        return 1.5 * value if value else 0.1
    return value + 1 if abs(value) <= 10 else 2 * value


def _is_none(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def _is_text(node: ast.BinOp) -> bool:
    sides = [side for side in (node.left, node.right) if isinstance(side, (ast.JoinedStr, ast.Constant))]
    return any(not isinstance(getattr(side, "value", None), (int, float)) for side in sides)


def _meaning(node: ast.AST) -> Iterator[ast.AST]:
    """Nodes that a program executes: no annotations, no text, no assertions for the type checker."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "type_comment", "decorator_list") or isinstance(node, ast.JoinedStr):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not isinstance(child, ast.Assert) and not _for_types(child):
                yield child
                yield from _meaning(child)


def _for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def places_of(root: Path, path: Path) -> list[Place]:
    """All places of one module, in order."""
    source = (root / path).read_bytes()
    starts = [0]
    for row in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(row))
    found = []
    for node in _meaning(ast.parse(source)):
        for kind, other in _changed(node):
            spot = node.value if isinstance(node, ast.Return) else node
            assert isinstance(spot, ast.expr)
            assert spot.end_lineno is not None
            assert spot.end_col_offset is not None
            begin = starts[spot.lineno - 1] + spot.col_offset
            end = starts[spot.end_lineno - 1] + spot.end_col_offset
            before, after = ast.unparse(spot), ast.unparse(ast.fix_missing_locations(other))
            where = {"path": path, "line": spot.lineno, "column": spot.col_offset, "kind": kind}
            found.append(Place(begin=begin, end=end, before=before, after=after, **where))  # type: ignore[arg-type]
    return sorted(found, key=lambda place: (place.begin, place.end, place.kind))


def modules(root: Path) -> list[Path]:
    """Our modules, each by one path (folders at the top of the repository are links inside the package)."""
    found = []
    for folder in sorted(path for path in (root / "autopilot").iterdir() if path.is_dir()):
        if folder.name not in LEFT_OUT:
            found += [path.relative_to(root) for path in sorted(folder.rglob("*.py")) if path.name != "__init__.py"]
    return [path for path in found if path.name != "extra_messages.py"]  # generated
