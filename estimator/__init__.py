"""State estimation: filters, measurement models, marker and laser processing."""
