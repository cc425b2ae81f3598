"""Device drivers: protocols, a registry by name, one device per file."""
