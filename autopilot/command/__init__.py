"""Decisions: modes, goals, failsafes, and the step function of the service."""
