"""Assembly and execution: service, devices, links and log, and SITL."""
