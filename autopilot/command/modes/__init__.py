"""Behaviour of the flight modes, one class each, listed in :mod:`autopilot.command.modes.mode_table`."""
