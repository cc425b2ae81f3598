"""Running: what puts service, devices, links and log together, and what SITL adds."""
