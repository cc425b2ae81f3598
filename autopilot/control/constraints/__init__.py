"""Free space: obstacles and borders as half-planes of the optimal control problem."""
