"""My own plant: the shipped one in a swell that pushes and pulls near the surface."""

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.sitl.plant import build_plant
from autopilot.sitl.protocol import PlantContext, PlantLike

FORCE_N, PERIOD_S, SLICE_US = 3.0, 4.0, 20_000
DECAY_1_M = (2.0 * np.pi / PERIOD_S) ** 2 / 9.81
"""Deep water: the wave number is omega^2 / g, and the motion fades with depth by its exponential."""


class Swell(PlantLike):
    """Adds a force along north; the phase is the seed's."""

    def __init__(self, given: PlantContext) -> None:
        if given.vehicle.body.mass_kg > 100.0:
            raise ConfigError(f"{FORCE_N:g} N do nothing to {given.vehicle.name}; take a lighter vehicle")
        self.plant = build_plant(given.scenario, given.vehicle)
        self.phase = np.random.default_rng(given.seed).uniform(0.0, 2.0 * np.pi)
        self.t_us = 0

    @property
    def truth(self):
        return self.plant.truth

    def advance(self, t_us, pwm_us):
        while self.t_us < t_us:
            self.t_us = min(t_us, (self.t_us // SLICE_US + 1) * SLICE_US)  # slices do not depend on who asks when
            depth_m = self.plant.truth.pos_ned_m[2]
            wave = np.sin(2.0 * np.pi * self.t_us * 1e-6 / PERIOD_S + self.phase) * np.exp(-DECAY_1_M * depth_m)
            self.plant.set_external_wrench(force_ned_n=(FORCE_N * float(wave), 0.0, 0.0))
            self.plant.advance(self.t_us, pwm_us)
