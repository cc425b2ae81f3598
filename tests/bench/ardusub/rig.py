"""Service, ArduSub, its vehicle in the water, its pilot and an operator, in real time.

ArduSub is the real one in its own simulation (a program that was built elsewhere) on ``autopilot physics``, or the
emulated one of ``autopilot emulate``: the same cases on both tell where the emulator differs.
"""

import os
import re
import signal
import socket
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

import autopilot
from autopilot.mission.local_plan import LocalPlan, plan_of_local
from autopilot.mission.paper import paper_plan
from autopilot.mission.plan_files import write_plan
from autopilot.run.children import LOCAL, autopilot_command, free_port
from autopilot.sitl.scenario import load_scenario, plan_path
from tests.bench.ardusub.links import Link
from tests.lossy_link import LinkConditions, proxied

PARAMETERS = {
    "FS_PILOT_INPUT": 1.0,
    "FS_PILOT_TIMEOUT": 0.4,
    "RC_PROTOCOLS": 0.0,
    "RC_OVERRIDE_TIME": 3.0,
    "RC_OPTIONS": 0.0,
    "FS_GCS_ENABLE": 1.0,
    "MOT_FV_CPLNG_K": 0.0,
    "MOT_BAT_CURR_MAX": 0.0,
    "MAV_GCS_SYSID": 255.0,
    "RNGFND1_TYPE": 0.0,
}
"""As docs/hardware.md asks for them."""
SIMULATED = {
    "SIM_BARO_RND": 0.005,
    "SIM_BAR2_RND": 0.005,
    "SIM_BAR3_RND": 0.005,
    "LEAK1_TYPE": 1.0,
    "LEAK1_PIN": 1.0,
    "LEAK1_LOGIC": 0.0,
}
"""Of ArduSub's simulation: noise of its pressure sensors [m], and where a (digital) leak probe is."""
LEAK_BIT = 2.0
"""SIM_PIN_MASK with pin 1 up."""
HOME = "37.9755,23.779,0,0"
SHIPPED = Path(autopilot.__file__).parent / "data" / "vehicles"
VEHICLES = {"vectored": "bluerov2", "vectored_6dof": "bluerov2-heavy"}
PLACES = {"vectored": "paper-tank", "vectored_6dof": "pool"}
"""Scenarios: the Heavy is too wide for the tank's cylinders."""
FRAMES = {"vectored": 1.0, "vectored_6dof": 2.0}
GROUND_PA = 101_325.0
PREARM = 1 << 28
"""MAV_SYS_STATUS_PREARM_CHECK."""
READY_S, END_S = 120.0, 60.0
MANUAL, STABILIZE, DEPTH_HOLD, SURFACE = 19, 0, 2, 9
Process = subprocess.Popen[bytes]
ARM, SET_MODE, REBOOT, MISSION_START, INTERVAL, REQUEST = 400, 176, 246, 300, 511, 512
AUTOPILOT_VERSION = 148
KINDS = {0: "-dev", 64: "-alpha", 128: "-beta", 192: "-rc", 255: ""}
"""FIRMWARE_VERSION_TYPE."""
SERVO_OUTPUT_RAW = 36
FORCE = 21_196.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Below:
    """Who is under the service."""

    program: Path | None
    """ArduSub's simulation; None = the emulated one."""

    @property
    def name(self) -> str:
        return "emulated" if self.program is None else "ArduSub"


