"""The front door for programs and notebooks: fly, step, read."""
