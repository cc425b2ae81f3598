"""A small MAVLink client: plan transfer, commands and watching, as state machines without I/O and a session with it."""
