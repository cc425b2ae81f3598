"""A service whose loading takes for ever: what it says meanwhile, and that all of it is answered in the end."""

from __future__ import annotations

import contextlib
import random
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as mav

from autopilot.bench.live_service import Station
from autopilot.run.children import LOCAL, Child, autopilot_command, free_port

HOLD = """
import importlib.abc, os, pathlib, sys, time

class Hold(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == "autopilot.run.sitl_session":
            sys.meta_path.remove(self)
            release = pathlib.Path(os.environ["TEST_RELEASE"])
            end = time.monotonic() + 300.0
            while not release.exists() and time.monotonic() < end:
                time.sleep(0.05)

sys.meta_path.insert(0, Hold())
"""


@contextlib.contextmanager
def held(folder: Path) -> Iterator[tuple[Child, Station, Path]]:
    """A service that does not get on with loading until a file is there."""
    port, release = free_port(), folder / "release"
    (folder / "hold").mkdir()
    (folder / "hold" / "sitecustomize.py").write_text(HOLD)
    environment = {
        "AUTOPILOT_STATE_DIR": str(folder / "state"),
        "AUTOPILOT_LOG_DIR": str(folder / "logs"),
        "PYTHONPATH": str(folder / "hold"),
        "TEST_RELEASE": str(release),
    }
    common = ("sitl", "open-water", "--quiet", "--sensors", "pose", "--speed", "1")
    child = Child(autopilot_command(*common, "--connect", f"udpin:{LOCAL}:{port}"), environment)
    try:
        yield child, Station.udp(port, 255), release
    finally:
        release.touch()
        assert child.end() == 0


def hear(child: Child, station: Station, wanted: Any, ask: Any = None) -> Any:
    """The first message of that kind; asked for again and again, as every client does."""
    asked_s, begin_s = 0.0, time.monotonic()
    while time.monotonic() - begin_s < 60.0:
        assert child.process.poll() is None
        if ask is not None and time.monotonic() - asked_s > 0.5:
            asked_s = time.monotonic()
            station.send(ask)
        for message in station.receive(0.05):
            if wanted(message):
                return message
    raise AssertionError("it never came")


def request(number: int) -> Any:
    return mav.MAVLink_command_long_message(1, 1, 512, 0, number, 0, 0, 0, 0, 0, 0)


def of_kind(*names: str) -> Any:
    return lambda message: message.get_type() in names


@pytest.mark.long
def test_a_vehicle_says_what_it_is_however_long_it_takes_to_start(tmp_path: Path) -> None:
    """QGroundControl's first questions, under a shower of messages that nobody wants; its beats go on all the while."""
    rng = random.Random(1)
    with held(tmp_path) as (child, station, release):
        beat = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
        first = hear(child, station, of_kind("HEARTBEAT"), beat)
        assert first.system_status == mav.MAV_STATE_BOOT
        version = hear(child, station, of_kind("AUTOPILOT_VERSION"), request(148))
        for bit in (mav.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE, mav.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY):
            assert version.capabilities & bit
        hear(child, station, of_kind("UNKNOWN_300"), request(300))
        hear(child, station, of_kind("COMPONENT_METADATA"), request(397))
        station.send(mav.MAVLink_param_request_list_message(1, 1))
        arm = mav.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
        ack = hear(child, station, lambda m: m.get_type() == "COMMAND_ACK" and m.command == 400, arm)
        assert ack.result == mav.MAV_RESULT_TEMPORARILY_REJECTED
        for _ in range(3):  # beats
            points = [[rng.uniform(-9.0, 9.0) for _ in range(5)] for _ in range(11)]
            commands = [rng.randrange(65536) for _ in range(5)]
            for _ in range(20):
                station.send(mav.MAVLink_trajectory_representation_waypoints_message(0, 5, *points, commands))
            assert hear(child, station, of_kind("HEARTBEAT")).system_status == mav.MAV_STATE_BOOT
        release.touch()
        standby = mav.MAV_STATE_STANDBY
        hear(child, station, lambda m: m.get_type() == "HEARTBEAT" and m.system_status == standby, beat)
        hear(child, station, of_kind("PARAM_VALUE"), mav.MAVLink_param_request_list_message(1, 1))
        again = hear(child, station, of_kind("AUTOPILOT_VERSION"), request(148))
        assert again.to_dict() == version.to_dict()
