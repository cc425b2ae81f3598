"""A finding and how it is measured again."""

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
    """Something that came from outside and broke the service, and its measurement."""

    part: str
    """loop, guard, estimator, plans, link or machine."""
    name: str
    """What is done to the service, in a few words."""
    before: str
    """What happened at revision 0501193, as measured then."""
    promise: str
    """What has to happen."""
    measure: Callable[[], Measured]
    """Does it to the real service and measures. Seconds to a minute; no display, network beyond loopback or root."""
