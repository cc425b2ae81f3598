"""Record of the service's construction in a log, from which a replay builds the same service."""
