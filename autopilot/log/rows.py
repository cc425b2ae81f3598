"""Row of a verdict."""

import math
from dataclasses import dataclass, replace
from enum import Enum


class BoundVerdict(Enum):
    PASS = "pass"
    WARN = "warn"
    """The tolerance was used, or an event needs the operator's attention."""
    FAIL = "fail"
    INFO = "info"
    """A figure without a bound, or one that cannot be judged from this log."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundRow:
    """Result of the run for one bound."""

    name: str
    unit: str
    limit: float | None
    worst: float | None
    """The value nearest to, or farthest beyond, the limit."""
    margin: float | None
    """Distance from the limit, tolerance included; negative = broken."""
    verdict: BoundVerdict
    at_s: float | None = None
    """When the worst value was reached, on the service's clock."""
    note: str = ""
    subject: str = ""
    """Rows of one subject are grouped."""


def judged(
    name: str,
    unit: str,
    limit: float,
    worst: float,
    margin: float,
    *,
    broken: BoundVerdict = BoundVerdict.WARN,
    at_s: float | None = None,
    note: str = "",
    subject: str = "",
) -> BoundRow:
    """A figure with a limit: ``broken`` if its margin is negative or not known."""
    verdict = BoundVerdict.PASS if margin >= 0.0 else broken
    return BoundRow(
        name=name,
        unit=unit,
        limit=limit,
        worst=worst,
        margin=margin,
        verdict=verdict,
        at_s=at_s,
        note=note,
        subject=subject,
    )


def info(name: str, unit: str, value: float | None, note: str = "") -> BoundRow:
    return BoundRow(name=name, unit=unit, limit=None, worst=value, margin=None, verdict=BoundVerdict.INFO, note=note)


def counted(name: str, value: int, note: str = "") -> BoundRow:
    """Something that should not happen but breaks no bound."""
    return judged(name, "", 0.0, float(value), float(-value), note=note)


def row(subject: str, name: str, unit: str, value: float, note: str = "") -> BoundRow:
    """A figure without a bound under its subject; one that is not finite is not known."""
    return under(subject, info(name, unit, value if math.isfinite(value) else None, note))


def under(subject: str, made: BoundRow) -> BoundRow:
    return replace(made, subject=subject)


def at_most(subject: str, name: str, unit: str, limit: float, value: float, note: str = "") -> BoundRow:
    """A figure with a warning above a limit."""
    return judged(name, unit, limit, value, limit - value, note=note, subject=subject)
