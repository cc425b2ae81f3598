"""A pilot's flights on the simulated vehicle with its camera or a pose sensor, and ArduSub's autotest cases among them.

The bounds are those of Tools/autotest/ardusub.py or tighter.
"""

import math
import random
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from system_harness import ROOT, OpenSession
from wire_client import WireClient

from autopilot.core.messages import Outputs
from autopilot.core.plan import PlanKind
from autopilot.mavlink.dialect import mav
from autopilot.mission.paper import paper_plan

SCENARIOS = ROOT / "sitl" / "scenarios"
HOLD, MANUAL, ALTITUDE, POSITION, STABILIZED, ORBIT = (
    (main << 16) | (sub << 24) for main, sub in ((4, 3), (1, 0), (2, 0), (3, 0), (7, 0), (3, 1))
)
"""Numbers of modes under profile px4."""
STEP_N, STEP_M = 3.0, 0.1
"""A switch of modes changes no thruster and no depth by more."""


class Pilot(WireClient):
    """A joystick and its ground station, in the vehicle's time."""

    sticks: tuple[int, int, int, int] | None = None

    def step(self, t_us: int, received: Sequence[bytes]) -> list[bytes]:
        """Orders at once, a heartbeat every second, sticks 25 times a second."""
        if t_us % 1_000_000 == 0:
            self.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        if self.sticks is not None and t_us % 40_000 == 0:
            x, y, z, r = self.sticks
            self.send(mav.MAVLink_manual_control_message(1, x, y, z, r, 0))
        return super().step(t_us, received)


class Flight:
    """The paper's tank with its fence, armed in Hold."""

    def __init__(self, session: OpenSession, **given: Any) -> None:
        self.pilot = Pilot()
        given = {"sensors": "pose", **given}
        self.session = session(peers=(self.pilot,), **given)
        assert self.session.parts.plans.replace(PlanKind.FENCE, paper_plan(1).fence) is None
        self._tick = 0
        self.depth: list[float] = []
        self.thrust: list[np.ndarray] = []
        self.place: list[np.ndarray] = []
        self.run(4.0)
        self.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        self.run(2.0)

    def run(self, seconds: float, sticks: tuple[int, int, int, int] | None = None) -> Outputs:
        """So long with these sticks (x, y, z, r), None = the joystick is silent."""
        self.pilot.sticks = sticks
        for _ in range(round(100 * seconds)):
            self._tick += 1
            outputs = self.session.runtime.tick(10_000 * self._tick)
            truth = self.session.device.truth
            self.depth.append(float(truth.pos_ned_m[2]))
            self.place.append(np.array(truth.pos_ned_m))
            self.thrust.append(np.array(outputs.command.thrust_n[:4]))
        return outputs

    def command(self, number: int, *params: float, accepted: bool = True) -> None:
        """COMMAND_LONG, and what becomes of it."""
        self.pilot.inbox.clear()
        self.pilot.send(mav.MAVLink_command_long_message(1, 1, number, 0, *(*params, *[0.0] * 7)[:7]))
        self.run(0.05, self.pilot.sticks)
        acks = [m.result for m in self.pilot.received("COMMAND_ACK")]
        texts = [m.text for m in self.pilot.received("STATUSTEXT")]
        assert (acks == [0]) is accepted, (number, acks, texts)

    def mode(self, custom_mode: int) -> None:
        """DO_SET_MODE; it changes neither depth nor thrust suddenly."""
        since, depth = len(self.thrust), self.depth[-1]
        self.command(mav.MAV_CMD_DO_SET_MODE, 1.0, float(custom_mode >> 16 & 0xFF), float(custom_mode >> 24))
        self.run(0.3, self.pilot.sticks)
        steps = np.abs(np.diff(np.array(self.thrust[since - 1 :]), axis=0))
        assert steps.max() <= STEP_N, (hex(custom_mode), steps.max())
        assert abs(self.depth[-1] - depth) <= STEP_M, hex(custom_mode)

    def touches_nothing(self) -> bool:
        """Whether the hull has touched neither wall nor pillar nor floor."""
        return self.session.device.truth.contact_count == 0

    def drift_m(self, seconds: float) -> float:
        """Farthest from where it was at the beginning of the last seconds."""
        track = np.array(self.place[-round(100 * seconds) :])
        return float(np.linalg.norm(track - track[0], axis=1).max())


