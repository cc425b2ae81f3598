"""Acceptance of a goal by an estimate that is not exact: shared by the mission, which judges, and the planner, which
has to end where it will be judged."""

import math

SURE_SIGMAS = 3.0
LARGEST_SHARE = 0.1
"""Acceptance shrinks by this number of standard deviations of the estimate, but by this share of it at most."""


def sure_limit(limit: float, variance: float) -> float:
    """Acceptance limit minus the uncertainty of the estimate."""
    uncertainty = SURE_SIGMAS * math.sqrt(variance) if variance >= 0.0 else math.inf
    return limit - min(uncertainty, LARGEST_SHARE * limit)
