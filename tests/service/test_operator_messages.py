"""The table of operators' texts: the page is made from it, every row is sent, and nothing else is sent."""

import ast
import runpy
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from autopilot.core.operator_messages import ROWS

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = (
    "autopilot/command",
    "autopilot/control",
    "autopilot/core",
    "autopilot/mavlink",
    "autopilot/run",
    "drivers",
    "estimator",
)
TABLES = ("failsafe_table.py", "operator_messages.py")
SENDERS = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py")) if path.name not in TABLES]
RELAYS = {"runtime.py", "service.py", "session.py"}
"""They make events of what other packages have said."""


@cache
def _trees() -> list[tuple[str, ast.Module]]:
    return [(path.name, ast.parse(path.read_text(encoding="utf-8"))) for path in SENDERS]


def _row_of(node: ast.expr) -> str | None:
    """``notices.NAME`` -> NAME."""
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "notices":
        return node.attr
    return None


def _is_severity(node: ast.expr) -> bool:
    return isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "Severity"


def _literals(name: str, tree: ast.Module) -> list[str]:
    """Severities in a call or tuple, and events that no row has made."""
    found = []
    for node in ast.walk(tree):
        parts: list[ast.expr] = []
        if isinstance(node, ast.Call):
            parts = [*node.args, *(keyword.value for keyword in node.keywords)]
            if isinstance(node.func, ast.Name) and node.func.id in ("Event", "OperatorText") and name not in RELAYS:
                found.append(f"{name}:{node.lineno}: {node.func.id}() without a row")
        elif isinstance(node, ast.Tuple):
            parts = node.elts
        found += [f"{name}:{node.lineno}: a severity outside the table" for part in parts if _is_severity(part)]
    return found


def test_every_text_that_is_sent_is_a_row() -> None:
    assert [line for name, tree in _trees() for line in _literals(name, tree)] == []


@pytest.mark.parametrize(
    "code",
    ['say(Severity.INFO, "x")', 'texts = [(Severity.INFO, "x")]', 'Event(t_us=0, severity=4, text="x")'],
)
def test_a_text_beside_the_table_is_found(code: str) -> None:
    assert _literals("new.py", ast.parse(code))


def test_every_row_is_sent() -> None:
    used = {_row_of(node) for _, tree in _trees() for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    assert set(ROWS) - used == set()


def test_senders_give_the_fields_of_the_row() -> None:
    wrong = []
    for name, tree in _trees():
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call):
                continue
            made = node.func.value if isinstance(node.func, ast.Attribute) and node.func.attr == "event" else node.func
            row = _row_of(made)
            if row is not None and {keyword.arg for keyword in node.keywords} != set(ROWS[row].fields):
                wrong.append(f"{name}:{node.lineno}: {row}")
    assert wrong == []


def test_meanings_and_remedies_are_sentences() -> None:
    assert [name for name, row in ROWS.items() if row.meaning and not row.meaning.endswith(".")] == []
    assert [name for name, row in ROWS.items() if row.remedy and not row.remedy.endswith(".")] == []


def test_texts_without_fields_are_unique() -> None:
    texts = [row.template for row in ROWS.values() if not row.fields]
    assert len(set(texts)) == len(texts)


def test_the_page_is_current() -> None:
    generator: dict[str, Any] = runpy.run_path(str(ROOT / "docs" / "messages_page.py"))
    page = (ROOT / "docs" / "messages.md").read_text(encoding="utf-8")
    assert page == generator["page"](), "run python docs/messages_page.py --write"
    assert sum(map(len, generator["sections"]().values())) == len(ROWS)
