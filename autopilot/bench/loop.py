"""Cost of the loop's ticks in real time with a camera, while a client uploads 500 items and 50 octagons in flight.

The service runs in this process, so that its ticks can be measured; the client is a child process. CPU times are of
the loop's thread alone: background work shows in wall time only.
"""

import itertools
import json
import math
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import development as mav

from autopilot.bench.live_service import Station
from autopilot.bench.sitl_row import PartTimes
from autopilot.core.errors import AutopilotError
from autopilot.core.marks import LoopPart
from autopilot.core.messages import Outputs
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.core.plan_wire import item_message
from autopilot.mavlink.vehicle_commands import FORCE_ARM
from autopilot.mission.local_plan import FenceTable, LocalPlan, OriginTable, PolygonTable, WaypointTable, plan_of_local
from autopilot.mission.paper import ORIGIN
from autopilot.run.children import LOCAL, free_port, python_command
from autopilot.run.config import gather, sitl_defaults
from autopilot.run.sitl_session import SitlSession, open_sitl

ITEMS = 500
OCTAGONS = 50
P99_CPU_MS, MAX_CPU_MS, GAP_S, P99_LOG_MS = 10.0, 50.0, 1.2, 0.3
"""Requirements."""
QUIET_S = 3.0
"""Before, between and after the uploads."""
PATIENCE_S = 120.0
"""Vehicle time after which the flight ends whatever the client does."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopRow:
    what: str
    value: float
    unit: str
    asked: float | None
    """At most; None = nothing is asked for."""
    note: str = ""

    @property
    def kept(self) -> bool:
        return self.asked is None or self.value <= self.asked


def plans() -> tuple[tuple[PlanItem, ...], tuple[PlanItem, ...]]:
    """A mission of 500 items within the tank, and a fence of 50 octagons round it."""
    rng = np.random.default_rng(5)
    centers: list[tuple[float, float]] = []
    while len(centers) < OCTAGONS:
        x, y = (float(v) for v in rng.uniform(-16.0, 16.0, 2))
        if math.hypot(x, y) > 5.0 and all(math.hypot(x - a, y - b) > 3.2 for a, b in centers):
            centers.append((x, y))
    turns = [2.0 * math.pi * k / 8 for k in range(8)]
    octagons = [
        PolygonTable(points_m=[(x + math.cos(a), y + math.sin(a)) for a in turns], inclusion=False) for x, y in centers
    ]
    square = PolygonTable(points_m=[(-18.0, -18.0), (18.0, -18.0), (18.0, 18.0), (-18.0, 18.0)], inclusion=True)
    angles = [2.0 * math.pi * k / ITEMS for k in range(ITEMS)]
    plan = plan_of_local(
        LocalPlan(
            origin=OriginTable(lat_deg=ORIGIN.lat_deg, lon_deg=ORIGIN.lon_deg),
            waypoint=[WaypointTable(x_m=math.cos(a), y_m=math.sin(a), depth_m=0.45) for a in angles],
            fence=FenceTable(polygon=[square, *octagons]),
        )
    )
    return plan.mission, plan.fence


def bench_loop() -> list[LoopRow]:
    """One flight of about half a minute."""
    with tempfile.TemporaryDirectory(prefix="autopilot-") as folder:
        port = free_port()
        settings = gather(sitl_defaults(0), {"speed": 1.0, "sensors": "camera", "duration": PATIENCE_S}, {})
        given = {"connect": (f"udpin:{LOCAL}:{port}",), "state_dir": folder, "log": str(Path(folder) / "run.mcap")}
        for name, value in given.items():
            settings.put(name, value, "benchmark")
        session = open_sitl(settings, {})
        times = PartTimes()
        cpu_s, parts = _measure(session, times)
        code = f"from autopilot.bench.loop import client; client({port})"
        child = subprocess.Popen(python_command(code), stdout=subprocess.PIPE, text=True)
        process_s, begin_s = time.process_time(), time.perf_counter()
        try:
            session.run(stop=lambda: child.poll() is not None)
        finally:
            share = (time.process_time() - process_s) / (time.perf_counter() - begin_s)
            child.kill()
            text, _ = child.communicate()
    if not text.strip():
        raise AutopilotError("the client did not end: the service was too slow, or refused its plans")
    measured = json.loads(text)
    return _rows(session, np.array(cpu_s), parts, measured) + _mean_rows(np.array(cpu_s), times, share)


def _measure(session: SitlSession, times: PartTimes) -> tuple[list[float], list[tuple[float, tuple[float, ...]]]]:
    """CPU time of every tick [s], and of its stages."""
    cpu_s: list[float] = []
    parts: list[tuple[float, tuple[float, ...]]] = []
    runtime = session.runtime
    whole: Callable[[int], Outputs] = runtime.tick

    def timed(t_us: int) -> Outputs:
        begin_s = time.thread_time()
        outputs = whole(t_us)
        cpu_s.append(time.thread_time() - begin_s)
        parts.append((cpu_s[-1], tuple(runtime.watch.part_cpu_s)))
        times.add(runtime.watch.part_cpu_s)
        return outputs

    setattr(runtime, "tick", timed)  # noqa: B010 - a method, which cannot be assigned
    return cpu_s, parts


def _rows(
    session: SitlSession,
    cpu_s: np.ndarray,
    parts: Sequence[tuple[float, tuple[float, ...]]],
    measured: dict[str, float],
) -> list[LoopRow]:
    cpu_ms = 1e3 * cpu_s
    log_ms = [1e3 * each[LoopPart.RECORD] for _, each in parts]
    _, slowest = max(parts, key=lambda each: each[0])
    part = LoopPart(max(range(len(slowest)), key=slowest.__getitem__))
    note = f"{1e3 * slowest[part]:.1f} ms of it {part.name.lower()}"
    counters = session.runtime.counters
    return [
        LoopRow(what="tick CPU p50", value=float(np.percentile(cpu_ms, 50.0)), unit="ms", asked=None),
        LoopRow(what="tick CPU p99", value=float(np.percentile(cpu_ms, 99.0)), unit="ms", asked=P99_CPU_MS),
        LoopRow(what="tick CPU max", value=float(cpu_ms.max()), unit="ms", asked=MAX_CPU_MS, note=note),
        LoopRow(what="log CPU p50", value=float(np.percentile(log_ms, 50.0)), unit="ms", asked=None, note="of a tick"),
        LoopRow(
            what="log CPU p99", value=float(np.percentile(log_ms, 99.0)), unit="ms", asked=P99_LOG_MS, note="of a tick"
        ),
        LoopRow(what="longest tick, wall", value=1e3 * counters.worst_tick_s, unit="ms", asked=None),
        LoopRow(what="late ticks", value=counters.overruns, unit=f"of {counters.ticks}", asked=None),
        LoopRow(
            what="longest heartbeat gap", value=measured["gap_s"], unit="s", asked=GAP_S, note="as the client saw it"
        ),
        LoopRow(what=f"upload of {ITEMS} items", value=measured["mission_s"], unit="s", asked=None),
        LoopRow(what=f"upload of {OCTAGONS} octagons", value=measured["fence_s"], unit="s", asked=None),
        LoopRow(what="refused uploads", value=measured["refused"], unit="", asked=0.0),
    ]


def _mean_rows(cpu_s: np.ndarray, times: PartTimes, share: float) -> list[LoopRow]:
    """Load of the process, and the mean tick with its stages."""
    note = "of a core; plant, renderer and detection included"
    return [
        LoopRow(what="CPU, all threads", value=100.0 * share, unit="%", asked=None, note=note),
        LoopRow(what="tick CPU mean", value=1e3 * float(cpu_s.mean()), unit="ms", asked=None),
        *(
            LoopRow(what=f"of it {part.name.lower()}", value=ms, unit="ms", asked=None)
            for part, ms in times.mean_ms.items()
        ),
    ]


# The client, in its own process.


def client(port: int) -> None:
    """Arm, upload, listen; prints its observations as JSON."""
    mission, fence = plans()
    end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end.connect((LOCAL, port))
    station = Station(end)
    while not station.beats_s:
        station.beat()
        station.receive(0.2)
    _arm(station)
    begin = len(station.beats_s) - 1
    station_watch(station, QUIET_S)
    refused, mission_s = _upload(station, PlanKind.MISSION, mission)
    station_watch(station, QUIET_S)
    more_refused, fence_s = _upload(station, PlanKind.FENCE, fence)
    station_watch(station, QUIET_S)
    gap_s = max(after - before for before, after in itertools.pairwise([*station.beats_s[begin:], time.monotonic()]))
    found = {"gap_s": gap_s, "mission_s": mission_s, "fence_s": fence_s, "refused": refused + more_refused}
    json.dump(found, sys.stdout)
    for text in station.texts:
        print(text, file=sys.stderr)


def station_watch(station: Station, seconds: float) -> None:
    """Listen for a while and record heartbeat times."""
    begin_s = time.monotonic()
    while time.monotonic() - begin_s < seconds:
        station.receive(0.02)


def _arm(station: Station) -> None:
    """Until the vehicle is armed; by force when its checks take long."""
    begin_s = sent_s = time.monotonic()
    while True:
        for message in station.receive(0.05):
            armed = message.get_type() == "HEARTBEAT" and message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED
            if armed:
                return
        now_s = time.monotonic()
        if now_s - sent_s > 1.0:
            sent_s = now_s
            force = FORCE_ARM if now_s - begin_s > 20.0 else 0.0
            arm = mav.MAV_CMD_COMPONENT_ARM_DISARM
            station.send(mav.MAVLink_command_long_message(1, 1, arm, 0, 1.0, force, 0, 0, 0, 0, 0))


def _upload(station: Station, kind: PlanKind, items: Sequence[PlanItem]) -> tuple[int, float]:
    """Whether it was refused, and how long it took [s]."""
    begin_s, sent_s, begun = time.monotonic(), 0.0, False
    while True:
        now_s = time.monotonic()
        if not begun and now_s - sent_s > 1.0:
            sent_s = now_s
            station.send(mav.MAVLink_mission_count_message(1, 1, len(items), kind))
        for message in station.receive(0.05):
            if getattr(message, "mission_type", None) != kind:
                continue
            if message.get_type() in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
                begun = True
                station.send(item_message(items[message.seq], kind))
            elif message.get_type() == "MISSION_ACK" and begun:
                return int(message.type != 0), time.monotonic() - begin_s
