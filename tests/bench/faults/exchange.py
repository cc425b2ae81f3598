"""Figures of clients: parameters, answers in flight while a plan is uploaded, transfers over bad links, a slow line."""

import importlib.util
import itertools
import os
import pty
import random
import sys
import time
import tty

from pymavlink import mavutil
from pymavlink.dialects.v20 import development as mav

from autopilot.bench.live_service import LiveService, Station, live_service, waypoint
from autopilot.client.plan_client import PlanUpload
from autopilot.core.errors import AutopilotError
from autopilot.core.geodesy import Origin
from autopilot.core.messages import MavlinkFrame
from autopilot.core.params import ParamSet
from autopilot.core.plan import PlanKind
from autopilot.core.vehicle import load_vehicle
from autopilot.mavlink.server import MavlinkServer, blank_view
from autopilot.mavlink.wire import LinkParser
from autopilot.run.children import LOCAL
from tests.bench.faults.finding import Finding, Measured

TRANSFERS = 200
BAD = 0.3
"""Of the datagrams that are lost, of those that come twice, of those that come late."""
LATE_TICKS = 3
ITEMS = 500
ASK_S = 0.1
"""Between commands of which the answers are timed."""


def _parameters() -> Measured:
    """PARAM_REQUEST_LIST, until every index has come."""
    times = []
    with live_service() as service:
        station = Station.udp(service.udp)
        station.meet(service)
        for _ in range(3):
            begin_s, seen, count = time.perf_counter(), set[int](), 1
            station.send(mav.MAVLink_param_request_list_message(1, 1))
            while len(seen) < count and service.child.at_work():
                for message in station.receive(0.5):
                    if message.get_type() == "PARAM_VALUE" and message.param_index < message.param_count:
                        seen.add(message.param_index)
                        count = message.param_count
            times.append(time.perf_counter() - begin_s)
        station.close()
    text = f"{count} parameters in {', '.join(f'{s:.2f}' for s in times)} s"
    return Measured(text=text, kept=min(times) <= 0.3)


def _uploads(times_s: list[float], bar_s: float) -> Measured:
    shown = ", ".join(f"{seconds:.2f}" for seconds in times_s)
    return Measured(text=f"taken after {shown} s", kept=min(times_s) <= bar_s)


def by_pymavlink(service: LiveService, items: int) -> float:
    """An upload by pymavlink's own connection and a loop as scripts write it; the real time that it took [s]."""
    os.environ["MAVLINK20"] = "1"  # else pymavlink's connections speak MAVLink 1 only, and do not hear what follows
    link = mavutil.mavlink_connection(f"udpout:{LOCAL}:{service.udp}", source_system=255, dialect="development")
    asked, done = ["MISSION_REQUEST_INT", "MISSION_REQUEST"], "MISSION_ACK"
    try:
        Station.udp(service.udp, 254).meet(service)
        begin_s = time.perf_counter()
        link.mav.mission_count_send(1, 1, items, 0)
        while service.child.at_work():
            message = link.recv_match(type=[*asked, done], blocking=True, timeout=1.0)
            if message is None:
                continue
            if message.get_type() == done:
                if message.type != mav.MAV_MISSION_ACCEPTED:
                    raise AutopilotError(f"the upload was refused: MAV_MISSION_RESULT {message.type}")
                return time.perf_counter() - begin_s
            link.mav.send(waypoint(message.seq, items))
    finally:
        link.close()
    raise AutopilotError("no answer to an upload by pymavlink")


def by_mavsdk(service: LiveService, items: int, times: int) -> list[float]:
    """Uploads by MAVSDK's raw plugin; the real times that they took [s]."""
    import mavsdk
    from mavsdk.plugins.mission_raw import MissionItem, MissionRaw

    mavsdk.log_subscribe(lambda *_: True)
    rows = [waypoint(seq, items) for seq in range(items)]
    names = ["seq", "frame", "command", "current", "autocontinue", "param1", "param2", "param3", "param4"]
    names += ["x", "y", "z", "mission_type"]
    plan = [
        MissionItem(*(int(seq == 0) if n == "current" else getattr(row, n) for n in names))
        for seq, row in enumerate(rows)
    ]
    took_s = []
    component = mavsdk.ComponentType.GROUND_STATION
    with mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(component)) as sdk:
        sdk.add_any_connection(f"udpout://{LOCAL}:{service.udp}")
        while (system := sdk.first_autopilot(5.0)) is None:
            service.child.at_work()
        plugin = MissionRaw(system)
        for _ in range(times):
            begin_s = time.perf_counter()
            plugin.upload_mission(plan)
            took_s.append(time.perf_counter() - begin_s)
    return took_s


