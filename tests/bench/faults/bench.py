"""Runs the findings one after the other: tests of this checkout, and measurements where a figure is promised."""

import subprocess
from collections.abc import Callable
from dataclasses import dataclass

from autopilot.core.own_python import ROOT, python_command
from tests.bench.faults.exchange import EXCHANGES
from tests.bench.faults.figures import FIGURES
from tests.bench.faults.finding import Finding, Measured
from tests.bench.faults.findings import TESTED

PARTS: tuple[str, ...] = ("link", "exchange", "plans", "beside", "estimator", "machine", "guard", "loop")
"""In the table's order."""
MAX_TEXT = 120
"""Of an exception or a failed test, in characters."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultRow:
    part: str
    finding: str
    before: str
    promise: str
    now: str
    kept: bool


def findings(part: str | None = None) -> list[Finding]:
    """All findings, or those of one part."""
    found = (*TESTED, *FIGURES, *EXCHANGES)
    return [finding for name in PARTS for finding in found if finding.part == name and part in (None, name)]


def _tested(tests: tuple[str, ...]) -> Measured:
    """What pytest says of them."""
    command = [*python_command("import sys, pytest; sys.exit(pytest.main(sys.argv[1:]))"), "--tb=no", *tests]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    lines = done.stdout.strip().splitlines() or done.stderr.strip().splitlines() or ["no answer of pytest"]
    failed = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
    text = (failed or lines[-1:])[0].strip("= ")
    return Measured(text=text[:MAX_TEXT], kept=done.returncode == 0)


def bench_faults(part: str | None = None, show: Callable[[str], None] = lambda _: None) -> list[FaultRow]:
    """Measure every finding. One that cannot be measured is a promise that is not kept."""
    rows = []
    for finding in findings(part):
        show(f"{finding.part}: {finding.name}")
        try:
            now = _tested(finding.tests) if finding.measure is None else finding.measure()
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
