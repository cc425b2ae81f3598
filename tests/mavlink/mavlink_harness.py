"""A MAVLink client in memory with virtual time, and the two things the server talks to: plans and a vehicle."""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import development as mav

from autopilot.core.geodesy import GeodeticPosition
from autopilot.core.messages import (
    Event,
    MavlinkFrame,
    MissionProgress,
    NavHealth,
    NavState,
    ProgressState,
    RunEnd,
    ThrusterCommand,
)
from autopilot.core.params import ParamSet, Saved
from autopilot.core.plan import MissionResult, PlanItem, PlanKind, PlanRejection
from autopilot.core.samples import PowerSample
from autopilot.mavlink.api import (
    Circling,
    CommandReply,
    CommandResult,
    FlightMode,
    MotorTest,
    SetPoint,
    SigningState,
    VehicleView,
)
from autopilot.mavlink.server import MavlinkServer
from autopilot.mission.store import Change, plan_checksum
from tests.lossy_link import LinkConditions, LossyLink

TICK_US = 10_000
ORIGIN = GeodeticPosition(lat_deg=37.9755, lon_deg=23.7790, alt_m=12.0)
OK = CommandReply(result=CommandResult.ACCEPTED)
NAN = float("nan")
NOT_PACKAGED = ("UNKNOWN_300", "UNKNOWN_395", "UNKNOWN_397")
"""Messages of common.xml that pymavlink does not know."""


class MemoryPlans:
    """Plans in dictionaries. Command 9999 is not supported; ``veto`` refuses a whole plan."""

    def __init__(self) -> None:
        self.stored: dict[PlanKind, tuple[PlanItem, ...]] = dict.fromkeys(PlanKind, ())
        self.replaced: list[tuple[PlanKind, int]] = []
        self.veto: PlanRejection | None = None
        self.slow = False
        """Changes wait for :meth:`decide`."""
        self.waiting: list[Change] = []
        self.kept = True
        """Whether what is in force is on disk."""

    def items(self, kind: PlanKind) -> tuple[PlanItem, ...]:
        return self.stored[kind]

    def size_text(self) -> str:
        return ""

    def checksum(self, kind: PlanKind) -> int:
        return plan_checksum(self.stored[kind])

    def check_item(self, kind: PlanKind, item: PlanItem) -> PlanRejection | None:
        if item.command == 9999:
            return PlanRejection(
                seq=item.seq, result=MissionResult.UNSUPPORTED, reason=f"item {item.seq}: command 9999 is unknown"
            )
        if item.command == 16 and kind is PlanKind.MISSION and not -0x7FFF_FFFF < item.x < 900_000_000:
            return PlanRejection(
                seq=item.seq, result=MissionResult.INVALID_PARAM5_X, reason=f"item {item.seq}: latitude {item.x}"
            )
        return None

    def propose(self, plans: Mapping[PlanKind, tuple[PlanItem, ...]]) -> Change:
        change = Change(plans)
        if self.slow:
            self.waiting.append(change)
        else:
            self.decide(change)
        return change

    def decide(self, change: Change) -> None:
        """Take a change or refuse it."""
        if self.veto is None and not change.done:
            for kind, items in change.plans.items():
                self.stored[kind] = items
                self.replaced.append((kind, len(items)))
        change.end(self.veto)


class MemoryStore:
    """Signing key and time on a disk in memory."""

    def __init__(self, key: bytes | None, stamp: int = 0) -> None:
        self.state = SigningState(key, stamp)
        self.kept: list[SigningState] = []
        self.failure = ""
        self._told = 0

    def keep(self, tick: int, state: SigningState) -> None:
        self.kept.append(state)

    def poll(self, tick: int) -> Saved | None:
        if self._told == len(self.kept):
            return None
        self._told = len(self.kept)
        return Saved(number=self._told, failure=self.failure)


