"""For all tests: examples of property tests are the same in every run, and a slow machine is no failure."""

from hypothesis import HealthCheck, settings

import autopilot  # noqa: F401 - before any test imports numpy: it says how many threads linear algebra takes

settings.register_profile("repeatable", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("repeatable")
