"""A row of a verdict, and how it is made."""

from dataclasses import dataclass
from enum import Enum


class Verdict(Enum):
    """What a row says."""

    PASS = "pass"
    WARN = "warn"
    """The tolerance was used, or something happened that an operator should look at."""
    FAIL = "fail"
    INFO = "info"
    """A figure without a bound, or one that cannot be judged from this log."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One bound and how the run stands against it."""

    name: str
    unit: str
    limit: float | None
    worst: float | None
    """The value nearest to, or farthest beyond, the limit."""
    margin: float | None
    """Distance from the limit, tolerance included; negative = broken."""
    verdict: Verdict
    at_s: float | None = None
    """When the worst value was reached, on the service's clock."""
    note: str = ""
    subject: str = ""
    """What it is of: rows of one subject stand together."""


def info(name: str, unit: str, value: float | None, note: str = "") -> Row:
    """A figure without a bound."""
    return Row(name=name, unit=unit, limit=None, worst=value, margin=None, verdict=Verdict.INFO, note=note)


def counted(name: str, value: int, note: str = "") -> Row:
    """Something that should not happen but breaks no bound."""
    verdict = Verdict.WARN if value else Verdict.PASS
    return Row(name=name, unit="", limit=0.0, worst=float(value), margin=float(-value), verdict=verdict, note=note)
