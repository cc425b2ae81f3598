"""Marker maps around the vehicle: printed sheets, checks, and surveys by bundle adjustment."""
