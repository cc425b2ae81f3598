"""Calibration of camera, laser, mounting and latency (docs/calibration.md)."""
