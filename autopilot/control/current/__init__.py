"""The current: known, estimated, learned, as a map."""
