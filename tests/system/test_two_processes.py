"""Two vehicles in two processes: ports, system ids and folders of their own, one is the other's router.

Two processes cannot be in lockstep, and one that gets no CPU time stands still in its own time. So whoever looks on
holds the one that is ahead (SIGSTOP) until the other has come after it: what is judged does not depend on how busy
the machine is. On a busy machine each still hears late of the other and dodges late: the basin is wide enough for that,
and has no pillars (tests/system/test_two_vehicles.py has, in lockstep).
"""

import re
import select
import signal
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plan_text import WORKSPACE
from test_two_vehicles import BODY_M, SCENARIOS

from autopilot.core.geodesy import Origin, deg_from_e7, ned_from_geodetic
from autopilot.log.reader import open_log
from autopilot.mavlink.dialect import mav
from autopilot.run.children import Child, autopilot_command, free_port

AHEAD_S = 0.15
"""So far one's time may be ahead of the other's."""
CPU_S = 120.0
"""More work than this is never done: something hangs."""
WAYS = (((-3.0, 1.2, 0.45), (3.0, -0.6, 0.45)), ((3.0, 1.2, 0.45), (-3.0, -0.6, 0.45)))
"""Start and goal of both: the straight ways cross where both would be at the same time."""
CORNERS_M = "[[-6.0, -4.0], [6.0, -4.0], [6.0, 4.0], [-6.0, 4.0]]"
HEAD = re.sub("(?m)^points_m = .*$", f"points_m = {CORNERS_M}", WORKSPACE)
TANK = Origin(lat_deg=37.9755, lon_deg=23.7790)


class Vehicle:
    """A process with its vehicle, as the one who looks on knows it."""

    def __init__(self, folder: Path, instance: int, *connections: str) -> None:
        self.log, self.sysid = folder / f"{instance}.mcap", 1 + instance
        start, goal = WAYS[instance]
        text = (SCENARIOS / "paper-tank-still.toml").read_text(encoding="utf-8")
        text = text[: text.index("[[obstacle]]")] + text[text.index("[current]") :]
        put = {"start_m": f"[{start[0]}, {start[1]}, {start[2]}]", "polygon_m": CORNERS_M, "plan": None, "held": None}
        for name, value in put.items():
            text = re.sub(rf"(?m)^{name} = .*$", f"{name} = {value}" if value else "", text)
        scenario, plan = folder / f"tank{instance}.toml", folder / f"plan{instance}.toml"
        scenario.write_text(text, encoding="utf-8")
        way = f"[[waypoint]]\nx_m = {goal[0]}\ny_m = {goal[1]}\ndepth_m = {goal[2]}\naccept_m = 0.3\n"
        plan.write_text(HEAD + way, encoding="utf-8")
        self.child = Child(
            autopilot_command(
                *("sitl", str(scenario), "--plan", str(plan), "--quiet", "--sensors", "pose", "--speed", "1"),
                *("--instance", str(instance), "--log", str(self.log), "--param", "MAV_FORWARD=1"),
                *("--param", "MPC_COST=0"),  # whose plans cost a third of the work
                *(part for connection in connections for part in ("--connect", connection)),
            ),
            {"AUTOPILOT_STATE_DIR": str(folder / "state")},
        )
        self.boot_s = self.since_s = 0.0
        """Its time, as last heard, and where counting begins."""
        self.pos_ned_m: np.ndarray | None = None
        self.complete = self.ready = False
        self.stopped = False

    def hold(self, *, held: bool) -> None:
        """Let its process stand still or go on."""
        if held is not self.stopped:
            self.child.process.send_signal(signal.SIGSTOP if held else signal.SIGCONT)
            self.stopped = held


