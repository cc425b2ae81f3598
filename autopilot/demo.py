"""The main job, no questions asked: the paper's mission, flown in the simulated tank with the jet and without.

The service runs as a process of its own and this one is its client: it uploads the plan over MAVLink, arms, starts,
watches the laps and then judges the log by the plant's truth.
"""

import contextlib
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from autopilot.client.session import CommandRefusedError, MissionStatus, Session
from autopilot.core.errors import AutopilotError, ConfigError, DriverError
from autopilot.core.messages import ProgressState
from autopilot.core.plan import PlanKind
from autopilot.log.check import Row, Verdict, acceptance_table
from autopilot.log.figures import write_figures
from autopilot.log.reader import open_log
from autopilot.log.report import write_report
from mission.paper import paper_plan
from mission.plan_files import write_plan
from mission.plan_model import PlanFile

FLIGHTS = (("paper-tank", ""), ("paper-tank-still", "still"))
"""Scenario and sub-folder of each flight: jet of 0.25 m/s, still water."""

START_TIMEOUT_S = 60.0
"""Wall time that the service gets to speak and to find its position."""

FLIGHT_TIMEOUT_S = 420.0
"""Wall time that one flight may take."""

Show = Callable[[str, int, int], None]
"""Called with what is going on, waypoints reached, waypoints in all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightResult:
    """One flight and its verdict."""

    scenario: str
    log: Path
    report: Path
    figures: tuple[Path, ...]
    rows: tuple[Row, ...]
    wall_s: float

    @property
    def passed(self) -> bool:
        """No bound is broken."""
        return all(row.verdict is not Verdict.FAIL for row in self.rows)


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
    port = _free_port()
    with (
        _service(scenario, log, port, folder, speed=speed, seed=seed) as service,
        Session(f"udpout:127.0.0.1:{port}") as session,
    ):
        show("waiting for the vehicle", 0, 1 + 2 * laps)
        _connect(session, service)
        _operate(session, plan, total=1 + 2 * laps, show=show)
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


def _connect(session: Session, service: subprocess.Popen[bytes]) -> None:
    """Wait for the vehicle's heartbeat for as long as the service lives."""
    end_s = time.monotonic() + START_TIMEOUT_S
    while True:
        try:
            session.connect(1.0)
        except DriverError:
            code = service.poll()
            if code is not None:
                raise AutopilotError(f"the service ended with exit code {code}; its message is above") from None
            if time.monotonic() > end_s:
                raise
        else:
            return


def _operate(session: Session, plan: PlanFile, *, total: int, show: Show) -> None:
    """What an operator does: upload, arm, start, watch, disarm."""
    for kind in (PlanKind.FENCE, PlanKind.MISSION):
        show(f"uploading {kind.name.lower()}", 0, total)
        session.upload(kind, plan.items(kind))
    show("arming", 0, total)
    _arm(session)
    session.start_mission()

    def on_status(status: MissionStatus) -> None:
        show(f"mission {status.state.name.lower()}", min(len(status.reached), total), total)

    status = session.watch_mission(on_status, timeout_s=FLIGHT_TIMEOUT_S)
    if status.state is not ProgressState.COMPLETE:
        raise AutopilotError(f"the mission ended as {status.state.name}; look at /rosout in the log")
    session.disarm()


def _arm(session: Session) -> None:
    """Arm as soon as the vehicle knows where it is."""
    end_s = time.monotonic() + START_TIMEOUT_S
    while True:
        try:
            session.arm()
        except CommandRefusedError:
            if time.monotonic() > end_s:
                raise
            time.sleep(0.2)
        else:
            return


@contextlib.contextmanager
def _service(
    scenario: str, log: Path, port: int, folder: Path, *, speed: float, seed: int | None
) -> Iterator[subprocess.Popen[bytes]]:
    """The service as its own process, ended by SIGTERM."""
    command = [
        *(sys.executable, "-m", "autopilot", "sitl", scenario, "--quiet", "--speed", f"{speed:g}"),
        *("--log", str(log), "--connect", f"udpin:127.0.0.1:{port}", "--param", "MPC_COST=1"),
    ]
    if seed is not None:
        command += ["--seed", str(seed)]
    environment = {**os.environ, "AUTOPILOT_STATE_DIR": str(folder / "state")}
    # Parameters of an earlier demo are not those of this one.
    (folder / "state" / "sitl-0" / "parameters.params").unlink(missing_ok=True)
    process = subprocess.Popen(command, env=environment)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
        try:
            process.wait(timeout=START_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _free_port() -> int:
    """A UDP port that nobody uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
