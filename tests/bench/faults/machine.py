"""Busy machines, foreign folders, and what operators are told."""

import os
import signal
import socket
import subprocess
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from autopilot.client.client_session import VehicleConnection
from autopilot.client.exchange import Timers
from autopilot.core.errors import AutopilotError
from autopilot.core.plan import PlanKind
from autopilot.mission.paper import paper_plan
from autopilot.run.children import ROOT, Child, autopilot_command
from autopilot.run.provenance import revision_of
from tests.bench.faults.finding import Finding, Measured

PART = "machine"
NOBODY = "udpout:127.0.0.1:9"
START_CPU_S = 1.0
HELD_S = 12.0
"""Longer than clients once waited."""
CHARS = 50
"""What a STATUSTEXT takes without being cut in pieces."""

PILLAR = '\n[[obstacle]]\nkind = "cylinder"\ncenter_m = [-1.6, 0.25]\nradius_m = 0.1\n'
PILLAR_PLAN = """
[origin]
lat_deg = 37.9755
lon_deg = 23.7790

[[waypoint]]
x_m = -1.6
y_m = 0.3
depth_m = 0.45

[[fence.polygon]]
points_m = [[-2.5, -1.5], [2.5, -1.5], [2.5, 1.5], [-2.5, 1.5]]
inclusion = true
"""


@contextmanager
def _folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="autopilot-") as name:
        yield Path(name)


def _command(folder: Path, *more: str, connect: str = NOBODY) -> list[str]:
    """A service with noisy poses that leaves everything in that folder."""
    log = str(folder / "run.mcap")
    return autopilot_command("sitl", *more, "--sensors", "pose", "--connect", connect, "--log", log)


def _run(folder: Path, *more: str, cwd: Path | None = None) -> "subprocess.CompletedProcess[str]":
    environment = {**os.environ, "AUTOPILOT_STATE_DIR": str(folder / "state")}
    command = _command(folder, *more, "--speed", "0")
    return subprocess.run(command, env=environment, cwd=cwd, capture_output=True, text=True, check=False)


def _start() -> Measured:
    """CPU time of the process when its first datagram arrives."""
    with _folder() as folder, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(0.1)
        connect = f"udpout:127.0.0.1:{ear.getsockname()[1]}"
        child = Child(_command(folder, "--quiet", connect=connect), {"AUTOPILOT_STATE_DIR": str(folder)})
        try:
            while child.at_work():
                try:
                    ear.recv(4096)
                    break
                except TimeoutError:
                    continue
            cpu_s = child.cpu_s() or float("inf")
        finally:
            child.end()
    return Measured(text=f"{cpu_s:.2f} s of CPU time", kept=cpu_s <= START_CPU_S)


def _held() -> Measured:
    """A service that gets no processor at all for a while, as on a machine that is busy, while a plan is sent."""
    with _folder() as folder, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
        probe.close()
        child = Child(
            _command(folder, "--quiet", connect=f"udpin:127.0.0.1:{port}"), {"AUTOPILOT_STATE_DIR": str(folder)}
        )
        try:
            with VehicleConnection(f"udpout:127.0.0.1:{port}", Timers(), at_work=child.at_work) as session:
                session.connect()
                child.process.send_signal(signal.SIGSTOP)
                waker = threading.Timer(HELD_S, child.process.send_signal, (signal.SIGCONT,))
                waker.start()
                begin_s = time.monotonic()
                try:
                    session.upload(PlanKind.FENCE, paper_plan().fence)
                    said = f"taken after {time.monotonic() - begin_s:.0f} s"
                    kept = True
                except AutopilotError as error:
                    said, kept = str(error), False
                waker.join()
        finally:
            child.process.send_signal(signal.SIGCONT)
            child.end()
    return Measured(text=said, kept=kept)


def _foreign_modules() -> Measured:
    """A service started in a folder with modules of our packages' names."""
    with _folder() as folder:
        here = folder / "project"
        here.mkdir()
        for name in ("mission", "drivers", "sitl", "estimator", "autopilot"):
            (here / f"{name}.py").write_text("raise SystemExit('imported from the current folder')\n")
        done = _run(folder, "--duration", "0.05", "--quiet", cwd=here)
    said = "runs" if done.returncode == 0 else done.stderr.strip().splitlines()[-1]
    return Measured(text=said, kept=done.returncode == 0)


