"""The energy benchmark: cases with their offline optimum, the controller in closed loop, and its rivals."""
