"""An LBV150 whose thrusters hang on hardware PWM of the computer, for the real service in real time.

The PWM is a folder as Linux shows it, the AHRS an emulated IG-500A on a pseudo-terminal.
"""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from pymavlink.dialects.v20 import development as mav

from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.links import open_link
from autopilot.run.children import free_port
from autopilot.sitl.ahrs import Ig500Emulator
from autopilot.sitl.hil import PtyLine
from autopilot.sitl.protocol import PlantContext, create_plant
from autopilot.sitl.scenario import load_scenario

NEUTRAL = (1500.0,) * 4
MANUAL_MODE = (1, 0)
"""Main and sub mode of the profile "px4"."""


def until(condition: Callable[[], bool], patience_s: float = 120.0) -> None:
    """Wait for another process; the patience is a guard against hangs only."""
    end_s = time.monotonic() + patience_s
    while not condition():
        if time.monotonic() > end_s:
            raise AssertionError("it does not happen")
        time.sleep(0.005)


def gone(pid: int) -> bool:
    """Whether no such process runs."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return True
    return state == "Z"


def keepers_of(pid: int) -> list[int]:
    """Processes that a service has started as keepers and that run."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            command = (folder / "cmdline").read_bytes()
            parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
        except OSError:
            continue
        if parent == pid and b"autopilot.drivers.watchdog" in command and not gone(int(folder.name)):
            found.append(int(folder.name))
    return found


class PwmVehicle:
    """Devices and a client of a vehicle; a service with :attr:`config` finds them."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(exist_ok=True)
        self.chip = folder / "pwmchip0"
        for number in range(4):
            (self.chip / f"pwm{number}").mkdir(parents=True)
            for name in ("period", "duty_cycle", "enable"):
                (self.chip / f"pwm{number}" / name).write_text("0")
        scenario, vehicle = load_scenario("paper-tank-still"), load_vehicle("lbv150")
        self._plant = create_plant("rigid-body", PlantContext(scenario=scenario, vehicle=vehicle, seed=1), None)
        self._ahrs = Ig500Emulator(scenario.sensors.ahrs, vehicle.ahrs, [], 1)
        self._line = PtyLine(self._ahrs, "ttyAHRS")
        self._line.open()
        port = free_port()
        self.config = folder / "pwm.toml"
        self.config.write_text(
            'vehicle = "lbv150"\n[service]\n'
            f'connect = ["udpin:127.0.0.1:{port}"]\nstate_dir = "state"\nlog_dir = "logs"\n'
            f'[devices.ahrs]\ndriver = "ig500"\nport = "{self._line.path}"\n'
            f'[devices.thrusters]\ndriver = "sysfs_pwm"\nchip = "{self.chip}"\n',
            encoding="utf-8",
        )
        self._link = open_link(f"udpout:127.0.0.1:{port}")
        self._mav = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        self.inbox: list[Any] = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self.sticks = 0
        """Surge that the pilot asks for, of 1000."""

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()
        self._link.close()
        self._line.close()

    def pulses_us(self) -> tuple[float, ...]:
        """What the amplifiers see."""

        def pulse(number: int) -> float:
            duty = (self.chip / f"pwm{number}" / "duty_cycle").read_text().split()
            return int(duty[0]) / 1000 if duty else 0.0

        return tuple(pulse(number) for number in range(4))

    @property
    def still(self) -> bool:
        """Whether no thruster is commanded."""
        return self.pulses_us() == NEUTRAL

    def texts(self) -> list[str]:
        """What the operator was told, whole texts and pieces of longer ones."""
        return [message.text for message in self.inbox if message.get_type() == "STATUSTEXT"]

    def reported(self, text: str) -> bool:
        """Whether the operator was told something with that in it."""
        return any(text in line for line in self.texts())

    def send(self, message: Any) -> None:
        """A message of the ground station."""
        self._link.send(bytes(message.pack(self._mav)))
        self._mav.seq = (self._mav.seq + 1) & 0xFF

    def ask(self, command: int, *params: float) -> int:
        """COMMAND_LONG and its result, sent until it is answered."""
        del self.inbox[:]

        def answers() -> list[int]:
            return [m.result for m in list(self.inbox) if m.get_type() == "COMMAND_ACK" and m.command == command]

        end_s = time.monotonic() + 120.0
        while not answers():
            assert time.monotonic() < end_s, "no answer"
            self.send(mav.MAVLink_command_long_message(1, 1, command, 0, *params, *(0.0,) * (7 - len(params))))
            for _ in range(100):
                if answers():
                    break
                time.sleep(0.01)
        return answers()[0]

    def fly(self) -> None:
        """Arm in MANUAL as soon as that is possible and push ahead, until the thrusters turn."""
        until(lambda: any(m.get_type() == "HEARTBEAT" for m in list(self.inbox)))
        until(lambda: self.ask(mav.MAV_CMD_DO_SET_MODE, 1, *MANUAL_MODE) == mav.MAV_RESULT_ACCEPTED)
        until(lambda: self.ask(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mav.MAV_RESULT_ACCEPTED)
        self.sticks = 1000
        until(lambda: not self.still)

    def _live(self) -> None:
        begin_s, tick = time.monotonic(), 0
        while not self._over.is_set():
            tick += 1
            self._over.wait(max(0.0, begin_s + 0.01 * tick - time.monotonic()))
            t_us = 10_000 * tick
            self._plant.advance(t_us, (1500,) * 4)
            if self._ahrs.next_us <= t_us:
                self._ahrs.observe(self._plant.truth)
            self._line.pump(t_us)
            for received in self._link.recv(t_us):
                self.inbox += self._mav.parse_buffer(received.data) or ()
            if tick % 100 == 1:
                self.send(mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, 8, 0, 0, 4, 3))
            if tick % 10 == 0 and self.sticks:
                self.send(mav.MAVLink_manual_control_message(1, self.sticks, 0, 500, 0, 0))
