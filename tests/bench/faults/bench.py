"""Runs the findings one after the other. A module of this package with ``FINDINGS`` is one part of the table."""

import importlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from tests.bench.faults.finding import Finding, Measured

PARTS: tuple[str, ...] = ("link", "exchange", "plans", "beside", "estimator", "machine", "guard", "loop")
"""Modules of this package, in the table's order."""
MAX_TEXT = 120
"""Of an exception, in characters."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultRow:
    """A line of the table."""

    part: str
    finding: str
    before: str
    promise: str
    now: str
    kept: bool


def findings(part: str | None = None) -> Iterator[Finding]:
    """All findings, or those of one part."""
    for name in PARTS if part is None else (part,):
        yield from importlib.import_module(f"tests.bench.faults.{name}").FINDINGS


def bench_faults(part: str | None = None, show: Callable[[str], None] = lambda _: None) -> list[FaultRow]:
    """Measure every finding. One that cannot be measured is a promise that is not kept."""
    rows = []
    for finding in findings(part):
        show(f"{finding.part}: {finding.name}")
        try:
            now = finding.measure()
        except Exception as error:  # noqa: BLE001 - the table has to say so, and go on
            now = Measured(text=f"{type(error).__name__}: {error}"[:MAX_TEXT], kept=False)
        rows.append(
            FaultRow(
                part=finding.part,
                finding=finding.name,
                before=finding.before,
                promise=finding.promise,
                now=now.text,
                kept=now.kept,
            )
        )
    return rows


def markdown(rows: list[FaultRow]) -> str:
    """The results as a Markdown table."""
    head = "| part | what is done | promised | measured | kept |\n| --- | --- | --- | --- | --- |\n"
    return head + "".join(
        f"| {r.part} | {r.finding} | {r.promise} | {r.now} | {'yes' if r.kept else 'NO'} |\n" for r in rows
    )
