"""What the outside can do to the service, row per finding: what happened once, and what happens now."""
