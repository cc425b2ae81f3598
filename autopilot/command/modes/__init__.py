"""The behaviour of each flight mode: a class per mode, in the table of :mod:`autopilot.command.modes.mode_table`."""