def random_flight(flight: Flight, seed: int, legs: int) -> None:
    """Sticks and modes as they come."""
    rng = random.Random(seed)
    for _ in range(legs):
        mode = rng.choice((MANUAL, STABILIZED, ALTITUDE, POSITION, ORBIT, HOLD))
        if mode != ORBIT:
            flight.mode(mode)
        else:
            since = len(flight.thrust)
            orbit = (rng.choice((0.3, -0.3)), 0.15, 0.0, 0.0)
            flight.pilot.send(
                mav.MAVLink_command_int_message(1, 1, 3, 34, 0, 0, *orbit, 0x7FFF_FFFF, 0x7FFF_FFFF, math.nan)
            )
            flight.run(0.3, flight.pilot.sticks)
            assert np.abs(np.diff(np.array(flight.thrust[since - 1 :]), axis=0)).max() <= STEP_N
        z = rng.choice((500, 500, 0, 1000))
        sticks = (
            rng.choice((0, 1000, -1000, rng.randint(-1000, 1000))),
            rng.choice((0, 1000, -1000)),
            z,
            rng.choice((0, 600)),
        )
        flight.run(0.3, (0, 0, 500, 0))
        flight.run(rng.uniform(1.0, 4.0), sticks)
        assert flight.touches_nothing()


@pytest.mark.parametrize(("seed", "sensors", "legs"), [(1, "camera", 3), (2, "pose", 5)])
def test_random_sticks_and_modes_on_the_simulated_vehicle_touch_nothing(
    session: OpenSession, seed: int, sensors: str, legs: int
) -> None:
    """DiveManual and ModeChanges (depth <= 0.2 m there, 0.1 m here)."""
    flight = Flight(session, sensors=sensors, seed=seed)
    random_flight(flight, seed, legs)


def test_position_is_held_and_braking_does_not_rebound(session: OpenSession) -> None:
    """PositionHold (1 m in 10 s there, 0.1 m here) in the tank's current; PosHoldBounceBack (10 s, 0.2 m; here 0.1 m);
    DoubleCircle: a circle begun, left and begun again."""
    flight = Flight(session)
    flight.mode(POSITION)
    flight.run(2.0, (0, 0, 500, 0))
    flight.run(2.0, (-600, 0, 500, 0))
    flight.run(3.0, (0, 0, 500, 0))
    stop = flight.place[-1]
    flight.run(5.0, (0, 0, 500, 0))
    assert flight.drift_m(5.0) < 0.1
    assert np.linalg.norm(flight.place[-1] - stop) < 0.1
    for _ in range(2):
        flight.pilot.send(
            mav.MAVLink_command_int_message(1, 1, 3, 34, 0, 0, 0.3, 0.15, 0.0, 0.0, 0x7FFF_FFFF, 0x7FFF_FFFF, math.nan)
        )
        flight.run(2.0)
        flight.mode(POSITION)
        flight.run(1.0, (0, 0, 500, 0))
    assert flight.touches_nothing()


@pytest.mark.parametrize(
    ("vehicle", "buoyancy", "cost"),
    [("lbv150", 1.008, 0), ("bluerov2", 0.97, 1), ("bluerov2", 1.03, 0)],
)
def test_depth_is_held_with_the_wrong_buoyancy(
    session: OpenSession, tmp_path: Path, vehicle: str, buoyancy: float, cost: int
) -> None:
    """AltitudeHold: 0.3 m there, with 10 N; 0.06 m here, with 0.9 N and 3.4 N that nobody has told the vehicle of: it
    sank by 0.3 m and on to the floor, and a stick that asks for 0.12 m/s moved it by 0.05 m."""
    text = (SCENARIOS / "paper-tank-still.toml").read_text(encoding="utf-8")
    kept = [line for line in text.splitlines() if not line.startswith(("plan", "held", "mismatch", "model"))]
    at = kept.index("[vehicle]") + 1
    kept[at:at] = [f'model = "{vehicle}"', f"mismatch = {{ buoyancy = {buoyancy} }}"]
    (tmp_path / "tank.toml").write_text("\n".join(kept), encoding="utf-8")
    flight = Flight(session, scenario=str(tmp_path / "tank.toml"), params={"MPC_COST": cost})
    flight.mode(ALTITUDE)  # sinking or rising: from the place in Hold to the depth of now thrust was reversed at once
    flight.run(8.0, (0, 0, 500, 0))
    flight.run(1.0, (0, 0, 500, 0))
    assert np.ptp(flight.depth[-300:]) < 0.06
    before, down = flight.depth[-1], buoyancy > 1.0  # the heavy one has sunk before it was armed
    flight.run(2.5, (0, 0, 100 if down else 900, 0))
    flight.run(3.0, (0, 0, 500, 0))
    assert (flight.depth[-1] - before) * (1.0 if down else -1.0) > 0.2
    flight.run(4.0, (0, 0, 500, 0))
    assert np.ptp(flight.depth[-400:]) < 0.06
    assert flight.touches_nothing()
