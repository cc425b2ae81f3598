"""The type of what makes estimators in tests."""

from collections.abc import Callable

from autopilot.estimator.engine import Engine

Make = Callable[..., Engine]
"""(options, markers) -> estimator; both may be left out."""
