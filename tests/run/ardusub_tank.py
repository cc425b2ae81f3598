"""A BlueROV2 with the emulated ArduSub in the paper's tank, and the service that flies it, in lockstep."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import pytest

from autopilot.core.messages import Outputs
from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.links import open_link
from autopilot.mission.plan_files import write_plan
from autopilot.run.children import free_port
from autopilot.run.config import EffectiveSettings, gather, vehicle_defaults
from autopilot.run.demo import paper_plan
from autopilot.run.hardware_session import open_vehicle
from autopilot.run.session import Session
from autopilot.run.vehicle_config import load_config
from autopilot.sitl.ardusub_vehicle import ArduSubVehicle
from autopilot.sitl.operator import ScriptedOperator
from autopilot.sitl.scenario import load_scenario, with_vehicle
from tests.lossy_link import LinkConditions, LossyLink

PERFECT = LinkConditions()


class Tank:
    """The service on the vehicle's companion, an operator and a pilot."""

    def __init__(
        self, folder: Path, *, operator: bool = True, conditions: LinkConditions = PERFECT, **parameters: float
    ) -> None:
        """``operator``: one who arms and starts the mission. ``conditions``: of the links to the flight controller and
        of the tracking system's."""
        below, ours = free_port(), free_port()
        path = folder / "rov.toml"
        path.write_text(
            f'vehicle = "bluerov2"\n[devices.flight_controller]\ndriver = "ardusub"\nframe = "vectored"\n'
            f'connect = "udpin:127.0.0.1:{below}"\n'
        )
        plan = folder / "paper.plan"
        write_plan(plan, paper_plan(1))
        settings: EffectiveSettings = gather(
            vehicle_defaults(0),
            {
                "connect": (f"udpin:127.0.0.1:{ours}",),
                "state_dir": str(folder),
                "log": str(folder / "run.mcap"),
                "plan": str(plan),
            },
            {},
        )
        scenario = with_vehicle(load_scenario("paper-tank"), "bluerov2", "--vehicle")
        self.world = ArduSubVehicle(scenario, load_vehicle("bluerov2"), "vectored", seed=1)
        self.below = self.world.controller
        self._wire = open_link(f"udpout:127.0.0.1:{below}")
        self._client = open_link(f"udpout:127.0.0.1:{ours}")
        self._operator = ScriptedOperator(1) if operator else None
        self._pilot: Any = self.below.codec(255, 190)
        self.up, self.down, self.poses = (LossyLink(conditions, seed) for seed in range(3))
        self.texts: list[tuple[float, str]] = []
        self.outputs: Outputs | None = None
        self.session: Session = open_vehicle(
            settings, load_config(str(path)), parameters, speed=0.0, on_tick=self._tick
        )
        self._t_us = 0
        self.unheard = False
        """What the flight controller says gets lost; it hears us."""
        self.deaf = False
        """What is said to it gets lost."""
        self.late_us = 0
        """So much the loop lags behind the world."""

    def _tick(self, outputs: Outputs) -> None:
        """After the service's tick: the world goes on, and everybody speaks."""
        self.outputs = outputs
        self.texts += [(1e-6 * event.t_us, event.text) for event in outputs.events]
        t_us = outputs.t_us
        self.world_goes_on(t_us)
        pose = self.world.pose(t_us)
        if pose is not None:
            self.poses.put(t_us, pose)
        for data in self.poses.take(t_us):
            self._client.send(data)
        received = [received.data for received in self._client.recv(t_us)]
        for data in () if self._operator is None else self._operator.step(t_us, received):
            self._client.send(data)

    def world_goes_on(self, t_us: int) -> None:
        """Water, vehicle and flight controller."""
        for received in self._wire.recv(t_us):
            if not self.deaf:
                self.up.put(t_us, received.data)
        for data in self.up.take(t_us):
            self.below.receive(t_us, data)
        for data in self.world.advance(t_us + self.late_us):
            if not self.unheard:
                self.down.put(t_us, data)
        for data in self.down.take(t_us):
            self._wire.send(data)

    def run(self, until: Callable[[Outputs], bool], at_most_s: float) -> None:
        """Ticks until something is so."""
        for _ in range(round(at_most_s * 100)):
            self._t_us += 10_000
            self.session.runtime.tick(self._t_us)
            assert self.outputs is not None
            if until(self.outputs):
                return
        pytest.fail(f"not within {at_most_s} s; {self.texts[-12:]}")

    def order(self, message: Any) -> None:
        """A client's, to the service."""
        self._client.send(bytes(message.pack(self._pilot)))

    def pilot(self, message: Any) -> None:
        self.below.receive(self._t_us, bytes(message.pack(self._pilot)), link=9)

    def pilot_mode(self, mode: int) -> None:
        self.pilot(self._pilot.command_long_encode(1, 1, 176, 0, 1, mode, 0, 0, 0, 0, 0))

    def stick(self, x: int) -> None:
        self.pilot(self._pilot.manual_control_encode(1, x, 0, 500, 0, 0))

    def reported(self, text: str) -> bool:
        return any(text in line for _, line in self.texts)

    def close(self) -> None:
        self.session.close()
        self._wire.close()
        self._client.close()


T = TypeVar("T", bound=Tank)


@contextlib.contextmanager
def tanks(kind: type[T], folder: Path) -> Iterator[Callable[..., T]]:
    """Makes them, with parameters; all are closed at the end."""
    with contextlib.ExitStack() as stack:

        def make(**parameters: float) -> T:
            return stack.enter_context(contextlib.closing(kind(folder, **parameters)))

        yield make
