"""Robust control: disturbance bounds, tube, Lipschitz tightening, terminal regions, ancillary feedback."""
