"""Current models: given, estimated, learned, gridded."""
