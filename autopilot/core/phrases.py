"""What vehicle texts begin with that our own client, or another part, recognises."""

NO_START = "No start: "
"""The plans are stored, and must not be flown."""
ARMING_CHECK = "Arming check: "
"""One reason against arming, as an answer to RUN_PREARM_CHECKS."""
PLAN_REASON = "plan: "
"""Such a reason that lies in the plans."""
