"""What the vehicle does in each flight mode: a class per mode, in the table of :mod:`autopilot.command.modes.table`."""
