"""World of a real vehicle, from its configuration: devices and environment."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Unpack

import msgspec

from autopilot.command.service_parts import ServiceParts
from autopilot.control.current.currents import NoCurrent
from autopilot.core.background import BackgroundWorker
from autopilot.core.daemon_executor import DaemonExecutor
from autopilot.core.marker_files import load_marker_map
from autopilot.core.messages import FlightControllerState, Severity
from autopilot.core.origin_params import params_origin
from autopilot.core.param_file import PersistentParams, kept_params
from autopilot.core.params import ParamSet
from autopilot.log.description import RunDescription
from autopilot.log.writer import FIRST_EPOCH_NS, LAST_EPOCH_NS
from autopilot.run.boot_links import BootLinks, open_boot_links
from autopilot.run.clocks import LockstepClock, PacedClock
from autopilot.run.compose import KnownEnvironment, forecast_of
from autopilot.run.config import EffectiveSettings
from autopilot.run.describe import describe_service
from autopilot.run.hardware import HardwareVehicle
from autopilot.run.session import Session, SessionOptions, open_session
from autopilot.run.vehicle_config import VehicleConfig, apply_parameters
from autopilot.run.world import CurrentSource, World
from autopilot.view.controls import ReadOnly


def open_vehicle_links(
    settings: EffectiveSettings, config: VehicleConfig, overrides: dict[str, float], *, instance: int
) -> BootLinks:
    """Open a vehicle's links; none is left open after an error. ConfigError, DriverError."""
    params, *_ = vehicle_params(settings, config, overrides, instance)
    folder = state_folder(settings, config, instance)
    return open_boot_links(settings["connect"], params, instance, settings["profile"], folder)


def vehicle_params(
    settings: EffectiveSettings,
    config: VehicleConfig,
    overrides: dict[str, float],
    instance: int,
    disk: BackgroundWorker | None = None,
) -> tuple[ParamSet, PersistentParams, tuple[str, ...]]:
    """Defaults < the file's < saved by earlier runs < command line; as in SITL (:mod:`autopilot.run.sitl_params`)."""
    params = ParamSet()
    apply_parameters(config, params)
    persistent, warnings = kept_params(state_folder(settings, config, instance), params, overrides, disk)
    return params, persistent, warnings


def state_folder(settings: EffectiveSettings, config: VehicleConfig, instance: int) -> Path:
    """Folder of the files that an instance keeps between runs."""
    return Path(settings["state_dir"]) / f"{config.vehicle.name}-{instance}"


class HardwareWorld(World):
    """A real vehicle of a configuration file, or one whose devices are emulated and follow the ticks (speed 0)."""

    device: HardwareVehicle

    def __init__(
        self,
        settings: EffectiveSettings,
        config: VehicleConfig,
        overrides: dict[str, float],
        instance: int,
        speed: float,
    ) -> None:
        place = config.file.place
        self.settings, self.speed, self._config = settings, speed, config
        self.folder = state_folder(settings, config, instance)
        self.disk = BackgroundWorker(DaemonExecutor("disk"), blocking=speed == 0.0)
        self.params, self.persistent, self.warnings = vehicle_params(settings, config, overrides, instance, self.disk)
        self.known = KnownEnvironment(
            vehicle=config.vehicle,
            origin=params_origin(self.params),
            markers=None if config.markers is None else load_marker_map(config.markers),
            floor_depth_m=place.floor_depth_m,
            currents=forecast_of(place.currents, place.basin, NoCurrent),
            pictures=config.has_camera,
        )
        self.current_source = CurrentSource(kind=place.currents, basin=place.basin)
        self.plan = None if settings["plan"] is None else Path(settings["plan"])
        self.skips = speed > 0.0
        self.duration_s = settings["duration"]

    def open_device(self, parts: ServiceParts) -> None:
        """Nothing is opened before the first tick."""
        self.device = HardwareVehicle(self._config, lockstep=self.speed == 0.0)
        parts.equipment.leave_out(self.device.unwired)

    def epoch_ns(self, t_us: int) -> int:
        """By the clock of now, which may have been set since the start. Of one that is decades off (no battery, no
        network) the nearest time that a log can hold: a log with wrong dates is better than none."""
        return min(max(time.time_ns() - 1000 * t_us, FIRST_EPOCH_NS), LAST_EPOCH_NS - 1)

    def describe(self, parts: ServiceParts) -> RunDescription:
        return describe_service(parts, self._config.file.place.name)

    def metadata(self) -> dict[str, str]:
        place = self._config.file.place
        return {
            "config": self._config.path.name,
            "place": place.name,
            "currents": place.currents,
            "basin": place.basin,
            **{f"device.{kind}": setup.driver for kind, setup in self._config.devices.items()},
        }

    def attachments(self) -> dict[str, bytes]:
        return {"config_file.json": msgspec.json.encode(self._config.file)}

    def controls(self, clock: PacedClock | LockstepClock) -> ReadOnly:
        return ReadOnly()

    def below(self, t_us: int) -> FlightControllerState | None:
        """State of the flight controller, None without one."""
        return self.device.below(t_us)

    def notices(self) -> Sequence[tuple[Severity, str]]:
        return self.device.take_notices()

    def refusals(self, t_us: int) -> tuple[str, ...]:
        """Configured devices that are missing."""
        return self.device.refusals(t_us)


def open_vehicle(
    settings: EffectiveSettings,
    config: VehicleConfig,
    overrides: dict[str, float],
    *,
    instance: int = 0,
    speed: float = 1.0,
    **more: Unpack[SessionOptions],
) -> Session:
    """A run on a vehicle, as :func:`autopilot.run.session.open_session` does it.

    ``speed``: of the devices' time; 0 where they, being emulated, follow the ticks.
    """
    world = HardwareWorld(settings, config, overrides, instance, speed)
    return open_session(Session, world, instance=instance, **more)
