"""For all tests: property tests always take the same examples, a slow machine is no failure, faults are raised."""

import os

from hypothesis import HealthCheck, settings

import autopilot  # noqa: F401 - before any test imports numpy: it says how many threads linear algebra takes

settings.register_profile("repeatable", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("repeatable")

os.environ["AUTOPILOT_GUARD"] = "raise"
"""Exceptions inside the service end a test, in this process and in those that it starts."""

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
"""Where this is set each of the many processes that tests start compiles all modules anew: half a second each."""
