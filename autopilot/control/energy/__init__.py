"""Riding the current: energy-to-go, trajectories of least energy, and the guidance that follows them."""
