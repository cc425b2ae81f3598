"""ArduPilot's JSON interface with a scripted ArduPilot at the other end: packets, lockstep, and a hull that moves."""

import json
import signal
import socket
import struct
import subprocess
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.core.frames import r_ned_from_frd, rpy_from_quat
from autopilot.core.vehicle import load_vehicle
from autopilot.run.children import autopilot_command
from autopilot.sitl.ardupilot_json import JsonPhysics, parse_servos
from autopilot.sitl.ardusub_vehicle import ArduSubVehicle
from autopilot.sitl.scenario import load_scenario, with_vehicle

STILL = """
[scenario]
name = "still"
description = "Still water"
[tank]
polygon_m = [[-20, -20], [20, -20], [20, 20], [-20, 20]]
depth_m = 10.0
[vehicle]
model = "bluerov2"
start_m = [0.0, 0.0, 3.0]
[sensors]
position = "pose"
"""
AHEAD = (1400, 1400, 1600, 1600, 1500, 1500)
"""Forward: ArduSub's motor matrix for the vectored frame, MOT_n_DIRECTION 1."""
TURN = (1600, 1400, 1400, 1600, 1500, 1500)
"""To starboard."""
DOWN = (1500, 1500, 1500, 1500, 1600, 1600)
NEUTRAL = (1500,) * 6


def packet(frame: int, pulses: tuple[int, ...] = NEUTRAL, rate_hz: int = 400, channels: int = 16) -> bytes:
    """As ArduPilot packs it."""
    magic = {16: 18458, 32: 29569}[channels]
    return struct.pack(f"<HHI{channels}H", magic, rate_hz, frame, *pulses, *[0] * (channels - len(pulses)))


def physics(folder: Path, text: str = STILL) -> JsonPhysics:
    path = folder / "still.toml"
    path.write_text(text, encoding="utf-8")
    scenario = with_vehicle(load_scenario(str(path)), "bluerov2", "--vehicle")
    vehicle = load_vehicle("bluerov2")
    return JsonPhysics(
        lambda: ArduSubVehicle(scenario, vehicle, "vectored", seed=1).driven, 10.0, vehicle.depth_sensor.position_frd_m
    )


def told(answer: bytes | None) -> dict[str, Any]:
    assert answer is not None
    assert answer.startswith(b"\n") and answer.endswith(b"\n") and answer.count(b"\n") == 2
    assert b": " not in answer, "ArduPilot's reader wants no space behind a colon"
    state: dict[str, Any] = json.loads(answer)
    return state


@given(data=st.binary(max_size=90))
def test_any_bytes_are_a_packet_or_none(data: bytes) -> None:
    found = parse_servos(data)
    assert found is None or (len(data), len(found.pwm_us)) in ((40, 16), (72, 32))


@given(
    rate_hz=st.integers(1, 20_000),
    frame=st.integers(0, 2**32 - 1),
    pulses=st.lists(st.integers(800, 2200), min_size=16, max_size=16),
    wide=st.booleans(),
)
def test_a_packet_is_read_as_it_was_packed(rate_hz: int, frame: int, pulses: list[int], wide: bool) -> None:
    found = parse_servos(packet(frame, tuple(pulses), rate_hz, 32 if wide else 16))
    assert found is not None
    assert (found.rate_hz, found.frame, list(found.pwm_us[:16])) == (rate_hz, frame, pulses)
    assert parse_servos(packet(frame, tuple(pulses), rate_hz)[:-1]) is None


def test_what_it_answers_is_the_state_of_the_hull(tmp_path: Path) -> None:
    flown = physics(tmp_path)
    first = told(flown.answer(packet(0)))
    assert first["timestamp"] == pytest.approx(0.0025)
    assert first["imu"]["accel_body"][2] == pytest.approx(-9.8, abs=0.3), "specific force of a hull at rest"
    assert first["battery"]["voltage"] == pytest.approx(16.8, abs=0.2)
    assert first["rng_1"] == pytest.approx(7.0, abs=0.01)
    for frame in range(1, 1200):
        state = told(flown.answer(packet(frame, AHEAD if frame < 800 else TURN)))
    truth = flown.truth
    assert truth is not None
    north, east, down = truth.pos_ned_m.tolist()
    pressure_down_m = down + r_ned_from_frd(truth.rpy_rad)[2] @ load_vehicle("bluerov2").depth_sensor.position_frd_m
    assert state["position"] == [north, east, pytest.approx(pressure_down_m)]
    assert abs(pressure_down_m - down) > 0.01, "it pitches as it goes ahead"
    assert state["velocity"] == pytest.approx((r_ned_from_frd(truth.rpy_rad) @ truth.vel_frd_m_s).tolist())
    assert rpy_from_quat(state["quaternion"]) == pytest.approx(state["attitude"], abs=1e-9)
    # 400 Hz: 1200 frames are 3 s.
    assert state["timestamp"] == pytest.approx(3.0) and truth.t_us == 3_000_000


