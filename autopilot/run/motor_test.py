"""Runs one thruster at a time at low thrust, to check wiring and direction."""

import time
from collections.abc import Callable, Iterator

from autopilot.core.errors import ConfigError
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.protocols import ThrusterOutput

MOST_PERCENT, MOST_S = 30.0, 5.0
"""Of the pulse's span, and of time: enough to see it turn, too little to run away or to burn a dry seal."""
TICK_S = 0.01
RAMP_S = 0.3


def chosen(vehicle: Vehicle, names: tuple[str, ...]) -> list[int]:
    """Indices of the named thrusters in the vehicle file, all if none is named. ConfigError names the known ones."""
    known = [thruster.name for thruster in vehicle.thrusters]
    for name in names:
        if name not in known:
            raise ConfigError(f"--thruster {name}: the vehicle has {', '.join(known)}")
    return [known.index(name) for name in names] or list(range(len(known)))


def pulses(vehicle: Vehicle, place: int, percent: float, seconds: float) -> Iterator[tuple[int, ...]]:
    """A pulse per thruster [us] for every tick: the chosen one is run up to ``percent`` of its span, others stand.

    Positive pushes along the thruster's ``direction_frd``. ConfigError beyond the limits."""
    if not 0.0 < abs(percent) <= MOST_PERCENT:
        raise ConfigError(f"--level {percent:g}: give -{MOST_PERCENT:g} to {MOST_PERCENT:g} percent, not 0")
    if not 0.0 < seconds <= MOST_S:
        raise ConfigError(f"--seconds {seconds:g}: give more than 0 and at most {MOST_S:g}")
    rest = [thruster.drive.neutral_us for thruster in vehicle.thrusters]
    thruster = vehicle.thrusters[place]
    sign = -1.0 if thruster.reversed else 1.0
    for tick in range(round(seconds / TICK_S)):
        fraction = min(1.0, (tick + 1) * TICK_S / RAMP_S)
        now = list(rest)
        now[place] += round(sign * fraction * percent / 100.0 * thruster.drive.span_us)
        yield tuple(now)


def turn(
    output: ThrusterOutput,
    commands: Iterator[tuple[int, ...]],
    stop: Callable[[], bool],
    *,
    clock_s: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> bool:
    """Run one thruster, then neutral; whether it was completed. DriverError when the connection fails."""
    start_s = clock_s()
    try:
        for count, command in enumerate(commands):
            if stop():
                return False
            output.write(round(1e6 * (clock_s() - start_s)), command)
            sleep(max(0.0, start_s + (count + 1) * TICK_S - clock_s()))
        return True
    finally:
        output.neutral()