class Onlooker:
    """A ground station that knows the first vehicle, and hears of the other and commands it through the first. By a
    line of its own it only sees how far the other's time is: one that stands still passes nothing on."""

    def __init__(self, port: int, clock_port: int, vehicles: tuple[Vehicle, Vehicle]) -> None:
        self.vehicles = {vehicle.sysid: vehicle for vehicle in vehicles}
        self._address, self._clock_address = ("127.0.0.1", port), ("127.0.0.1", clock_port)
        self._clock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._codec: Any = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        self._idle: Any = mav.MAVLink(None, srcSystem=254, srcComponent=191)
        self._codec.robust_parsing = self._idle.robust_parsing = True
        self.inbox: list[Any] = []
        self.least_m = np.inf

    def close(self) -> None:
        self._socket.close()
        self._clock.close()

    def send(self, message: Any) -> None:
        self._socket.sendto(message.pack(self._codec), self._address)
        self._codec.seq = (self._codec.seq + 1) & 0xFF

    def look(self, *, paced: bool = True) -> None:
        """One round: speak, hear, and hold whoever is ahead."""
        self.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        self._clock.sendto(mav.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(self._idle), self._clock_address)
        while ready := select.select([self._socket, self._clock], [], [], 0.02)[0]:
            if self._socket in ready:
                for message in self._codec.parse_buffer(self._socket.recv(4096)) or ():
                    self._note(message)
            if self._clock in ready:
                for message in self._idle.parse_buffer(self._clock.recv(4096)) or ():
                    vehicle = self.vehicles.get(message.get_srcSystem())
                    if vehicle is not None and message.get_type() == "GLOBAL_POSITION_INT":
                        vehicle.boot_s = max(vehicle.boot_s, 1e-3 * message.time_boot_ms)
        one, two = self.vehicles.values()
        for vehicle, other in ((one, two), (two, one)):
            vehicle.hold(held=paced and vehicle.boot_s - vehicle.since_s > other.boot_s - other.since_s + AHEAD_S)
            assert vehicle.stopped or vehicle.child.at_work()
            spent_s = vehicle.child.cpu_s()
            assert spent_s is not None and spent_s < CPU_S
        if one.pos_ned_m is not None and two.pos_ned_m is not None:
            self.least_m = min(self.least_m, float(np.linalg.norm((one.pos_ned_m - two.pos_ned_m)[:2])))

    def _note(self, message: Any) -> None:
        vehicle = self.vehicles.get(message.get_srcSystem())
        if vehicle is None or message.get_srcComponent() != 1:
            return
        self.inbox.append(message)
        match message.get_type():
            case "GLOBAL_POSITION_INT":
                place = (deg_from_e7(message.lat), deg_from_e7(message.lon), message.alt * 1e-3)
                vehicle.pos_ned_m = np.array(ned_from_geodetic(TANK, *place))
                vehicle.boot_s = max(vehicle.boot_s, 1e-3 * message.time_boot_ms)
            case "SYS_STATUS":
                bit = mav.MAV_SYS_STATUS_PREARM_CHECK
                vehicle.ready = bool(message.onboard_control_sensors_health & bit)
            case "STATUSTEXT":
                vehicle.complete |= message.text.startswith("Mission complete")

    def begin(self) -> None:
        """Count the times of both from now on."""
        for vehicle in self.vehicles.values():
            vehicle.since_s = vehicle.boot_s

    def command(self, vehicle: Vehicle, number: int, *params: float) -> None:
        """COMMAND_LONG until it is accepted."""
        values = [*params, *[0.0] * 7][:7]
        for _ in range(400):
            self.inbox.clear()
            self.send(mav.MAVLink_command_long_message(vehicle.sysid, 1, number, 0, *values))
            self.look(paced=False)
            for ack in (m for m in self.inbox if m.get_type() == "COMMAND_ACK" and m.command == number):
                if ack.get_srcSystem() == vehicle.sysid and ack.result == 0:
                    return
        pytest.fail(f"command {number} to vehicle {vehicle.sysid}: no ACCEPTED; it said {self.inbox}")


@pytest.fixture
def two(tmp_path: Path) -> Iterator[Onlooker]:
    """The first listens, for the second and for whoever looks on."""
    between, outside, clock = free_port(), free_port(), free_port()
    with ExitStack() as stack:
        first = Vehicle(tmp_path, 0, f"udpin:127.0.0.1:{between}", f"udpin:127.0.0.1:{outside}")
        stack.callback(first.child.end)
        second = Vehicle(tmp_path, 1, f"udpout:127.0.0.1:{between}", f"udpin:127.0.0.1:{clock}")
        stack.callback(second.child.end)
        onlooker = Onlooker(outside, clock, (first, second))
        stack.callback(onlooker.close)
        for vehicle in (first, second):
            stack.callback(lambda vehicle=vehicle: vehicle.hold(held=False))
        yield onlooker


def test_two_processes_avoid_each_other_by_what_each_broadcasts(two: Onlooker, tmp_path: Path) -> None:
    first, second = two.vehicles.values()
    while not (first.ready and second.ready):
        two.look(paced=False)
    for vehicle in (first, second):
        two.command(vehicle, mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        wanted = 60.0 + vehicle.sysid
        two.send(mav.MAVLink_param_set_message(vehicle.sysid, 1, b"WP_STUCK_TIME", wanted, 9))
    # Times began when the processes did: from here on they are counted from the same moment.
    two.begin()
    for vehicle in (first, second):
        two.command(vehicle, mav.MAV_CMD_MISSION_START)
    while not (first.complete and second.complete):
        two.look()
    for vehicle in (first, second):
        vehicle.hold(held=False)
        assert vehicle.child.end() == 0
        log = open_log(vehicle.log)
        assert log["/sim/contact"]["count"].max() == 0
    assert two.least_m > 2.0 * BODY_M - 0.02
    folders = {path.name: path for path in (tmp_path / "state").iterdir()}
    assert set(folders) == {"sitl-0", "sitl-1"}
    for vehicle in (first, second):
        kept = "".join(path.read_text() for path in folders[f"sitl-{vehicle.sysid - 1}"].glob("param*"))
        assert f"{60 + vehicle.sysid}" in kept and f"{60 + 3 - vehicle.sysid}" not in kept
