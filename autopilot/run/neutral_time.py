"""Measures the delay from the last command of the service to neutral thrusters (propellers removed)."""

from collections.abc import Callable

from autopilot.drivers.ardusub import ArduSubOptions
from autopilot.drivers.ardusub_mixing import FRAMES
from autopilot.drivers.ardusub_silence import SILENT_US, SilenceTest
from autopilot.drivers.ardusub_wire import Wire
from autopilot.drivers.devices import FLIGHT_CONTROLLER
from autopilot.drivers.links import open_link
from autopilot.run.clocks import make_clock
from autopilot.run.findings import Finding, FindingSeverity
from autopilot.run.vehicle_config import VehicleConfig

STEP_US = 5_000
LONGEST_S = 0.6
"""FS_PILOT_TIMEOUT as docs/hardware.md has it set, at most 0.55 s, and the delay of the report."""
WHAT = "silence to neutral"


def measure(config: VehicleConfig, *, speed: float = 1.0, on_step: Callable[[int], None] = lambda _: None) -> Finding:
    """One measurement. ``speed``: of the device's time, 0 where it, being emulated, follows ``on_step``. DriverError if
    the link cannot be had."""
    setup = config.devices.get(FLIGHT_CONTROLLER)
    if setup is None or not isinstance(setup.options, ArduSubOptions):
        remedy = "pull the plug of the companion with the motors turning (docs/hardware.md, section 4)"
        return Finding(
            verdict=FindingSeverity.WARN, what=WHAT, found="cannot be measured on these devices", remedy=remedy
        )
    options = setup.options
    wire = Wire(open_link(options.connect), system=options.system, ours=options.gcs_system)
    test, clock, t_us = SilenceTest(wire, FRAMES[options.frame].motors), make_clock(speed), 0
    try:
        while not test.done:
            t_us += STEP_US
            now_us = clock.wait_until(t_us)
            test.tick(max(t_us, now_us) if speed else t_us)
            t_us = max(t_us, now_us - now_us % STEP_US) if speed else t_us
            on_step(t_us)
    finally:
        test.abort()
        wire.close()
    return _finding(test)


def _finding(test: SilenceTest) -> Finding:
    if test.problem:
        what, _, remedy = test.problem.rpartition(": ")
        return Finding(verdict=FindingSeverity.FAIL, what=WHAT, found=f"not measured, {what}", remedy=remedy)
    if test.neutral_s is None:
        found = f"thrust goes on for more than {1e-6 * SILENT_US:.0f} s"
    else:
        found = f"{test.neutral_s:.2f} s"
        if test.neutral_s <= LONGEST_S:
            return Finding(verdict=FindingSeverity.OK, what=WHAT, found=found)
    remedy = f"at most {LONGEST_S} s: set FS_PILOT_INPUT 1, FS_PILOT_TIMEOUT 0.4, RC_PROTOCOLS 0, and try again"
    return Finding(verdict=FindingSeverity.FAIL, what=WHAT, found=found, remedy=remedy)
