"""For all tests: property tests always take the same examples, a slow machine is no failure, faults are raised."""

import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import platformdirs
import pytest
from hypothesis import HealthCheck, settings

if sys.dont_write_bytecode:
    # Each of a hundred processes would compile all that it imports: half a second of the two that its start takes.
    sys.dont_write_bytecode = False
    sys.pycache_prefix = str(Path(platformdirs.user_cache_dir("underwater-autopilot-tests")) / "bytecode")
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import autopilot  # noqa: F401 - before any test imports numpy: it says how many threads linear algebra takes

settings.register_profile("repeatable", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("repeatable")

os.environ["AUTOPILOT_GUARD"] = "raise"
"""Exceptions inside the service end a test, in this process and in those that it starts."""

ROOT = Path(__file__).resolve().parent.parent
CLIENTS = (f"{ROOT}/tests/", f"{ROOT}/autopilot/bench/")
"""Files whose sockets are a client's in a test."""

LONGEST = ("system", "service", "estimator", "control")
"""Folders of the modules that take longest. They begin first, so that at the end no process is left with one."""


LONG = {
    "api": "gym_env notebooks",
    "bench": "alarms_bench ardusub_bench",
    "drivers": "keeper",
    "mavlink": "mavsdk",
    "run": "recorded_ardusub vehicle_flight",
    "service": "hostile_traffic mavsdk_steers",
    "sitl": "camera_process",
    "system": "busy_machine calibration_flight campaign campaign_set_up crossing_obstacle dask_campaign"
    " flights_in_waves frozen_ahrs_flights gps_flight lost_state mavsdk_mission own_parts"
    " picture_fault_flights pool_by_markers qgroundcontrol real_time restart_matrix sensor_faults"
    " slow_sources stick_flights thruster_loss"
    " velocity_log_denied who_is_served",
    "tests": "wheel",
    "view": "access ages attitude_dials browser past player process space view_beside",
}
"""Modules of `make test-long`, by folder: flights of minutes, browsers, clients of others, many processes."""


def pytest_configure(config: pytest.Config) -> None:
    """Modules begin in the order of :data:`LONGEST`, not those with the most tests first, as xdist would have it."""
    config.addinivalue_line("markers", "long: of `make test-long`")
    for folder, names in LONG.items():
        for name in names.split():
            if not (ROOT / "tests" / folder.replace("tests", "") / f"test_{name}.py").exists():
                raise pytest.UsageError(f"LONG of tests/conftest.py: {folder} has no test_{name}.py")
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest first, else as they were; those of :data:`LONG` are marked."""
    for item in items:
        if item.path.stem.removeprefix("test_") in LONG.get(item.path.parent.name, "").split():
            item.add_marker(pytest.mark.long)
    place = {name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.parent.name, len(LONGEST)))


def _opened_by(frame: Any) -> str:
    """The file of ours that called for what is being made."""
    while frame is not None:
        name = str(frame.f_code.co_filename)
        if name.startswith(f"{ROOT}/") and "site-packages" not in name:
            return name
        frame = frame.f_back
    return ""


@pytest.fixture(autouse=True, scope="module")
def clients_hang_up() -> Iterator[None]:
    """Sockets that tests open for clients of their own are closed after the module. What the product opens it has to
    close itself: a socket of its that is collected unclosed is an error."""
    made, begin = [], socket.socket.__init__

    def noted(self: socket.socket, *given: Any, **named: Any) -> None:
        begin(self, *given, **named)
        if _opened_by(sys._getframe(1)).startswith(CLIENTS):
            made.append(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socket.socket, "__init__", noted)
        yield
    for client in made:
        client.close()
