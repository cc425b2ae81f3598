"""The optimal control problem and its solvers."""
