"""The loop and what works beside it: a slow detector, slow and full disks, a kill in the middle of a run."""

import contextlib
import json
import os
import re
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import development as mav

from autopilot.client.client_session import VehicleConnection
from autopilot.core.plan import PlanKind
from autopilot.core.samples import CameraFrame, MarkerSighting
from autopilot.estimator.vision import Hint, MarkerDetector
from autopilot.log import writer
from autopilot.mavlink.vehicle_commands import FORCE_ARM
from autopilot.mission.paper import paper_plan
from autopilot.run import session as sessions
from autopilot.run.children import LOCAL, Child, autopilot_command, free_port, python_command
from autopilot.run.config import gather, sitl_defaults
from autopilot.run.sitl_session import SitlSession, open_sitl
from tests.bench.faults.finding import Finding, Measured

DETECTION_S = 0.15
SLOW_S = 1.0
"""How long a slow disk takes to make a file, and to sync one."""
FILE_BYTES = 150_000
FLIGHT_S = 3.0


class _SlowDetector(MarkerDetector):
    """Takes 150 ms for a picture."""

    def detect(self, frame: CameraFrame, hint: Hint | None) -> MarkerSighting:
        time.sleep(DETECTION_S)
        return super().detect(frame, hint)


class _Operator:
    """Arms, lets the world be spoilt before, and keeps what it is told."""

    def __init__(self, arm_s: float, spoil: Callable[[], object] = lambda: None) -> None:
        self._codec, self._parser = mav.MAVLink(None, srcSystem=255, srcComponent=190), mav.MAVLink(None)
        self._arm_us, self._spoil, self._armed = arm_s * 1e6, spoil, False
        self.texts: list[str] = []

    def step(self, t_us: int, received: Sequence[bytes]) -> list[bytes]:
        """A peer of the runtime."""
        messages = [message for data in received for message in self._parser.parse_buffer(data) or ()]
        self.texts += [message.text for message in messages if message.get_type() == "STATUSTEXT"]
        if self._armed or t_us < self._arm_us:
            return []
        self._armed = True
        self._spoil()
        arm = self._codec.command_long_encode(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, FORCE_ARM, 0, 0, 0, 0, 0)
        return [bytes(arm.pack(self._codec))]


def _session(folder: Path, operator: _Operator | None = None, **given: Any) -> SitlSession:
    settings = gather(sitl_defaults(0), {"speed": 1.0, "sensors": "pose", "duration": FLIGHT_S, **given}, {})
    places = {"connect": (), "state_dir": str(folder / "state"), "log_dir": str(folder / "logs")}
    for name, value in places.items():
        settings.put(name, value, "finding")
    return open_sitl(settings, {}, peers=() if operator is None else [operator])


@contextlib.contextmanager
def _instead(owner: Any, name: str, other: Any) -> Iterator[None]:
    """Something else in a name's place for a while."""
    before = getattr(owner, name)
    setattr(owner, name, other)
    try:
        yield
    finally:
        setattr(owner, name, before)


def _slow_detector() -> Measured:
    with tempfile.TemporaryDirectory() as folder, _instead(sessions, "MarkerDetector", _SlowDetector):
        session = _session(Path(folder), sensors="camera")
        wall_s = session.run()
    # What a busy machine takes is not the detector's fault: a loop that waits for it takes five times as long.
    return Measured(text=f"{FLIGHT_S:.0f} s took {wall_s:.1f} s", kept=wall_s < 2.0 * FLIGHT_S)


def _slow_disk() -> Measured:
    make, sync = writer._open_locked, os.fsync

    def slow_make(path: Path) -> Any:
        time.sleep(SLOW_S)
        return make(path)

    def slow_sync(descriptor: int) -> None:
        time.sleep(SLOW_S)
        sync(descriptor)

    with (
        tempfile.TemporaryDirectory() as folder,
        _instead(writer, "_open_locked", slow_make),
        _instead(os, "fsync", slow_sync),
    ):
        operator = _Operator(1.0)
        session = _session(Path(folder), operator)
        session.run()
        worst_s, lost = session.runtime.counters.worst_tick_s, session.recorder.dropped
    kept = worst_s < 0.5 * SLOW_S and not lost and "Armed" in operator.texts
    return Measured(text=f"longest tick {1e3 * worst_s:.0f} ms, {lost} messages lost", kept=kept)


