"""What is asked of a flight or a vehicle afterwards: one control step, another outcome, certificates, forecasts."""
