"""What the doctor finds."""

from dataclasses import dataclass
from enum import Enum


class FindingSeverity(Enum):
    """How bad it is."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One line of the doctor's."""

    verdict: FindingSeverity
    what: str
    found: str
    remedy: str = ""
