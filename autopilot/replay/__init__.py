"""Offline replay of recorded runs."""
