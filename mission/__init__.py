"""Missions: items, validation, plan files, fence geometry, geodesy, sequencing."""
