"""Offline analysis of flights and vehicles: single control steps, what-if runs, certificates, forecasts."""
