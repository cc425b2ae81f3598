"""Figures of clients in real time: parameters, uploads, answers in flight while a plan is uploaded."""

import importlib.util
import itertools
import os
import time

from pymavlink import mavutil
from pymavlink.dialects.v20 import development as mav

from autopilot.bench.live_service import LiveService, Station, live_service, waypoint
from autopilot.core.errors import AutopilotError
from autopilot.run.children import LOCAL
from tests.bench.faults.finding import Finding, Measured

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
    requests, done = ["MISSION_REQUEST_INT", "MISSION_REQUEST"], "MISSION_ACK"
    try:
        Station.udp(service.udp, 254).meet(service)
        begin_s = time.perf_counter()
        link.mav.mission_count_send(1, 1, items, 0)
        while service.child.at_work():
            message = link.recv_match(type=[*requests, done], blocking=True, timeout=1.0)
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
    spent_s = []
    component = mavsdk.ComponentType.GROUND_STATION
    with mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(component)) as sdk:
        sdk.add_any_connection(f"udpout://{LOCAL}:{service.udp}")
        while (system := sdk.first_autopilot(5.0)) is None:
            service.child.at_work()
        plugin = MissionRaw(system)
        for _ in range(times):
            begin_s = time.perf_counter()
            plugin.upload_mission(plan)
            spent_s.append(time.perf_counter() - begin_s)
    return spent_s


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
        begin_s = requested_s = time.monotonic()
        loader.send(mav.MAVLink_mission_count_message(1, 1, ITEMS, 0))
        loader.socket.setblocking(False)
        sent_s: float | None = None
        taken_s: float | None = None
        while (taken_s is None or len(waits) < 50) and service.child.at_work():
            now_s = time.monotonic()
            if sent_s is None and now_s - requested_s >= (ASK_S if taken_s is not None else 0.01):
                requested_s = sent_s = now_s
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


EXCHANGES: tuple[Finding, ...] = (
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
)
