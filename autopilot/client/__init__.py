"""MAVLink client: plan transfer, commands and mission monitoring, as state machines without I/O and a session."""
