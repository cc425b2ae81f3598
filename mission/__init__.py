"""Missions: items, validation, plan files, fences, sequencing."""
