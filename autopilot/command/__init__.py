"""Deciding: modes, goals, failsafes, and the one step that holds everything together."""
