"""All devices of a real vehicle as one, whichever are connected."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from autopilot.core.camera_tilt import TiltReports
from autopilot.core.messages import FlightControllerState, Severity, ThrusterCommand
from autopilot.core.payload import PayloadState
from autopilot.core.samples import CameraFrame, Sample
from autopilot.core.sensors import SENSOR_ROWS
from autopilot.drivers.devices import CAMERA, FLIGHT_CONTROLLER, THRUSTERS
from autopilot.drivers.protocols import PayloadOutput, ThrusterOutput, WatchedOutput
from autopilot.drivers.retry import DeviceState, RetryingDevice, SteadyController, SteadyOutput, SteadySensor
from autopilot.run.vehicle_config import VehicleConfig

NAMES = {
    **{row.device: row.label for row in SENSOR_ROWS},
    "thrusters": "Thrusters",
    "flight_controller": "Flight controller",
}
"""As operators know them."""

REPLACES = {row.device: row.kinds for row in SENSOR_ROWS if row.replaces}
"""Data of a flight controller that a separate device replaces."""


EARLY_US = 500_000
"""So far ahead of a late tick a sample may be; one that is farther has a wrong stamp."""

LOCKSTEP_WAIT_S = 1.0
"""An emulated device opens in milliseconds, unless its opening needs ticks itself."""


class HardwareVehicle:
    """A :class:`autopilot.run.outside.VehicleIo`. Nothing is opened before the first tick, nothing waits unless
    ``lockstep``: there an opening is, at the same tick each time."""

    def __init__(self, config: VehicleConfig, *, lockstep: bool = False) -> None:
        vehicle = config.vehicle
        self._thrusters = len(vehicle.thrusters)
        made = {kind: setup.make(vehicle) for kind, setup in config.devices.items()}
        self._sensors: dict[str, SteadySensor] = {}
        self._camera: SteadySensor | None = None
        self._below: SteadyController | None = None
        self._output: SteadyOutput[Any] | None = None
        for kind, device in made.items():
            if kind == FLIGHT_CONTROLLER:
                self._output = self._below = SteadyController(device, NAMES[kind])
            elif kind == THRUSTERS:
                output: ThrusterOutput = device
                self._output = SteadyOutput(output, NAMES[kind])
            elif kind == CAMERA:
                self._camera = SteadySensor(device, NAMES[kind])
            else:
                self._sensors[kind] = SteadySensor(device, NAMES[kind])
        device = None if self._output is None else self._output.device
        self._watched = device if isinstance(device, WatchedOutput) else None
        self._driven_payload = device if isinstance(device, PayloadOutput) else None
        rest = (self._camera, self._output)
        self.devices: tuple[RetryingDevice[Any], ...] = (*self._sensors.values(), *(each for each in rest if each))
        if lockstep:
            for each in self.devices:
                each.opening_wait_s = LOCKSTEP_WAIT_S
        self._passed_over = {each for kind in self._sensors for each in REPLACES.get(kind, ())}
        self._t_us = 0
        self._tilt = TiltReports(vehicle)
        self._payload_us: tuple[int, ...] = ()
        """As the thruster output drives the payload; a flight controller reports for itself what it does."""
        self._found_below: FlightControllerState | None = None
        self._early: list[Sample] = []
        """Samples with a time stamp later than the present tick."""

    def advance(self, t_us: int) -> None:
        """Commands that have become too old stop the thrusters."""
        self._t_us = t_us
        if self._output is not None:
            self._output.check(t_us)

    def poll(self, t_us: int) -> Sequence[Sample]:
        samples: list[Sample] = []
        self._found_below = None
        if self._below is not None:
            found = self._below.poll(t_us)
            passed = self._passed_over
            samples += [s for s in found if type(s) not in passed] if passed else found
        for sensor in self._sensors.values():
            samples += sensor.poll(t_us)
        samples += self._tilt.of_outputs(t_us, self._payload_us)
        return self._in_time(t_us, samples)

    def _in_time(self, t_us: int, samples: list[Sample]) -> list[Sample]:
        """Measurements up to the time of the tick; a late tick leaves newer ones to the ticks that catch up."""
        samples = self._early + samples
        self._early = [sample for sample in samples if t_us < sample.t_us <= t_us + EARLY_US]
        return [sample for sample in samples if sample not in self._early] if self._early else samples

    def frames(self, t_us: int) -> Sequence[CameraFrame]:
        return () if self._camera is None else self._camera.poll(t_us)

    def write(self, t_us: int, command: ThrusterCommand) -> None:
        """Drive the thrusters. DriverError while they are away."""
        if self._below is not None and self._below.attend(t_us):
            self._below.device.command(t_us, armed=command.armed)
        if self._output is not None:
            self._output.write(t_us, command.pwm_us[: self._thrusters])

    @property
    def unwired(self) -> dict[str, str]:
        """Payload without an output here, by name, with the reason."""
        return {} if self._driven_payload is None else self._driven_payload.unwired()

    def actuate(self, t_us: int, state: PayloadState) -> None:
        """Drive the payload outputs; waits while the output is disconnected."""
        output, payload = self._output, self._driven_payload
        if output is not None and payload is not None and output.attend(t_us):
            payload.set_payload(t_us, state.pulses_us)
            self._payload_us = () if self._below is not None else state.pulses_us

    def hand_back(self, t_us: int) -> None:
        """The flight controller below has the thrusters again; without one they are neutral already."""
        if self._below is not None and self._below.attend(t_us):
            self._below.device.hand_back(t_us)

    def disarm_flight_controller(self, t_us: int) -> None:
        """Disarm the flight controller, whoever armed it."""
        if self._below is not None and self._below.attend(t_us):
            self._below.device.stop(t_us)

    def stand_down(self, t_us: int) -> bool:
        """The run ends: whether the flight controller below is disarmed, or is not ours to disarm."""
        controller = self._below
        if controller is None or controller.opened_count == 0:
            return True
        return controller.use(t_us, lambda: controller.device.stand_down(t_us), False)

    def below(self, t_us: int) -> FlightControllerState | None:
        """State of the flight controller after the tick's :meth:`poll`, None without one."""
        if self._below is None:
            return None
        if self._found_below is None or self._found_below.t_us != t_us:
            found = self._below.device.below(t_us)
            if not self._below.attend(t_us):
                text = f"flight controller down: {self._below.problem}"
                found = replace(found, acts=False, refusals=(text,), pulses_us=(), armed=None, rival=False)
            self._found_below = found
        return self._found_below

    def refusals(self, t_us: int) -> tuple[str, ...]:
        """Reasons against arming: configured devices that are missing, one line each."""
        found = [f"{d.name} {d.state.value}: {d.problem or 'check power and settings'}" for d in self._missing()]
        watched = self._watched
        if watched is not None and watched.watchdog_problem and not watched.watchdog_failed:
            found.append(f"thruster watchdog {watched.watchdog_problem}: wait")
        below, device = self.below(t_us), self._below
        if below is not None and device is not None and device.state is not DeviceState.DOWN:
            found += below.refusals
        return tuple(found)

    def watchdog(self, t_us: int) -> str:
        """Fault of the watchdog process that stops the thrusters when the service fails."""
        watched = self._watched
        return "" if watched is None or not watched.watchdog_failed else watched.watchdog_problem

    def advice(self) -> tuple[tuple[str, str], ...]:
        device = None if self._below is None else self._below.device
        return () if device is None else device.advice()

    def _missing(self) -> list[RetryingDevice[Any]]:
        """Missing devices, without a silent flight controller, which :class:`FlightControllerState` explains."""
        away = [device for device in self.devices if device.state is not DeviceState.UP]
        return [device for device in away if device is not self._below or device.state is DeviceState.DOWN]

    def take_notices(self) -> Sequence[tuple[Severity, str]]:
        notices = [notice for device in self.devices for notice in device.take_notices()]
        if self._below is not None:
            notices += self._below.device.take_notices()
        return notices

    def close(self) -> None:
        """Thrusters to neutral first, whatever the others raise."""
        closing: list[Callable[[], None]] = [device.close for device in reversed(self.devices)]
        failed: Exception | None = None
        for close in closing:
            try:
                close()
            except Exception as error:  # noqa: BLE001 - the others are closed all the same
                failed = failed or error
        if failed is not None:
            raise failed
