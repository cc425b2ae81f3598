"""Minimum-energy planning: cost-to-go, trajectory optimisation, and guidance along the trajectory."""
