"""The real service and a client in its time: bytes in, bytes out, no vehicle but the samples that a test makes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import development as mav

from autopilot.control.current.currents import NoCurrent
from autopilot.core.geodesy import Origin
from autopilot.core.messages import Inputs, MavlinkFrame, Outputs
from autopilot.core.params import ParamSet
from autopilot.core.samples import AhrsSample, PoseSample, PowerSample, Sample
from autopilot.core.vehicle import load_vehicle
from autopilot.run.compose import ServiceSetup, build_service

TICK_US = 10_000
ORIGIN = Origin(lat_deg=37.9755, lon_deg=23.7790)


class ServiceWorld:
    """A service whose sensors say that the vehicle rests at a place."""

    pictures = False
    """Whether there is a camera."""

    profile = "px4"
    vehicle_name = "lbv150"

    def __init__(self, params: dict[str, float] | None = None, origin: Origin = ORIGIN) -> None:
        self.vehicle = load_vehicle(self.vehicle_name)
        self.params = ParamSet(params or {})
        self.service, self.parts = build_service(
            ServiceSetup(
                vehicle=self.vehicle,
                params=self.params,
                origin=origin,
                markers=None,
                floor_depth_m=None,
                estimator="ekf",
                profile=self.profile,
                instance=0,
                currents=NoCurrent(),
                links=1,
                patience=1.0,
                waits_for_plans=True,
                pictures=self.pictures,
            )
        )
        self.t_us = 0
        self.pos_ned_m = np.array([0.0, 0.0, 0.4])
        self._mav = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        self._mav.robust_parsing = True
        self.inbox: list[Any] = []

    def samples(self) -> tuple[Sample, ...]:
        """What sound sensors say on this tick."""
        t_us, tick = self.t_us, self.t_us // TICK_US  # a device at rest whose last digits move: else it is frozen
        samples: list[Sample] = [
            AhrsSample(
                t_us=t_us,
                rpy_rad=1e-4 * np.sin([tick, 2.0 * tick, 0.3 * tick]),
                rate_frd_rad_s=1e-4 * np.cos([tick, 2.0 * tick, 0.3 * tick]),
                accel_frd_m_s2=np.array([1e-3 * np.sin(tick), 1e-3 * np.cos(tick), -9.81]),
            )
        ]
        if t_us % 100_000 == 0:
            sigma = np.full(3, 0.01)
            samples.append(
                PoseSample(t_us=t_us, pos_ned_m=self.pos_ned_m, yaw_rad=0.0, sigma_pos_m=sigma, sigma_yaw_rad=0.02)
            )
        if t_us % 1_000_000 == 0:
            samples.append(PowerSample(t_us=t_us, voltage_v=19.0, current_a=1.0, energy_used_j=0.0, remaining=0.9))
        return tuple(samples)

    def camera(self) -> dict[str, Any]:
        """What the camera says on this tick, as fields of Inputs."""
        return {}

    def tick(self, rx: Sequence[bytes] = (), samples: Sequence[Sample] | None = None) -> Outputs:
        """One tick."""
        self.t_us += TICK_US
        frames = tuple(MavlinkFrame(link=0, data=data) for data in rx)
        given = self.samples() if samples is None else tuple(samples)
        outputs = self.service.step(Inputs(t_us=self.t_us, samples=given, mavlink_rx=frames, **self.camera()))
        for frame in outputs.mavlink_tx:
            self.inbox += self._mav.parse_buffer(frame.data) or ()
        return outputs

    def run(self, seconds: float) -> Outputs:
        """Ticks without requests; the last one's outputs."""
        for _ in range(round(seconds * 100)):
            outputs = self.tick()
        return outputs

    def pack(self, message: Any) -> bytes:
        """A message of this client."""
        data = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return data

    def ask(self, message: Any, seconds: float = 0.03) -> list[Any]:
        """Send; what came back."""
        self.inbox.clear()
        self.tick([self.pack(message)])
        self.run(seconds)
        return list(self.inbox)

    def command_int(self, command: int, lat: float, lon: float, alt: float, param1: float = 0.0, frame: int = 0) -> int:
        """COMMAND_INT with a place; its result."""
        scale = 1e4 if frame == 1 else 1e7
        x, y = (max(-0x8000_0000, min(0x7FFF_FFFF, round(v * scale))) for v in (lat, lon))
        message = mav.MAVLink_command_int_message(1, 1, frame, command, 0, 0, param1, 1.0, 0.0, 0.0, x, y, alt)
        return next(int(m.result) for m in self.ask(message) if m.get_type() == "COMMAND_ACK")

    def command(self, command: int, *params: float) -> int:
        """COMMAND_LONG; its result."""
        message = mav.MAVLink_command_long_message(1, 1, command, 0, *(*params, *(0.0,) * 7)[:7])
        return next(int(m.result) for m in self.ask(message) if m.get_type() == "COMMAND_ACK")

    def texts(self) -> str:
        """What the operator was told."""
        return "".join(m.text for m in self.inbox if m.get_type() == "STATUSTEXT")