def _foreign_repository() -> Measured:
    """A package that lies in somebody's repository."""
    with _folder() as folder:
        site = folder / ".venv/lib/site-packages"
        (site / "autopilot").mkdir(parents=True)
        (folder / "theirs.txt").write_text("theirs")
        who = ("-c", "user.name=somebody", "-c", "user.email=somebody@example.org")
        for arguments in (("init", "-q"), ("add", "theirs.txt"), ("commit", "-q", "-m", "theirs")):
            subprocess.run(["git", "-C", str(folder), *who, *arguments], check=True, capture_output=True)
        found = revision_of(site)
    return Measured(text=f"revision {found!r}", kept=found == "")


def _console() -> Measured:
    """A pillar that the fence does not have stands on the way."""
    tank = (ROOT / "sitl" / "scenarios" / "paper-tank.toml").read_text(encoding="utf-8")
    with _folder() as folder:
        scenario, plan = folder / "pillar.toml", folder / "plan.toml"
        scenario.write_text(tank.replace('plan = "paper.plan"\n', "") + PILLAR)
        plan.write_text(PILLAR_PLAN)
        done = _run(folder, str(scenario), "--plan", str(plan), "--start", "--duration", "12")
    lines = done.stdout.splitlines()
    warned = sum("is not in the fence" in line for line in lines)
    closing = lines[-1].rpartition(", ")[2] if lines else "nothing"
    shown = [word for word in ("Armed", "Mode MISSION", "Contact 1") if any(word in line for line in lines)]
    return Measured(
        text=f"{warned} obstacles named; {', '.join(shown)}; at the end {closing}; exit code {done.returncode}",
        kept=warned > 0 and len(shown) == 3 and done.returncode == 3,
    )


def _texts() -> Measured:
    """STATUSTEXTs of the first lap of the paper's mission, with a client that asks for the impossible ten times."""
    from autopilot.run.config import flight_settings
    from autopilot.run.sitl_session import open_sitl
    from tests.bench.faults.pilot import Pilot

    given = {"scenario": "paper-tank", "speed": 0.0, "start": True, "sensors": "pose"}
    with _folder() as folder:
        settings = flight_settings(folder, given)
        pilot = Pilot()
        session = open_sitl(settings, {}, log=False, peers=(pilot,))
        try:
            for tick in range(1, 3001):
                if tick in range(2000, 2400, 40):
                    pilot.command(176, 1.0, 99.0, 9.0)  # DO_SET_MODE to a mode that does not exist
                session.runtime.tick(tick * 10_000)
        finally:
            session.close()
    messages = [message for message in pilot.heard if message.get_type() == "STATUSTEXT"]
    pieces = sum(message.id != 0 for message in messages)
    figures = sum("alpha" in message.text for message in messages)
    counts = Counter(message.text for message in messages if "no mode" in message.text)
    repeats = max(counts.values(), default=0)
    return Measured(
        text=f"{len(messages)} texts, {figures} of certificates, {pieces} pieces of texts beyond {CHARS} characters; "
        f"ten same refusals in 4 s said {repeats} times",
        kept=figures == 0 and repeats == 1,
    )


FINDINGS: tuple[Finding, ...] = (
    Finding(
        part=PART,
        name="start of `autopilot sitl` to the first HEARTBEAT",
        before="1.6 to 2.2 s of CPU time, links opened last",
        promise="1 s of CPU time",
        measure=_start,
    ),
    Finding(
        part=PART,
        name=f"the service gets no processor for {HELD_S:.0f} s while a fence is sent (demo beside ten busy processes)",
        before='"silent for 10 s": the demo failed in two of three tries',
        promise="clients wait while the process lives",
        measure=_held,
    ),
    Finding(
        part=PART,
        name="a service is started in a folder with a mission.py, drivers.py, sitl.py",
        before="the user's mission.py was imported",
        promise="runs",
        measure=_foreign_modules,
    ),
    Finding(
        part=PART,
        name="revision of a package inside somebody's repository",
        before="the commit of that repository",
        promise="none",
        measure=_foreign_repository,
    ),
    Finding(
        part=PART,
        name="SITL with a pillar on the way that the fence does not have",
        before="silent console, exit code 0",
        promise="warning, contacts counted, exit code 3",
        measure=_console,
    ),
    Finding(
        part=PART,
        name="texts of 30 s of a mission, and a request that is refused ten times",
        before="20 of 92 texts were certificates, 19 were cut; every repeat was said",
        promise="no figures, each text once in 5 s",
        measure=_texts,
    ),
)
