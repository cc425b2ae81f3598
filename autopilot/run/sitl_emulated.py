"""Emulated flight controller with a simulated vehicle, in real time and on real links, for ``autopilot run``."""

from collections.abc import Callable, Sequence
from typing import Any

import msgspec

from autopilot.drivers.links import open_link
from autopilot.run.clocks import make_clock
from autopilot.run.sitl_ardusub_world import TRACK_US, ArduSubWorld

STEP_US = 5_000
"""Its main loop."""


class EmulatedFlight(msgspec.Struct, kw_only=True):
    """Ground truth of the vehicle at the end."""

    seconds: float = 0.0
    late_steps: int = 0
    contacts: int = 0
    max_penetration_m: float = 0.0
    energy_j: float = 0.0
    max_distance_m: float = 0.0
    """Farthest from the start that it has been."""


def emulate(links: Sequence[str], *, duration: float | None, stop: Callable[[], bool], **world: Any) -> EmulatedFlight:
    """Run until ``stop`` or for a duration [s]. ``links``: of the flight controller; ``world``: arguments of
    :class:`.ArduSubWorld`."""
    around = ArduSubWorld(**world, first_us=TRACK_US)
    vehicle = around.new_vehicle()
    ends = [open_link(text) for text in links]
    clock, flight, t_us = make_clock(1.0), EmulatedFlight(), 0
    try:
        while not stop() and (duration is None or t_us < 1e6 * duration):
            t_us += STEP_US
            flight.late_steps += clock.wait_until(t_us) - t_us > STEP_US
            for index, link in enumerate(ends):
                for received in link.recv(t_us):
                    vehicle.controller.receive(t_us, received.data, index)
            for data in vehicle.advance(t_us):
                for link in ends:
                    link.send(data)
            around.observe(t_us, vehicle, vehicle.truth)
    finally:
        truth = vehicle.truth
        flight.seconds, flight.contacts = 1e-6 * t_us, truth.contact_count
        flight.max_penetration_m, flight.energy_j = truth.max_penetration_m, truth.energy_used_j
        flight.max_distance_m = around.max_distance_m
        around.close()
        for link in ends:
            link.close()
    return flight