@pytest.mark.parametrize(
    ("pulses", "moves"),
    [(AHEAD, ("north", 1.0)), (TURN, ("yaw", 1.0)), (DOWN, ("down", 1.0)), (NEUTRAL, ("none", 0.0))],
)
def test_ardusubs_axes_move_the_hull_the_right_way(
    tmp_path: Path, pulses: tuple[int, ...], moves: tuple[str, float]
) -> None:
    flown = physics(tmp_path)
    for frame in range(800):
        state = told(flown.answer(packet(frame, pulses)))
    found = {
        "north": state["position"][0],
        "east": state["position"][1],
        "down": state["position"][2] - 3.0,
        "yaw": state["attitude"][2],
    }
    axis, sign = moves
    for name, value in found.items():
        if name == axis:
            assert sign * value > 0.1
        elif name != "down":
            assert abs(value) < 0.05


def test_the_same_frame_again_gets_the_same_answer_and_no_time_passes(tmp_path: Path) -> None:
    flown = physics(tmp_path)
    for frame in range(50):
        answer = flown.answer(packet(frame, AHEAD))
    assert flown.answer(packet(49, DOWN)) == answer
    assert (flown.frames, flown.repeated) == (50, 1)
    assert flown.answer(packet(52, AHEAD)) != answer
    assert flown.missed == 2
    assert flown.answer(b"nonsense") is None and flown.refused == 1


def test_an_ardupilot_that_begins_anew_finds_a_fresh_vehicle(tmp_path: Path) -> None:
    flown = physics(tmp_path)
    first = flown.answer(packet(0, AHEAD))
    for frame in range(1, 400):
        flown.answer(packet(frame, AHEAD))
    assert flown.answer(packet(0, AHEAD)) == first
    assert flown.restarts == 1


def test_a_change_of_rate_changes_the_step(tmp_path: Path) -> None:
    flown = physics(tmp_path)
    flown.answer(packet(0, rate_hz=400))
    assert told(flown.answer(packet(1, rate_hz=1200)))["timestamp"] == pytest.approx(1 / 400 + 1 / 1200)


def test_without_pulses_only_the_other_loads_draw_power(tmp_path: Path) -> None:
    """ArduPilot starts with its servo outputs off, 0 us."""
    power_w = load_vehicle("bluerov2").hotel_power_w
    flown = physics(tmp_path)
    for frame in range(2000):
        flown.answer(packet(frame, (0,) * 6))
    assert flown.truth is not None and not flown.truth.thrust_n.any()
    assert flown.truth.energy_used_j == pytest.approx(power_w * 1e-6 * flown.t_us, rel=0.02)


def test_over_udp_as_a_process(tmp_path: Path) -> None:
    """A scripted peer: what it gets is bit for bit what the same packets give in here."""
    (tmp_path / "still.toml").write_text(STILL, encoding="utf-8")
    command = autopilot_command("physics", str(tmp_path / "still.toml"), "--listen", "127.0.0.1:0", "--json")
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer,
    ):
        assert process.stderr is not None and process.stdout is not None
        port = int(process.stderr.readline().rsplit(":", 1)[1])
        peer.settimeout(60.0)
        answers = []
        peer.sendto(b"not a packet", ("127.0.0.1", port))
        for frame in range(300):
            peer.sendto(packet(frame, AHEAD), ("127.0.0.1", port))
            answers.append(peer.recv(4096))
        process.send_signal(signal.SIGINT)
        printed = json.loads(process.stdout.read())
        assert process.wait() == 0
    here = physics(tmp_path)
    assert answers == [here.answer(packet(frame, AHEAD)) for frame in range(300)]
    assert (printed["frames"], printed["refused"], printed["contacts"]) == (300, 1, 0)
    assert printed["seconds"] == pytest.approx(0.75)
    assert printed["position_m"][0] > 0.1


@pytest.mark.parametrize("listen", ["9002", "127.0.0.1:", "127.0.0.1:x", "127.0.0.1:70000"])
def test_a_place_that_is_none_is_refused(listen: str) -> None:
    done = subprocess.run(
        autopilot_command("physics", "--listen", listen), capture_output=True, text=True, check=False, timeout=600
    )
    assert done.returncode == 1
    assert "write HOST:PORT" in done.stderr