def _upload_pymavlink() -> Measured:
    with live_service() as service:
        return _uploads([by_pymavlink(service, ITEMS) for _ in range(3)], 1.0)


def _upload_mavsdk() -> Measured:
    with live_service() as service:
        return _uploads(by_mavsdk(service, ITEMS, 3), 0.9)


def _in_flight() -> Measured:
    """Commands of one client are timed while another uploads 500 items to a vehicle that flies."""
    waits: list[float] = []
    with live_service(scenario="paper-tank", arguments=("--start",)) as service:
        asker, loader = Station.udp(service.udp, 254), Station.udp(service.udp, 255)
        for station in (asker, loader):
            station.meet(service)
        asker.watch(10.0)
        asker.beats_s.clear()
        begin_s = asked_s = time.monotonic()
        loader.send(mav.MAVLink_mission_count_message(1, 1, ITEMS, 0))
        loader.socket.setblocking(False)
        sent_s: float | None = None
        taken_s: float | None = None
        while (taken_s is None or len(waits) < 50) and service.child.at_work():
            now_s = time.monotonic()
            if sent_s is None and now_s - asked_s >= (ASK_S if taken_s is not None else 0.01):
                asked_s = sent_s = now_s
                asker.send(mav.MAVLink_command_long_message(1, 1, 512, 0, 148.0, 0, 0, 0, 0, 0, 0))
            for message in asker.receive(0.001):
                if message.get_type() == "COMMAND_ACK" and sent_s is not None:
                    waits.append(time.monotonic() - sent_s)
                    sent_s = None
            for message in loader.receive(0.0001):
                if message.get_type() == "MISSION_REQUEST_INT":
                    loader.send(waypoint(message.seq, ITEMS))
                elif message.get_type() == "MISSION_ACK" and taken_s is None:
                    taken_s = time.monotonic() - begin_s
        gaps = [after - before for before, after in itertools.pairwise([begin_s, *asker.beats_s])]
        asker.close()
        loader.close()
    waits.sort()
    p99_s = waits[int(0.99 * (len(waits) - 1))]
    half_s, gap_s = waits[len(waits) // 2], max(gaps)
    text = (
        f"{ITEMS} items answered after {taken_s or 0.0:.1f} s; {len(waits)} answers, p50 {1e3 * half_s:.0f},"
        f" p99 {1e3 * p99_s:.0f} ms; longest gap between heartbeats {gap_s:.2f} s"
    )
    return Measured(text=text, kept=p99_s <= 0.05 and gap_s <= 1.2 and taken_s is not None)


class _BadWay:
    """One direction of a link: a datagram may be lost, come twice, or come late."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._late: list[tuple[int, bytes]] = []

    def carry(self, datagrams: list[bytes]) -> list[bytes]:
        """What comes out on this tick."""
        rng = self._rng
        for data in datagrams:
            if rng.random() >= BAD:
                for _ in range(2 if rng.random() < BAD else 1):
                    self._late.append((rng.randint(1, LATE_TICKS) if rng.random() < BAD else 0, data))
        out = [data for ticks, data in self._late if ticks <= 0]
        self._late = [(ticks - 1, data) for ticks, data in self._late if ticks > 0]
        return out


def transfers(count: int, items: int, seed: int) -> int:
    """How many uploads over a bad link are taken as they were sent: the service's server and plans, its own client."""
    from autopilot.command.commander import Commander
    from autopilot.core.plan import PlanItem
    from autopilot.mission.store import Plans

    params, vehicle = ParamSet(), load_vehicle("lbv150")
    plans = Plans(params, vehicle.radius_m, Origin(lat_deg=37.9755, lon_deg=23.7790, alt_m=0.0))
    commander = Commander(vehicle, params, plans)
    server = MavlinkServer(sysid=1, profile="px4", params=params, plans=plans, vehicle=commander, version="0.1.0")
    rng, codec, parser = random.Random(seed), mav.MAVLink(None, srcSystem=255, srcComponent=190), LinkParser()
    view, t_us, good = blank_view(), 0, 0
    up, down = _BadWay(rng), _BadWay(rng)
    for number in range(count):
        sent = [
            PlanItem(
                seq=n,
                command=16,
                frame=1,
                param2=0.3,
                x=rng.randint(-20_000, 20_000),
                y=rng.randint(-20_000, 20_000),
                z=0.5,
            )
            for n in range(items + number % 2)
        ]
        client = PlanUpload(PlanKind.MISSION, sent)
        pending = client.begin(t_us * 1e-6)
        while client.outcome is None:
            t_us += 10_000
            out = []
            for message in pending:
                out.append(bytes(message.pack(codec)))
                codec.seq = (codec.seq + 1) & 0xFF
            rx = [MavlinkFrame(link=0, data=data) for data in up.carry(out)]
            tx = server.step(t_us, rx, view)
            pending = client.tick(t_us * 1e-6)
            for data in down.carry([frame.data for frame in tx]):
                for message in parser.feed(data):
                    pending += client.handle(message, t_us * 1e-6)
        same = [(item.x, item.y) for item in plans.items(PlanKind.MISSION)] == [(item.x, item.y) for item in sent]
        good += client.outcome.accepted and same
    return good


def _bad_link() -> Measured:
    good = transfers(TRANSFERS, 20, 1)
    return Measured(text=f"{good} of {TRANSFERS} taken as sent", kept=good == TRANSFERS)


def _slow_line() -> Measured:
    """A pseudo terminal that is read at 57,600 baud; a greedy client, and its commands."""
    device, line = pty.openpty()
    tty.setraw(device)
    tty.setraw(line)
    os.set_blocking(device, False)
    codec, parser = mav.MAVLink(None, srcSystem=255, srcComponent=190), LinkParser()
    waits: list[float] = []
    beats: list[float] = []
    read = 0
    with live_service(f"{os.ttyname(line)}:57600") as service:
        Station.udp(service.udp).meet(service)

        def say(message: mav.MAVLink_message) -> None:
            os.write(device, message.pack(codec))
            codec.seq = (codec.seq + 1) & 0xFF

        try:
            while os.read(device, 4096):  # a line carries on while nobody listens, a pseudo terminal keeps it
                pass
        except BlockingIOError:
            pass
        say(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
        say(mav.MAVLink_request_data_stream_message(1, 1, 0, 50, 1))
        say(mav.MAVLink_param_request_list_message(1, 1))
        begin_s = time.monotonic()
        asked_s: float | None = None
        last_s = begin_s
        while (now_s := time.monotonic()) - begin_s < 15.0:
            if asked_s is None and now_s - last_s > 0.2:
                asked_s = last_s = now_s
                say(mav.MAVLink_command_long_message(1, 1, 512, 0, 148.0, 0, 0, 0, 0, 0, 0))
            room = int((now_s - begin_s) * 5760.0) - read
            if room > 0:
                try:
                    data = os.read(device, room)
                except BlockingIOError:
                    data, read = b"", int((now_s - begin_s) * 5760.0)
                read += len(data)
                for message in parser.feed(data):
                    if message.get_type() == "COMMAND_ACK" and asked_s is not None:
                        waits.append(time.monotonic() - asked_s)
                        asked_s = None
                    elif message.get_type() == "HEARTBEAT":
                        beats.append(time.monotonic())
            time.sleep(0.005)
    os.close(line)
    os.close(device)
    gap_s = max(after - before for before, after in itertools.pairwise(beats))
    waits.sort()
    p95_s = waits[int(0.95 * (len(waits) - 1))]
    text = (
        f"{len(waits)} answers, p95 {1e3 * p95_s:.0f}, slowest {1e3 * max(waits):.0f} ms;"
        f" longest gap between heartbeats {gap_s:.2f} s"
    )
    return Measured(text=text, kept=p95_s <= 0.25 and gap_s <= 1.2 and len(waits) > 20)


FINDINGS: tuple[Finding, ...] = (
    Finding(
        part="exchange",
        name="all parameters, real time",
        before="not measured",
        promise="<= 0.3 s",
        measure=_parameters,
    ),
    Finding(
        part="exchange",
        name=f"{ITEMS} items uploaded by pymavlink, real time",
        before="5.8 s",
        promise="<= 1.0 s",
        measure=_upload_pymavlink,
    ),
    *(
        ()
        if importlib.util.find_spec("mavsdk") is None
        else (
            Finding(
                part="exchange",
                name=f"{ITEMS} items uploaded by MAVSDK, real time",
                before="5.3 s",
                promise="<= 0.9 s",
                measure=_upload_mavsdk,
            ),
        )
    ),
    Finding(
        part="exchange",
        name=f"commands of one client while another uploads {ITEMS} items in flight, real time",
        before="not measured",
        promise="answers p99 <= 50 ms, heartbeats <= 1.2 s apart",
        measure=_in_flight,
    ),
    Finding(
        part="exchange",
        name=f"{TRANSFERS} uploads; {BAD:.0%} of the datagrams lost, {BAD:.0%} twice, {BAD:.0%} late, both ways",
        before="not measured",
        promise=f"{TRANSFERS} of {TRANSFERS} taken",
        measure=_bad_link,
    ),
    *(
        ()
        if sys.platform == "win32"
        else (
            Finding(
                part="exchange",
                name="a line of 57,600 baud, all streams at 50 Hz and the parameter list asked for",
                before="not measured",
                promise="answers p95 <= 250 ms, heartbeats <= 1.2 s apart",
                measure=_slow_line,
            ),
        )
    ),
)
