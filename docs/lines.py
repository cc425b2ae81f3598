"""Counts what there is to read: ``python docs/lines.py``.

Lines of Python and C by folder: all of them, and of Python those with code (no blank lines, comments, docstrings), and
numbers that stand by themselves in modules and not in a table of their package (``<package>_tuning.py``).
``--json`` gives the same as one object, to compare two revisions.
"""

import argparse
import ast
import io
import json
import subprocess
import sys
import tokenize
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OUTSIDE = ("tests", "docs")
"""Folders that are not the product."""

_NO_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING}


def code_lines(text: str) -> int:
    """Lines of Python that hold a token other than comments and docstrings."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def _is_number(node: ast.expr) -> bool:
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)
    if isinstance(node, ast.UnaryOp):
        return _is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return _is_number(node.left) and _is_number(node.right)
    return isinstance(node, ast.Tuple | ast.List) and bool(node.elts) and all(map(_is_number, node.elts))


def constants(text: str) -> int:
    """Names that a module gives to numbers, or to tuples of numbers."""
    found = 0
    for node in ast.parse(text).body:
        if isinstance(node, ast.AnnAssign) and node.value is not None:
            found += _is_number(node.value)
        elif isinstance(node, ast.Assign):
            targets = node.targets[0].elts if isinstance(node.targets[0], ast.Tuple) else []
            values = node.value.elts if isinstance(node.value, ast.Tuple) else []
            each = values if targets and len(targets) == len(values) else [node.value]
            found += sum(map(_is_number, each))
    return found


def count() -> dict[str, dict[str, int]]:
    """Folder -> files, lines and code lines of Python, lines of C; of what git tracks."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    found: dict[str, dict[str, int]] = {}
    for name in filter(None, listed.split("\0")):
        path = ROOT / name
        if path.suffix not in (".py", ".c", ".h") or path.is_symlink() or not path.is_file():
            continue
        folder = name.split("/")[0] if "/" in name else "."
        row = found.setdefault(folder, {"files": 0, "lines": 0, "code": 0, "constants": 0, "c": 0})
        text = path.read_text(encoding="utf-8")
        if path.suffix == ".py":
            row["files"] += 1
            row["lines"] += text.count("\n")
            row["code"] += code_lines(text)
            row["constants"] += constants(text)
        else:
            row["c"] += text.count("\n")
    product = [row for folder, row in found.items() if folder not in OUTSIDE]
    found["outside tests and docs"] = {key: sum(row[key] for row in product) for key in product[0]}
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    rows = count()
    if parser.parse_args().json:
        sys.stdout.write(json.dumps(rows) + "\n")
    else:
        for folder, row in rows.items():
            sys.stdout.write(f"{folder:24}" + "".join(f"{value:8} {key}" for key, value in row.items()) + "\n")
