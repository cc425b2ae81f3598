"""Live view: a page on loopback with the vehicle's state, sensors and plan (docs/view.md)."""
