"""From thrust to pulses and the response: allocation, thruster faults, latency."""
