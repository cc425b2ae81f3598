"""Coefficients of the 4-DoF model from logs of flights: ``autopilot identify``."""
