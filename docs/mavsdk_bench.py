"""A vehicle with MAVSDK beside it, for docs/mavsdk_table.py: tries a plugin's calls and waits for what they do.

A call has :data:`PATIENCE_S` of the vehicle's time; what has not come by then is "hangs", a stream that has brought
nothing is "silent". Where telemetry, a download or a file shows what a call does, that is waited for: "no effect" if it
does not come.
"""

import contextlib
import math
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeAlias

import mavsdk

PATIENCE_S = 40.0
STREAMS_S = 15.0
EFFECT_S = 20.0

Probe = tuple[str, Callable[[], Any]]
Probes: TypeAlias = Callable[["Bench"], Any]
"""Calls of a plugin, and streams that are listened to."""


class NoEffectError(Exception):
    """An acknowledged call that did nothing."""

    result = SimpleNamespace(name="no effect")


class PluginRow:
    """What became of one plugin's calls."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.works: list[str] = []
        self.refused: dict[str, list[str]] = {}
        """By outcome."""

    def markdown(self) -> str:
        """A line of the table."""
        refused = "; ".join(f"{outcome}: {', '.join(calls)}" for outcome, calls in self.refused.items())
        return f"| {self.name} | {', '.join(dict.fromkeys(self.works))} | {refused} |"

    def refuse(self, outcome: str, call: str) -> None:
        """A call that did not work."""
        self.refused.setdefault(outcome, []).append(call)


class Bench:
    """One vehicle, and the plugins that are tried on it."""

    def __init__(self, system: Any, folder: Path) -> None:
        self.system, self.folder = system, folder
        self._telemetry = self.plugin("telemetry")

    def ready(self) -> bool:
        """Whether MAVSDK takes the vehicle for one that is."""
        return bool(self._telemetry.health_all_ok())

    def in_mode(self, name: str) -> Callable[[], bool]:
        return lambda: self._telemetry.flight_mode().name == name

    def near(self, north_m: float, east_m: float) -> Callable[[], bool]:
        def arrived() -> bool:
            at = self._telemetry.position_velocity_ned().position
            return math.hypot(at.north_m - north_m, at.east_m - east_m) < 0.3

        return arrived

    def moves(self) -> bool:
        speed = self._telemetry.velocity_ned()
        return math.hypot(speed.north_m_s, speed.east_m_s) > 0.04

    def outputs(self) -> list[float]:
        """Pulses; of a disarmed vehicle only those of its equipment change."""
        return list(self._telemetry.actuator_output_status().actuator)

    def plugin(self, name: str) -> Any:
        module = import_module(f"mavsdk.plugins.{name}")
        return getattr(module, "".join(part.capitalize() for part in name.split("_")))(self.system)

    def row(self, name: str, probes: Probes | None) -> PluginRow:
        row = PluginRow(name)
        if probes is None:
            return row
        calls, streams = probes(self)
        for label, call in calls:
            self._try(row, label, call)
        self._listen(row, streams)
        return row

    def _try(self, row: PluginRow, label: str, call: Callable[[], Any]) -> None:
        outcome: list[str] = []

        def run() -> None:
            end_s = time.monotonic() + EFFECT_S
            while (found := outcome_of(call)) == "BUSY" and time.monotonic() < end_s:
                time.sleep(0.1)  # MAVSDK has not let go of the transfer before, of which it has told the end
            outcome.append(found)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        thread.join(PATIENCE_S)
        if not outcome:
            row.refuse("hangs", label)
        elif not outcome[0]:
            row.works.append(label)
        else:
            row.refuse(outcome[0], label)

    def _listen(self, row: PluginRow, streams: list[tuple[str, Callable[[Callable[..., None]], Any]]]) -> None:
        told: set[str] = set()
        for label, subscribe in streams:
            subscribe(lambda *args, label=label: told.add(label))
        end_s = time.monotonic() + STREAMS_S
        while time.monotonic() < end_s and len(told) < len(streams):
            time.sleep(0.1)
        for label, _ in streams:
            if label in told:
                row.works.append(label)
            else:
                row.refuse("silent", label)


def outcome_of(call: Callable[[], Any]) -> str:
    """Name of the result, "" = success."""
    try:
        value = call()
    except Exception as error:  # noqa: BLE001 - what a call raises is its outcome
        result = getattr(error, "result", None)
        return str(getattr(result, "name", f"{type(error).__name__}: {error}"[:60]))
    name = str(getattr(value, "name", "SUCCESS"))
    return "" if name in ("SUCCESS", "NEXT") else name


def seen(call: Callable[[], Any], effect: Callable[[], bool]) -> Callable[[], Any]:
    """A call, and what is to be seen of it."""

    def run() -> Any:
        value = call()
        end_s = time.monotonic() + EFFECT_S
        while not effect():
            if time.monotonic() > end_s:
                raise NoEffectError
            time.sleep(0.1)
        return value

    return run


def held(download: Callable[[], Any]) -> bool:
    """Whether the vehicle has a plan; MAVSDK fails to download none."""
    with contextlib.suppress(Exception):
        return bool(download())
    return False


def changing(call: Callable[[], Any], read: Callable[[], Any]) -> Callable[[], Any]:
    """A call that changes what is read."""

    def run() -> Any:
        before = read()
        return seen(call, lambda: read() != before)()

    return run


def started(begin: Callable[[Callable[..., None]], Any]) -> Callable[[], Any]:
    """A call whose outcome comes by a callback: the last result."""

    def run() -> Any:
        done, last = threading.Event(), []

        def told(result: Any, *rest: Any) -> None:
            if result.name not in ("NEXT", "IN_PROGRESS"):
                last.append(result)
                done.set()

        begin(told)
        if not done.wait(PATIENCE_S - 2.0):
            raise TimeoutError("no outcome")
        return last[0]

    return run


@contextlib.contextmanager
def bench_on_a_vehicle(sensors: str) -> Iterator[Bench]:
    """The service in SITL with a camera or with poses, and MAVSDK beside it."""
    from autopilot.bench.live_service import live_service

    mavsdk.log_subscribe(lambda *args: True)
    # In the middle of the tank, where everything that is tried has room; disarmed, it drifts against a wall in the end.
    with (
        tempfile.TemporaryDirectory() as folder,
        live_service(
            scenario="paper-tank", arguments=("--param", "FENCE_REQUIRED=0", "--sensors", sensors), ends=(0, 3)
        ) as service,
    ):
        configuration = mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION)
        with mavsdk.Mavsdk(configuration) as sdk:
            sdk.add_any_connection(f"udpout://127.0.0.1:{service.udp}")
            while (system := sdk.first_autopilot(5.0)) is None:
                service.child.at_work()
            bench = Bench(system, Path(folder))
            while not bench.ready():
                service.child.at_work()
                time.sleep(0.2)
            yield bench
