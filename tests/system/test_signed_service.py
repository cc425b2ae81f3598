"""A real service with a key: SETUP_SIGNING over the loopback, who is obeyed then, what the log and the disk have."""

from __future__ import annotations

import stat
import time
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import development as mav

from autopilot.bench.live_service import Station
from autopilot.log.reader import open_log
from autopilot.run.children import LOCAL, Child, autopilot_command, free_port

KEY = bytes(range(7, 39))


def arm_answer(station: Station, child: Child, codec: Any, *, patience_s: float) -> int | None:
    """Result of RUN_PREARM_CHECKS, asked for with a codec; None = not heard."""
    end_s = time.monotonic() + patience_s
    asked_s = 0.0
    while time.monotonic() < end_s and child.at_work():
        if time.monotonic() - asked_s > 0.3:
            asked_s = time.monotonic()
            station.socket.send(mav.MAVLink_command_long_message(1, 1, 401, 0, 0, 0, 0, 0, 0, 0, 0).pack(codec))
            codec.seq = (codec.seq + 1) & 0xFF
        for message in station.receive(0.05):
            if message.get_type() == "COMMAND_ACK" and message.result != 1:  # a service that starts puts everybody off
                return int(message.result)
    return None


def codec(key: bytes | None, sysid: int) -> Any:
    """Packs, and signs with a key."""
    found = mav.MAVLink(None, srcSystem=sysid, srcComponent=190)
    if key is not None:
        found.signing.secret_key, found.signing.sign_outgoing = key, True
        found.signing.timestamp = int((time.time() - 1_420_070_400) * 1e5)
    return found


def test_a_service_that_was_given_a_key_hears_who_has_it(tmp_path: Path) -> None:
    port, log = free_port(), tmp_path / "run.mcap"
    environment = {"AUTOPILOT_STATE_DIR": str(tmp_path / "state")}
    common = ("sitl", "open-water", "--quiet", "--sensors", "pose", "--speed", "1")
    links = ("--connect", f"udpin:{LOCAL}:{port}")
    child = Child(autopilot_command(*common, *links, "--log", str(log)), environment)
    try:
        plain, signed, other = Station.udp(port, 10), Station.udp(port, 11), Station.udp(port, 12)
        assert arm_answer(plain, child, codec(None, 10), patience_s=120.0) is not None
        plain.send(mav.MAVLink_setup_signing_message(1, 1, list(KEY), 0))
        assert arm_answer(signed, child, codec(KEY, 11), patience_s=60.0) is not None
        assert arm_answer(plain, child, codec(None, 10), patience_s=1.5) is None
        assert arm_answer(other, child, codec(bytes(32 * [9]), 12), patience_s=1.5) is None
    finally:
        assert child.end() == 0
    kept = tmp_path / "state" / "sitl-0" / "signing.key"
    assert bytes.fromhex(kept.read_text().strip()) == KEY and stat.S_IMODE(kept.stat().st_mode) == 0o600
    assert not any(KEY[:8] in path.read_bytes() for path in tmp_path.rglob("*") if path.is_file())
    flight = open_log(log)
    taken = [data for _, data in flight.raw_messages("/in/mavlink")]
    assert taken and not any(KEY[:8] in data for data in taken)
    assert not any(KEY[:8] in data for data in flight.attachments.values())

    child = Child(autopilot_command(*common, *links, "--log", str(tmp_path / "second.mcap")), environment)
    try:
        signed = Station.udp(port, 11)
        assert arm_answer(signed, child, codec(KEY, 11), patience_s=120.0) is not None, "the key outlives the run"
        assert arm_answer(Station.udp(port, 10), child, codec(None, 10), patience_s=1.5) is None
    finally:
        assert child.end() == 0
