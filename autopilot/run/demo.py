"""The demo: the paper's mission in the simulated tank, with the jet and without.

The service runs in a child process and this one is its client: it uploads the plan over MAVLink, arms, starts,
monitors the laps and then evaluates the log against the ground truth.
"""

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from autopilot.client.client_session import CommandRefusedError, MissionStatus, VehicleConnection
from autopilot.core.errors import AutopilotError, ConfigError
from autopilot.core.messages import ProgressState
from autopilot.core.plan import PlanKind
from autopilot.log.check import BoundRow, BoundVerdict, acceptance_table
from autopilot.log.figures import write_figures
from autopilot.log.reader import open_log
from autopilot.log.report import write_report
from autopilot.mission.paper import paper_plan
from autopilot.mission.plan_files import write_plan
from autopilot.mission.plan_model import PlanFile
from autopilot.run.children import Child, autopilot_command, free_port

FLIGHTS = (("paper-tank", ""), ("paper-tank-still", "still"))
"""Scenario and sub-folder of each flight: jet of 0.25 m/s, still water."""

READY_S = 60.0
"""Vehicle time in which it has to find its position."""

LAP_S = 200.0
"""Vehicle time allowed per lap, and to the first waypoint: five times the usual."""

SILENCE_S = 10.0
"""Silence of a service that is not at work."""

Show = Callable[[str, int, int], None]
"""Called with what is going on, waypoints reached, waypoints in all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightResult:
    scenario: str
    log: Path
    report: Path
    figures: tuple[Path, ...]
    rows: tuple[BoundRow, ...]
    wall_s: float

    @property
    def passed(self) -> bool:
        return all(row.verdict is not BoundVerdict.FAIL for row in self.rows)


def fly(scenario: str, folder: Path, *, laps: int, speed: float, seed: int | None, show: Show) -> FlightResult:
    """One flight: service, client, log, verdict. AutopilotError if it cannot be flown."""
    begin_s = time.monotonic()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be made ({error.strerror}); choose another folder with --out") from error
    log = folder / "run.mcap"
    plan = paper_plan(laps)
    write_plan(folder / "paper.plan", plan)
    port = free_port()
    with (
        _service(scenario, log, port, folder, speed=speed, seed=seed) as service,
        VehicleConnection(f"udpout:127.0.0.1:{port}", at_work=service.at_work) as session,
    ):
        show("waiting for the vehicle", 0, 1 + 2 * laps)
        session.connect(SILENCE_S)
        _operate(session, plan, laps=laps, show=show)
    show("drawing figures and report", 0, 0)
    opened = open_log(log)
    figures = write_figures(opened, folder)
    report = folder / "report.html"
    write_report(opened, report)
    return FlightResult(
        scenario=scenario,
        log=log,
        report=report,
        figures=tuple(figures),
        rows=tuple(acceptance_table(opened)),
        wall_s=time.monotonic() - begin_s,
    )


def _operate(session: VehicleConnection, plan: PlanFile, *, laps: int, show: Show) -> None:
    """The operator's sequence: upload, arm, start, monitor, disarm."""
    total = 1 + 2 * laps
    for kind in (PlanKind.FENCE, PlanKind.MISSION):
        show(f"uploading {kind.name.lower()}", 0, total)
        session.upload(kind, plan.items(kind))
    show("arming", 0, total)
    _arm(session)
    session.start_mission()

    def on_status(status: MissionStatus) -> None:
        if status.state is not ProgressState.UNKNOWN:  # mission state not received yet
            show(f"mission {status.state.name.lower().replace('_', ' ')}", min(len(status.reached), total), total)

    status = session.watch_mission(on_status, timeout_s=LAP_S * (1 + laps), silence_s=SILENCE_S)
    if status.state is not ProgressState.COMPLETE:
        raise AutopilotError(f"the mission ended as {status.state.name}; look at /rosout in the log")
    session.disarm()


def _arm(session: VehicleConnection) -> None:
    """Arm as soon as the vehicle has a position."""
    end_s = session.vehicle_s + READY_S
    while True:
        try:
            session.arm()
        except CommandRefusedError:
            if session.vehicle_s > end_s:
                raise
            session.poll(0.2)
        else:
            return


@contextlib.contextmanager
def _service(scenario: str, log: Path, port: int, folder: Path, *, speed: float, seed: int | None) -> Iterator[Child]:
    """The service as its own process, ended by SIGTERM."""
    command = autopilot_command(
        *("sitl", scenario, "--quiet", "--speed", f"{speed:g}", "--log", str(log)),
        *("--connect", f"udpin:127.0.0.1:{port}"),
        *(() if seed is None else ("--seed", str(seed))),
    )
    # Parameters of an earlier demo are not those of this one.
    (folder / "state" / "sitl-0" / "parameters.params").unlink(missing_ok=True)
    service = Child(command, {"AUTOPILOT_STATE_DIR": str(folder / "state")})
    try:
        yield service
    finally:
        service.end()
