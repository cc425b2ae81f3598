"""State of the payload that is driven by pulses."""

from dataclasses import dataclass

MAX_PAYLOAD = 16
"""Outputs that a vehicle file may have beside its thrusters."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PayloadState:
    """Commanded outputs of ``[[payload]]``, in the order of the vehicle file."""

    t_us: int
    pulses_us: tuple[int, ...]
    """0 = as it is: a tilt that nobody has moved yet."""
