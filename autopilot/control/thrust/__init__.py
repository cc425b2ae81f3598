"""From thrust to pulses, and what becomes of them: allocation, losses, delays."""