class RecordingVehicle:
    """Writes down every request; ``answers`` by name overrides "accepted"."""

    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.answers: dict[str, CommandReply] = {}
        self.on_set_current: Callable[[int], None] = lambda seq: None

    def _note(self, name: str, *args: Any) -> CommandReply:
        self.calls.append((name, *args))
        return self.answers.get(name, OK)

    def arm(self, force: bool) -> CommandReply:
        return self._note("arm", force)

    def disarm(self, force: bool) -> CommandReply:
        return self._note("disarm", force)

    def disarmed(self) -> CommandReply:
        return self.answers.get("disarmed", CommandReply(result=CommandResult.ACCEPTED))

    def set_mode(self, mode: FlightMode) -> CommandReply:
        return self._note("set_mode", mode)

    def start_mission(self, first_seq: int | None) -> CommandReply:
        return self._note("start_mission", first_seq)

    def pause(self) -> CommandReply:
        return self._note("pause")

    def resume(self) -> CommandReply:
        return self._note("resume")

    def set_current_item(self, seq: int, *, reset: bool = False) -> CommandReply:
        self.on_set_current(seq)
        return self._note("set_current_item", seq, *(["reset"] if reset else []))

    def go_to(self, point: GeodeticPosition | None, yaw_rad: float | None) -> CommandReply:
        return self._note("go_to", point, yaw_rad)

    def change_speed(self, speed_m_s: float | None) -> CommandReply:
        return self._note("change_speed", speed_m_s)

    def set_point(self, point: SetPoint) -> CommandReply:
        return self._note("set_point", point)

    def refuse_set_point(self, reason: str) -> CommandReply:
        self._note("refuse_set_point", reason)
        return CommandReply(result=CommandResult.DENIED, reason=f"Set point refused: {reason}")

    def orbit(self, circle: Circling) -> CommandReply:
        return self._note("orbit", circle)

    def test_motor(self, test: MotorTest) -> CommandReply:
        return self._note("test_motor", test)

    def change_depth(self, depth_m: float) -> CommandReply:
        return self._note("change_depth", depth_m)

    def take_off(self, depth_m: float | None, yaw_rad: float | None = None) -> CommandReply:
        return self._note("take_off", depth_m, yaw_rad)

    def set_home(self, point: GeodeticPosition | None) -> CommandReply:
        return self._note("set_home", point)

    def set_origin(self, point: GeodeticPosition) -> CommandReply:
        return self._note("set_origin", point)

    def end_run(self, end: RunEnd) -> CommandReply:
        return self._note("end_run", end)


def nav_state(t_us: int = 0, **changes: Any) -> NavState:
    """A submerged vehicle that heads east and drifts."""
    values: dict[str, Any] = {
        "t_us": t_us,
        "health": NavHealth.GOOD,
        "pos_ned_m": np.array([-1.6, -0.35, 0.45]),
        "rpy_rad": np.array([0.02, -0.03, np.pi / 2]),
        "vel_frd_m_s": np.array([0.3, 0.0, 0.1]),
        "vel_water_frd_m_s": np.array([0.3, 0.4, 0.0]),
        "rate_frd_rad_s": np.array([0.0, 0.0, 0.1]),
        "current_ned_m_s": np.array([0.1, -0.2, 0.0]),
        "variance": np.full(12, 1e-4),
    }
    return NavState(**{**values, **changes})


def base_view(**changes: Any) -> VehicleView:
    """What a healthy, armed vehicle on its mission shows."""
    values: dict[str, Any] = {
        "t_us": 0,
        "armed": True,
        "mode": FlightMode.MISSION,
        "intended_mode": FlightMode.MISSION,
        "nav": nav_state(),
        "power": PowerSample(t_us=0, voltage_v=23.5, current_a=4.0, energy_used_j=3600.0, remaining=0.8),
        "command": ThrusterCommand(
            t_us=0, thrust_n=np.array([6.0, 6.0, 3.0, 0.0, 0, 0, 0, 0]), pwm_us=(1600, 1600, 1550, 1500, 0, 0, 0, 0)
        ),
        "progress": MissionProgress(t_us=0, current_seq=1, reached_seq=0, lap=0, state=ProgressState.ACTIVE),
        "target_ned_m": np.array([1.75, 0.0, 0.30]),
        "origin": ORIGIN,
        "home": ORIGIN,
        "failsafes": 0,
        "cpu_load": 0.25,
        "under_way": True,
        "dropped_rx": 0,
    }
    return VehicleView(**{**values, **changes})