def _folder_gone() -> Measured:
    with tempfile.TemporaryDirectory() as folder:
        logs = Path(folder) / "logs"

        def spoil() -> None:
            logs.rmdir()
            logs.write_bytes(b"")

        operator = _Operator(1.0, spoil)
        session = _session(Path(folder), operator)
        session.run()
        ticks = session.runtime.counters.ticks
    said = [text for text in operator.texts if text.startswith("Log stopped")]
    text = f"flew on to the end ({ticks} ticks), said {said}"
    return Measured(text=text, kept=ticks == round(100 * FLIGHT_S) and said == ["Log stopped: folder gone"])


def _disk_full() -> Measured:
    """A limit on the size of files stands for the disk."""
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({FILE_BYTES}, {FILE_BYTES}))\n"
    with tempfile.TemporaryDirectory() as folder:
        arguments = ["sitl", "--speed", "0", "--sensors", "pose", "--duration", "6"]
        arguments += ["--connect", f"udpin:{LOCAL}:{free_port()}", "--log", str(Path(folder) / "a.mcap")]
        done = subprocess.run(
            [*python_command(limit + "from autopilot.cli.main import main; main()"), *arguments],
            env={**os.environ, "AUTOPILOT_STATE_DIR": folder},
            capture_output=True,
            text=True,
            check=False,
        )
    ran = re.search(r"^([\d.]+) s simulated", done.stdout, re.MULTILINE)
    flown = "nothing" if ran is None else f"{ran[1]} of 6 s"
    return Measured(
        text=f"{flown} flown, exit code {done.returncode}", kept=flown == "6.0 of 6 s" and done.returncode == 3
    )


@contextlib.contextmanager
def _keeping(folder: str) -> Iterator[tuple[Child, VehicleConnection]]:
    """A service that keeps its plans, killed at the end, and a client."""
    port = free_port()
    arguments = ["sitl", "--quiet", "--sensors", "pose", "--keep-plans", "--connect", f"udpin:{LOCAL}:{port}"]
    child = Child(autopilot_command(*arguments), {"AUTOPILOT_STATE_DIR": folder, "AUTOPILOT_LOG_DIR": folder + "/logs"})
    try:
        with VehicleConnection(f"udpout:{LOCAL}:{port}", at_work=child.at_work) as client:
            client.connect(60.0)
            yield child, client
    finally:
        child.process.kill()
        child.process.wait()


def _stored_items(folder: Path) -> int:
    """Items of the mission that are on disk."""
    path = folder / "sitl-0" / "plans.json"
    return len(json.loads(path.read_text().splitlines()[1])["mission"]) if path.exists() else 0


def _killed() -> Measured:
    plan = paper_plan()
    with tempfile.TemporaryDirectory() as folder:
        with _keeping(folder) as (child, client):
            client.upload(PlanKind.FENCE, plan.fence)
            client.upload(PlanKind.MISSION, plan.mission)
            had = [repr(client.download(kind)) for kind in PlanKind]
            while _stored_items(Path(folder)) < len(plan.mission) and child.at_work():
                client.poll()
        with _keeping(folder) as (_, client):
            has = [repr(client.download(kind)) for kind in PlanKind]
    same = sum(a == b for a, b in zip(had, has, strict=True))
    return Measured(text=f"{same} of 3 plans are what they were", kept=same == len(had))


FINDINGS: tuple[Finding, ...] = (
    Finding(
        part="loop",
        name="a detector that takes 150 ms per picture",
        before="3 s took 15 s",
        promise="the newest picture wins, the loop waits for none",
        measure=_slow_detector,
    ),
    Finding(
        part="loop",
        name="a disk that takes 1 s to make a file and 1 s to sync it",
        before="stalls the run (lossless also when paced)",
        promise="no tick waits, nothing of the first moments is lost",
        measure=_slow_disk,
    ),
    Finding(
        part="loop",
        name="log folder gone at arming",
        before="LogError ends the process, nothing is said in flight",
        promise="flies on, says so at once",
        measure=_folder_gone,
    ),
    Finding(
        part="loop",
        name="disk full",
        before="LogError ends the process, exit code 1",
        promise="flies on to the end, exit code 3",
        measure=_disk_full,
    ),
    Finding(
        part="loop",
        name="service killed and started again",
        before="all plans are gone",
        promise="--keep-plans: plans are what they were",
        measure=_killed,
    ),
)
