"""A finding and how it is looked at again: by tests, or by a measurement."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """What a finding looks like now."""

    text: str
    """The figure with its unit, e.g. "longest gap between heartbeats 1.02 s"."""
    kept: bool
    """Whether that is what the project promises."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Something that came from outside and broke the service."""

    part: str
    name: str
    """What is done to the service, in a few words."""
    before: str
    """What happened at revision 0501193, as measured then."""
    promise: str
    """What has to happen."""
    tests: tuple[str, ...] = ()
    """Tests that do it, as pytest names them,"""
    measure: Callable[[], Measured] | None = None
    """or what measures it with the real service: seconds to a minute."""