class World:
    """Server, plans, vehicle, clients and time."""

    def __init__(self, profile: str = "px4", links: tuple[int, ...] = (0,), **kwargs: Any) -> None:
        self.params = ParamSet()
        self.plans = MemoryPlans()
        self.vehicle = RecordingVehicle()
        self.view = base_view()
        self.t_us = 0
        self.clients: list[Client] = []
        self.server = MavlinkServer(
            sysid=1,
            profile=profile,
            params=self.params,
            plans=self.plans,
            vehicle=self.vehicle,
            version="0.1.0",
            git="0123456789abcdef",
            uid=0x1122334455667788,
            links=links,
            **kwargs,
        )

    def client(self, **kwargs: Any) -> "Client":
        """One more client."""
        client = Client(self, **kwargs)
        self.clients.append(client)
        return client

    def tick(self, events: tuple[Event, ...] = (), reached: tuple[int, ...] = ()) -> tuple[MavlinkFrame, ...]:
        """One step of 10 ms."""
        self.t_us += TICK_US
        rx = [frame for client in self.clients for frame in client.take_tx()]
        tx = self.server.step(self.t_us, rx, self.view, events, reached)
        for client in self.clients:
            client.deliver([frame.data for frame in tx if client.gets(frame)])
        return tx

    def run(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(round(seconds * 100)):
            self.tick()

    def show(self, **changes: Any) -> None:
        """Change what the vehicle shows."""
        self.view = replace(self.view, **changes)


def both_ways(seed: int, loss: float = 0.2, duplicate: float = 0.2, late_s: float = 0.02) -> dict[str, LossyLink]:
    """A bad link for :meth:`World.client`: half of the datagrams come ``late_s`` later than others."""
    bad = LinkConditions(loss=loss, duplicate=duplicate, reorder=0.5 if late_s else 0.0, reorder_s=late_s)
    return {"to_vehicle": LossyLink(bad, seed), "from_vehicle": LossyLink(bad, seed + 1000)}


class Client:
    """Speaks with pymavlink's own packing and parsing."""

    def __init__(
        self,
        world: World,
        link: int = 0,
        sysid: int = 255,
        compid: int = 190,
        to_vehicle: LossyLink | None = None,
        from_vehicle: LossyLink | None = None,
        number: int = 0,
    ) -> None:
        """``number``: which of those who share the link."""
        self.number = number
        self.world, self.link, self.sysid, self.compid = world, link, sysid, compid
        self._mav = mav.MAVLink(None, srcSystem=sysid, srcComponent=compid)
        self._parser = mav.MAVLink(None)
        self._parser.robust_parsing = True
        self._up, self._down = to_vehicle, from_vehicle
        self._tx: deque[bytes] = deque()
        self.rx: list[Any] = []
        self.on_message: Any = None

    def send(self, message: Any) -> bytes:
        """Queue a message for the next tick."""
        data = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        self._tx.append(data)
        return data

    def send_raw(self, data: bytes) -> None:
        """Queue bytes for the next tick."""
        self._tx.append(data)

    def take_tx(self) -> list[MavlinkFrame]:
        """What reaches the vehicle this tick."""
        out = self._passed(self._up, list(self._tx))
        self._tx.clear()
        return [MavlinkFrame(link=self.link, data=data, client=self.number) for data in out]

    def _passed(self, link: LossyLink | None, datagrams: list[bytes]) -> list[bytes]:
        """What comes out of a link this tick."""
        if link is None:
            return datagrams
        for data in datagrams:
            link.put(self.world.t_us, data)
        return link.take(self.world.t_us)

    def gets(self, frame: MavlinkFrame) -> bool:
        """Whether the link brings a frame to this client."""
        return frame.link == self.link and frame.client in (0, self.number) and self.number not in frame.beside

    def deliver(self, datagrams: list[bytes]) -> None:
        """What the vehicle sent this tick."""
        for data in self._passed(self._down, datagrams):
            for message in self._parser.parse_buffer(data) or []:
                assert message.get_msgId() >= 0 or message.get_type() in NOT_PACKAGED, message
                self.rx.append(message)
                if self.on_message is not None:
                    self.on_message(message)

    def got(self, name: str) -> list[Any]:
        """Messages of a type received so far."""
        return [m for m in self.rx if m.get_type() == name]

    def texts(self) -> str:
        """All STATUSTEXT joined."""
        return "\n".join(m.text for m in self.got("STATUSTEXT"))

    def ask(self, message: Any, name: str, seconds: float = 1.0) -> list[Any]:
        """Send, wait, and return what came of that type."""
        self.rx.clear()
        self.send(message)
        self.world.run(seconds)
        return self.got(name)

    def command(self, command: int, *params: float, confirmation: int = 0, **kwargs: float) -> Any:
        """COMMAND_LONG; the one COMMAND_ACK."""
        values = [*params, *[kwargs.pop("rest", 0.0)] * (7 - len(params))]
        self.rx.clear()
        self.send(mav.MAVLink_command_long_message(1, 1, command, confirmation, *values))
        self.world.run(0.05)
        acks = self.got("COMMAND_ACK")
        assert len(acks) == 1 and acks[0].command == command, acks
        assert (acks[0].target_system, acks[0].target_component) == (self.sysid, self.compid)
        return acks[0].result

    def command_int(self, command: int, frame: int, params: tuple[float, ...], x: int, y: int, z: float) -> Any:
        """COMMAND_INT; the one COMMAND_ACK's result."""
        self.rx.clear()
        self.send(mav.MAVLink_command_int_message(1, 1, frame, command, 0, 0, *params, x, y, z))
        self.world.run(0.05)
        acks = self.got("COMMAND_ACK")
        assert len(acks) == 1 and acks[0].command == command, acks
        return acks[0].result


def waypoint(seq: int, kind: int = 0, **changes: Any) -> Any:
    """A MISSION_ITEM_INT to the vehicle."""
    values: dict[str, Any] = {
        "target_system": 1,
        "target_component": 1,
        "seq": seq,
        "frame": 3,
        "command": 16 if kind == 0 else (5004 if kind == 1 else 5100),
        "current": int(seq == 0),
        "autocontinue": 1,
        "param1": 0.5,
        "param2": 0.3,
        "param3": 0.0,
        "param4": NAN,
        "x": 379_755_000 + 10 * seq,
        "y": 237_790_000 - 7 * seq,
        "z": -0.45,
        "mission_type": kind,
    }
    return mav.MAVLink_mission_item_int_message(**{**values, **changes})


class Uploader:
    """Uploads a plan as ground stations do: COUNT is repeated, items follow the vehicle's requests."""

    def __init__(self, client: Client, items: list[Any], kind: int = 0, retry_s: float = 1.5) -> None:
        self.client, self.items, self.kind = client, items, kind
        self.results: list[int] = []
        self.requests: list[int] = []
        self._retry_ticks = round(retry_s * 100)
        client.on_message = self._on

    def count(self) -> None:
        """Send MISSION_COUNT."""
        self.client.send(mav.MAVLink_mission_count_message(1, 1, len(self.items), self.kind))

    def _on(self, m: Any) -> None:
        if m.get_type() == "MISSION_REQUEST_INT" and m.mission_type == self.kind:
            self.requests.append(m.seq)
            if m.seq < len(self.items) and self.items[m.seq] is not None:
                self.client.send(self.items[m.seq])
        elif m.get_type() == "MISSION_ACK" and m.mission_type == self.kind:
            self.results.append(m.type)

    def run(self, seconds: float = 30.0) -> int | None:
        """Run to the answer; None when none came."""
        for n in range(round(seconds * 100)):
            if n % self._retry_ticks == 0 and not self.requests:
                self.count()
            self.client.world.tick()
            if self.results:
                return self.results[0]
        return None


def upload(client: Client, items: list[Any], kind: int = 0, seconds: float = 30.0) -> int | None:
    """Upload and return the MISSION_ACK result."""
    uploader = Uploader(client, items, kind)
    result = uploader.run(seconds)
    client.on_message = None
    return result


def download(client: Client, kind: int = 0, retry_s: float = 0.25, seconds: float = 60.0) -> list[Any] | None:
    """Download with retries, one item at a time."""
    client.rx.clear()
    items: list[Any] = []
    count: int | None = None
    ticks = round(retry_s * 100)
    for n in range(round(seconds * 100)):
        for m in client.rx:
            if m.get_type() == "MISSION_COUNT" and m.mission_type == kind and count is None:
                count, n_wait = m.count, 0
            elif m.get_type() == "MISSION_ITEM_INT" and m.mission_type == kind and m.seq == len(items):
                items.append(m)
                n_wait = 0
        client.rx.clear()
        if count is not None and len(items) == count:
            client.send(mav.MAVLink_mission_ack_message(1, 1, 0, kind))
            client.world.run(0.05)
            return items
        if n == 0 or n_wait == 0 or n_wait % ticks == 0:
            if count is None:
                client.send(mav.MAVLink_mission_request_list_message(1, 1, kind))
            else:
                client.send(mav.MAVLink_mission_request_int_message(1, 1, len(items), kind))
            if n == 0:
                n_wait = 0
        n_wait += 1
        client.world.tick()
    return None


FIELDS = ("seq", "frame", "command", "autocontinue", "param1", "param2", "param3", "x", "y", "z", "mission_type")


def same_items(sent: list[Any], got: list[Any]) -> bool:
    """Whether a download returns what was uploaded, bit for bit (as float32)."""
    if len(sent) != len(got):
        return False
    for a, b in zip(sent, got, strict=True):
        for name in FIELDS:
            x, y = getattr(a, name), getattr(b, name)
            if np.float32(x) != np.float32(y) if isinstance(x, float) else x != y:
                return False
        if not np.isclose(a.param4, b.param4, rtol=0, atol=1e-7, equal_nan=True):
            return False
    return True
