"""The type of what makes estimators in tests."""

from collections.abc import Callable

from autopilot.estimator.engine import AidedEstimator

Make = Callable[..., AidedEstimator]
"""(options, markers) -> estimator; both may be left out."""
