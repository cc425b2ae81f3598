"""The real service with a vehicle: its thrust moves a model whose sensors it hears."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import development as mav
from service_world import TICK_US, ServiceWorld

from autopilot.core import model4
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import Outputs
from autopilot.core.plan import PlanKind
from autopilot.core.samples import AhrsSample, DepthSample, PoseSample, PowerSample, Sample
from autopilot.mission.paper import paper_plan

PILLARS = ((-0.625, -0.625), (0.9375, 0.0))
OFFBOARD, HOLD, MANUAL, ALTITUDE, POSITION, STABILIZED, TAKEOFF, ORBIT = (
    (main << 16) | (sub << 24) for main, sub in ((6, 0), (4, 3), (1, 0), (2, 0), (3, 0), (7, 0), (4, 2), (3, 1))
)
MISSION, RETURN, SURFACE = (4 << 16 | sub << 24 for sub in (4, 5, 6))


class PilotedWorld(ServiceWorld):
    """The paper's tank with its fence. ``fixes`` False: no positions; ``depth`` True: a pressure sensor."""

    def __init__(
        self,
        start: Sequence[float] = (-1.6, 0.5, 0.5, 0.0),
        params: dict[str, float] | None = None,
        *,
        fixes: bool = True,
        depth: bool = False,
        extra_buoyancy_n: float = 0.0,
        current: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        super().__init__(params)
        self.fixes, self.depth = fixes, depth
        self.model = self.vehicle.to_model()
        self.extra_n = extra_buoyancy_n
        self.x = np.array([*start, 0.0, 0.0, 0.0, 0.0])
        self.current = np.array([*current, 0.0])
        self.acting = np.zeros(4)
        self.accel = np.zeros(3)
        self.track: list[FloatArray] = []
        self.thrust: list[FloatArray] = []
        assert self.parts.plans.replace(PlanKind.FENCE, paper_plan(1).fence) is None

    def samples(self) -> tuple[Sample, ...]:
        t_us, x, tick = self.t_us, self.x, self.t_us // TICK_US
        dither = 1e-5 * np.sin([tick, 2.0 * tick, 0.3 * tick])
        samples: list[Sample] = [
            AhrsSample(
                t_us=t_us,
                rpy_rad=dither + np.array([0.0, 0.0, wrap_pi(float(x[3]))]),
                rate_frd_rad_s=dither + np.array([0.0, 0.0, x[7]]),
                accel_frd_m_s2=self.accel + dither + np.array([0.0, 0.0, -9.81]),
            )
        ]
        if self.fixes and t_us % 50_000 == 0:
            sigma = np.full(3, 0.005)
            samples.append(
                PoseSample(
                    t_us=t_us,
                    pos_ned_m=x[:3] + dither,
                    yaw_rad=wrap_pi(float(x[3])),
                    sigma_pos_m=sigma,
                    sigma_yaw_rad=0.01,
                )
            )
        if self.depth and t_us % 100_000 == 0:
            samples.append(DepthSample(t_us=t_us, depth_m=float(x[2] + dither[0]), sigma_m=0.005))
        if t_us % 1_000_000 == 0:
            samples.append(PowerSample(t_us=t_us, voltage_v=19.0, current_a=1.0, energy_used_j=0.0, remaining=0.9))
        return tuple(samples)

    def tick(self, rx: Sequence[bytes] = (), samples: Sequence[Sample] | None = None) -> Outputs:
        outputs = super().tick(rx, samples)
        self.acting = self.acting + (outputs.command.thrust_n[:4] - self.acting) * (1.0 - math.exp(-0.01 / 0.15))
        slope = np.array(
            model4.state_derivative(self.model, self.x.tolist(), self.acting.tolist(), self.current.tolist(), math)
        )
        slope[6] -= self.extra_n / self.model.mass_kg[2]
        self.accel = slope[4:7] + np.cross([0.0, 0.0, self.x[7]], self.x[4:7])
        self.x = self.x + 0.01 * slope
        self.x[2] = max(self.x[2], 0.0)
        self.track.append(self.x.copy())
        self.thrust.append(outputs.command.thrust_n[:4].copy())
        return outputs

    # The client

    def arm(self) -> None:
        assert self.command(400, 1.0) == 0, self.texts()

    def mode(self, custom_mode: int) -> int:
        """DO_SET_MODE as MAVSDK sends it; its result."""
        return self.command(176, 1.0, float(custom_mode >> 16 & 0xFF), float(custom_mode >> 24))

    def steer(
        self, seconds: float, x: int = 0, y: int = 0, z: int = 500, r: int = 0, buttons: int = 0, every: int = 4
    ) -> Outputs:
        """MANUAL_CONTROL as QGroundControl's joystick sends it: 25 times a second."""
        for n in range(round(100 * seconds)):
            sticks = mav.MAVLink_manual_control_message(1, x, y, z, r, buttons)
            outputs = self.tick([self.pack(sticks)] if n % every == 0 else ())
        return outputs

    def stream(self, seconds: float, message: Any, every: int = 5) -> Outputs:
        """A set point 20 times a second, as MAVSDK does."""
        for n in range(round(100 * seconds)):
            outputs = self.tick([self.pack(message)] if n % every == 0 else ())
        return outputs

    @property
    def custom_mode(self) -> int:
        """Of the last HEARTBEAT that came within the next second."""
        self.inbox.clear()
        self.run(1.05)
        return int([m for m in self.inbox if m.get_type() == "HEARTBEAT"][-1].custom_mode)

    def clearance_m(self) -> float:
        """Least distance of the vehicle's ball from walls and pillars so far."""
        track = np.array(self.track)
        wall = np.minimum(2.5 - np.abs(track[:, 0]), 1.5 - np.abs(track[:, 1])).min()
        pillar = min(float(np.hypot(track[:, 0] - x, track[:, 1] - y).min()) for x, y in PILLARS) - 0.16
        return min(float(wall), pillar) - 0.3

    def step_n(self) -> float:
        """Largest change of a thruster's command from tick to tick so far."""
        return float(np.abs(np.diff(np.array(self.thrust), axis=0)).max())


def position(x: float, y: float, z: float, yaw: float = 0.0, mask: int = 2552, frame: int = 1, **more: float) -> Any:
    """SET_POSITION_TARGET_LOCAL_NED."""
    rest = {"vx": 0.0, "vy": 0.0, "vz": 0.0, "yaw_rate": 0.0, **more}
    return mav.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, frame, mask, x, y, z, rest["vx"], rest["vy"], rest["vz"], 0, 0, 0, yaw, rest["yaw_rate"]
    )


def velocity(vx: float, vy: float, vz: float, yaw: float = 0.0) -> Any:
    """As MAVSDK's set_velocity_ned sends it."""
    return position(0.0, 0.0, 0.0, yaw, mask=2503, vx=vx, vy=vy, vz=vz)