class Rig:
    def __init__(
        self,
        folder: Path,
        below: Below,
        frame: str = "vectored",
        *,
        parameters: Mapping[str, float] | None = None,
        ours: Sequence[str] = (),
        file_frame: str | None = None,
        place: str | None = None,
        laps: int | None = None,
        markers: bool = False,
        levelling: bool = True,
        tether: LinkConditions | None = None,
    ) -> None:
        """``parameters``: ArduSub's, beside :data:`PARAMETERS`; ``ours``: the service's, NAME=VALUE; ``file_frame``:
        what the service's file says, if it is not the truth; ``place``: scenario, if not that of the frame; ``laps``
        of the mission, if not the shipped ones (one in the tank); ``markers`` on the floor, seen by the vehicle's
        camera, instead of a tracking system; without ``levelling`` the service's vehicle has no such table; ``tether``:
        between the service and all that is in the water."""
        folder.mkdir(parents=True)
        self._tether = tether
        self._ways = ExitStack()
        self.folder, self.below, self.frame = folder, below, frame
        self.figures: dict[str, float] = {}
        """What was measured, by name and unit."""
        self._scenario, self._laps, self._levelling = place or PLACES[frame], laps, levelling
        self._camera_port = free_port() if markers else None
        self._place = load_scenario(self._scenario)
        self._ours = [*ours, *(f"{name}={value:g}" for name, value in self._place.params.items())]
        self._ended = False
        self.parameters = {**PARAMETERS, "FRAME_CONFIG": FRAMES[frame], **(parameters or {})}
        self._processes: list[Process] = []
        self.operator_port, self._flight_port = free_port(), free_port()
        self._pose_to, self._flight_to = self._way(self.operator_port), self._way(self._flight_port)
        self.version = ""
        self.ardusub: Process | None = None
        self.water: Process
        if below.program is None:
            self._emulate()
        else:
            self._simulate(below.program)
        self.service: Process | None = None
        self._links: list[Link] = []
        try:
            self._write_file(file_frame or frame)
            self._open()
        except BaseException:
            self.end()
            raise

    def _open(self) -> None:
        self.pilot = Link(self._pilot_address, component=191)
        self._links.append(self.pilot)
        self.pilot.wait("HEARTBEAT", lambda m: m.get_srcSystem() == 1, READY_S, 0)
        for name, value in self.parameters.items() if self.below.program is None else ():
            self.pilot.set_parameter(name, value)
        if self.ardusub is not None:
            self.version = self._version()
        self.watch_outputs()
        self.operator = Link(f"udpout:{LOCAL}:{self.operator_port}")
        self._links.append(self.operator)
        self.start_service()

    def _version(self) -> str:
        """ArduSub's release and the revision that it was built from."""
        mark = self.pilot.mark
        self.pilot.command(REQUEST, AUTOPILOT_VERSION)
        _, told = self.pilot.wait("AUTOPILOT_VERSION", lambda m: True, READY_S, mark)
        major, minor, patch, kind = told.flight_sw_version.to_bytes(4, "big")
        revision = bytes(told.flight_custom_version).decode("ascii", "replace").rstrip("\0")
        return f"{major}.{minor}.{patch}{KINDS.get(kind, '')} ({revision})"

    def watch_outputs(self) -> None:
        """The pilot's link shows the thrusters at 50 Hz."""
        self.pilot.command(INTERVAL, SERVO_OUTPUT_RAW, 20_000.0)

    def _way(self, port: int) -> int:
        """The port to which what is in the water sends what is for that one."""
        if self._tether is None:
            return port
        self._ways.enter_context(proxied(listen := free_port(), port, self._tether))
        return listen

    # Processes

    def _process(self, name: str, command: Sequence[str]) -> Process:
        with (self.folder / f"{name}.txt").open("a") as out:
            process = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, cwd=self.folder)
        self._processes.append(process)
        return process

    def _emulate(self) -> None:
        port = free_port()
        links = [f"--link=udpout:{LOCAL}:{self._flight_to}", f"--link=udpout:{LOCAL}:{port}"]
        self._pilot_address = f"udpin:{LOCAL}:{port}"
        self.water = self._process("water", autopilot_command("emulate", *self._water, *links))

    @property
    def _water(self) -> list[str]:
        """Options of who simulates the water: where, which vehicle, who tells its position."""
        place = [self._scenario, "--vehicle", VEHICLES[self.frame], "--frame", self.frame, "--truth", "truth.jsonl"]
        if self._camera_port is not None:
            return [*place, "--camera", f"{LOCAL}:{self._camera_port}"]
        return [*place, f"--pose=udpout:{LOCAL}:{self._pose_to}"]

    def _simulate(self, program: Path) -> None:
        self.instance = next(n for n in range(20, 90) if _is_free(9002 + 10 * n))
        listen = f"--listen={LOCAL}:{9002 + 10 * self.instance}"
        self.water = self._process("water", autopilot_command("physics", *self._water, listen))
        self._pilot_address = f"tcp:{LOCAL}:{5762 + 10 * self.instance}"
        values = {**self.parameters, **SIMULATED}
        (self.folder / "ardusub.parm").write_text("".join(f"{name} {value:g}\n" for name, value in values.items()))
        command = [str(program), "-I", str(self.instance), "--model", f"JSON:{LOCAL}", "--home", HOME]
        command += ["--speedup", "1", "--serial0", f"udpclient:{LOCAL}:{self._flight_to}"]
        command += ["--defaults", str(self.folder / "ardusub.parm"), "--wipe"]
        self.ardusub = self._process("ardusub", command)

    def _write_file(self, frame: str) -> None:
        self.config = self.folder / "rov.toml"
        self.config.write_text(
            f'vehicle = "{self._vehicle(frame)}"\n[place]\nname = "tank"\nbasin = "closed"\n{self._markers()}'
            f'[service]\nconnect = ["udpin:{LOCAL}:{self.operator_port}"]\n'
            f'log_dir = "{self.folder}/logs"\nstate_dir = "{self.folder}/state"\n'
            f'[devices.flight_controller]\ndriver = "ardusub"\nconnect = "udpin:{LOCAL}:{self._flight_port}"\n'
            f'frame = "{frame}"\nsurface_pa = {GROUND_PA}\n{self._camera()}'
        )
        self.plan = self.folder / "mission.plan"
        if self._scenario == "paper-tank":
            write_plan(self.plan, paper_plan(self._laps or 1))
            return
        shipped = plan_path(self._scenario, self._place)
        assert shipped is not None
        local = msgspec.toml.decode(shipped.read_text(), type=LocalPlan)
        if self._laps is not None and local.repeat is not None:
            local = msgspec.structs.replace(local, repeat=msgspec.structs.replace(local.repeat, laps=self._laps))
        write_plan(self.plan, plan_of_local(local))

    def _vehicle(self, frame: str) -> str:
        """Its name, or a file of our own without ``[levelling]``."""
        if self._levelling:
            return VEHICLES[frame]
        text = (SHIPPED / f"{VEHICLES[frame]}.toml").read_text()
        text = re.sub(r"^\[levelling\].*?(?=^\[)", "", text, flags=re.M | re.S)
        own = self.folder / "vehicle.toml"
        own.write_text(re.sub(r'^"levelling\..*\n', "", text, flags=re.M))
        return str(own)

    def _markers(self) -> str:
        """The map, for ``[place]``."""
        if self._camera_port is None:
            return ""
        floor = self.folder / "floor.toml"
        subprocess.run(
            autopilot_command("scenario", "markers", self._scenario, "--out", str(floor)),
            check=True,
            stdout=subprocess.DEVNULL,
        )
        return f'markers = "{floor}"\n'

    def _camera(self) -> str:
        """``[devices.camera]`` as the camera says it."""
        if self._camera_port is None:
            return ""
        end_s = time.monotonic() + READY_S
        while time.monotonic() < end_s:
            found = re.search(r"^\[devices\.camera\]\n(?:\w+ = .*\n)+", (self.folder / "water.txt").read_text(), re.M)
            if found is not None:
                return found[0]
            time.sleep(0.2)
        raise TimeoutError(f"no camera: {(self.folder / 'water.txt').read_text()}")

    def start_service(self) -> None:
        given = [word for text in self._ours for word in ("--param", text)]
        self.service = self._process("service", autopilot_command("run", "--config", str(self.config), *given))

    @property
    def said(self) -> str:
        """What the service printed."""
        return (self.folder / "service.txt").read_text()

    # What an operator does

    def until_ready(self) -> None:
        """Until the vehicle would arm."""
        mark = self.operator.mark
        try:
            self.operator.wait("SYS_STATUS", lambda m: bool(m.onboard_control_sensors_health & PREARM), READY_S, mark)
        except TimeoutError:
            self.arm()  # which says why not

    def upload(self) -> None:
        subprocess.run(
            autopilot_command("mission", "upload", str(self.plan), "--connect", f"udpout:{LOCAL}:{self.operator_port}"),
            check=True,
            stdout=subprocess.DEVNULL,
        )

    def fly(self) -> None:
        """Uploads, arms and starts; returns at the first point, when the vehicle is under way."""
        self.upload()
        self.until_ready()
        self.arm()
        mark = self.operator.mark
        if self.operator.command(MISSION_START) != 0:
            raise AssertionError("the mission does not start")
        self.operator.wait("MISSION_ITEM_REACHED", lambda m: True, READY_S, mark)
        time.sleep(2.0)
        if not self.turning:
            raise AssertionError("nothing turns under way")

    def arm(self) -> None:
        if self.operator.command(ARM, 1.0) != 0:
            raise AssertionError(f"arming is denied: {[m.text for _, m in self.operator.since(0, 'STATUSTEXT')][-3:]}")
        self.operator.wait("HEARTBEAT", lambda m: m.get_srcComponent() == 1 and m.base_mode & 128, 20.0)

    def mode_of_pilot(self, mode: int) -> None:
        if self.pilot.command(SET_MODE, 1.0, float(mode)) != 0:
            raise AssertionError(f"ArduSub does not take mode {mode}")

    # What is seen

    @property
    def motors(self) -> int:
        return 6 if self.frame == "vectored" else 8

    def _turns(self, message: Any) -> bool:
        """Whether a thruster does."""
        return any(getattr(message, f"servo{n}_raw") not in (0, 1500) for n in range(1, self.motors + 1))

    @property
    def turning(self) -> bool:
        mark = self.pilot.mark
        return bool(self._turns(self.pilot.wait("SERVO_OUTPUT_RAW", lambda m: m.port == 0, 10.0, mark)[1]))

    def neutral_s(self, mark: int, since_s: float, patience_s: float = 20.0) -> float:
        """From a time to the first report that all thrusters are neutral [s]."""
        t_s, _ = self.pilot.wait("SERVO_OUTPUT_RAW", lambda m: m.port == 0 and not self._turns(m), patience_s, mark)
        return t_s - since_s

    def is_armed(self) -> bool:
        """ArduSub, by its next heartbeat."""
        mark = self.pilot.mark
        beat = self.pilot.wait("HEARTBEAT", lambda m: m.get_srcSystem() == 1 and m.get_srcComponent() == 1, 10.0, mark)
        return bool(beat[1].base_mode & 128)

    def below_until(self, *, armed: bool, mark: int | None = None) -> float:
        return self.pilot.wait(
            "HEARTBEAT",
            lambda m: m.get_srcSystem() == 1 and m.get_srcComponent() == 1 and bool(m.base_mode & 128) is armed,
            20.0,
            mark,
        )[0]

    def until_disarmed(self) -> None:
        self.operator.wait("HEARTBEAT", lambda m: m.get_srcComponent() == 1 and not m.base_mode & 128, 20.0)

    # The end

    def end(self) -> int | None:
        """Stops everything; contacts that the vehicle had, None where the water was killed."""
        self._ended = True
        for link in self._links:
            link.close()
        for process in reversed(self._processes):  # the service first
            process.send_signal(signal.SIGCONT)
            process.send_signal(signal.SIGKILL if process is self.ardusub else signal.SIGTERM)
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._ways.close()
        found = re.search(r"contacts\W+(\d+)", (self.folder / "water.txt").read_text())
        return int(found[1]) if found else None

    def __enter__(self) -> "Rig":
        return self

    def __exit__(self, *_: object) -> None:
        if not self._ended:
            self.end()


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((LOCAL, port))
        except OSError:
            return False
    return True


os.environ.setdefault("MAVLINK20", "1")
