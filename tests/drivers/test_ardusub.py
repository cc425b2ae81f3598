"""The ArduSub driver against the emulated flight controller, over UDP; time is handed in to both."""

import contextlib
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega

from autopilot.core.errors import ConfigError, DriverError
from autopilot.core.frames import r_ned_from_frd
from autopilot.core.messages import Authority
from autopilot.core.samples import AhrsSample, DepthSample, LeakSample, PowerSample
from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.ardusub import ArduSub, ArduSubOptions
from autopilot.drivers.ardusub_telemetry import ArduSubTelemetry
from autopilot.drivers.devices import read_devices
from autopilot.drivers.links import open_link
from autopilot.estimator.inertial import level
from autopilot.run.children import free_port
from autopilot.sitl.ardusub_vehicle import ArduSubVehicle
from autopilot.sitl.scenario import load_scenario, with_vehicle

TICK_US = 10_000
NEUTRAL = (1500,) * 6
FORWARD = (1600, 1600, 1400, 1400, 1500, 1500)


class Bench:
    """Driver, wire and vehicle."""

    def __init__(self, parameters: dict[str, float] | None = None, directions: tuple[int, ...] | None = None) -> None:
        port = free_port()
        scenario = with_vehicle(load_scenario("open-water"), "bluerov2", "--vehicle")
        vehicle = load_vehicle("bluerov2")
        more: dict[str, Any] = {"parameters": parameters, "directions": directions}
        self.world = ArduSubVehicle(scenario, vehicle, "vectored", seed=3, **more)
        self.below = self.world.controller
        self.driver = ArduSub(vehicle, ArduSubOptions(connect=f"udpin:127.0.0.1:{port}", frame="vectored"))
        self.driver.open()
        self.wire = open_link(f"udpout:127.0.0.1:{port}")
        self.t_us = 0
        self.samples: list[Any] = []
        self.inbox: list[bytes] = []
        """What the driver has said on the last tick."""
        self.armed = False
        self.pulses = NEUTRAL
        self.silent = False
        self.commanding = True
        """Whether the driver gets commands."""
        self.deaf = False
        """Whether what the driver says is lost on the way."""
        self.pilot: Any = self.below.codec(255, 190)

    def close(self) -> None:
        self.driver.close()
        self.wire.close()

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            self.tick()

    def tick(self) -> None:
        self.t_us += TICK_US
        for data in self.world.advance(self.t_us):
            self.wire.send(data)
        self.inbox = []
        if not self.silent:
            self.driver.check(self.t_us)
            self.samples += self.driver.poll(self.t_us)
        if self.commanding and not self.silent:
            self.driver.command(self.t_us, armed=self.armed)
            self.driver.write(self.t_us, self.pulses)
        for received in self.wire.recv(self.t_us):
            self.inbox.append(received.data)
            if not self.deaf:
                self.below.receive(self.t_us, received.data)

    def run_down(self, ticks: int) -> None:
        """Ticks on which the driver may raise."""
        for _ in range(ticks):
            with contextlib.suppress(DriverError):
                self.tick()

    def ready(self) -> None:
        self.run(4.0)
        assert self.state.refusals == ()

    def fly(self, pulses: tuple[int, ...] = FORWARD) -> None:
        self.ready()
        self.armed = True
        self.pulses = pulses
        self.run(2.0)
        assert self.state.acts

    @property
    def state(self) -> Any:
        return self.driver.below(self.t_us)

    @property
    def overrides(self) -> list[Any]:
        """Of the last tick."""
        reader: Any = self.below.codec(1, 1)
        messages = [message for data in self.inbox for message in reader.parse_buffer(data) or ()]
        return [message for message in messages if message.get_type() == "RC_CHANNELS_OVERRIDE"]

    def says(self, message: Any) -> None:
        """The pilot, on a line of his own."""
        self.below.receive(self.t_us, bytes(message.pack(self.pilot)), link=9)

    def set_mode(self, mode: int) -> None:
        self.says(self.pilot.command_long_encode(1, 1, 176, 0, 1, mode, 0, 0, 0, 0, 0))


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.close()


def test_it_measures_what_the_vehicle_does(bench: Bench) -> None:
    bench.run(3.0)
    bench.samples.clear()
    bench.run(2.0)
    truth = bench.world.truth
    ahrs = [sample for sample in bench.samples if isinstance(sample, AhrsSample)]
    depth = [sample for sample in bench.samples if isinstance(sample, DepthSample)]
    power = [sample for sample in bench.samples if isinstance(sample, PowerSample)]
    assert 95 <= len(ahrs) <= 101
    assert 19 <= len(depth) <= 21  # its sensor is read ten times a second
    assert 3 <= len(power) <= 5
    assert np.abs(ahrs[-1].rpy_rad - truth.rpy_rad).max() < 0.06
    assert ahrs[-1].accel_frd_m_s2[2] == pytest.approx(-9.81, abs=0.2)
    assert depth[-1].depth_m == pytest.approx(truth.pos_ned_m[2], abs=0.02)
    assert power[-1].voltage_v == pytest.approx(truth.voltage_v, abs=0.01)
    stamps = np.diff([sample.t_us for sample in ahrs])
    assert stamps.min() > 0
    assert not any(sample.wet for sample in bench.samples if isinstance(sample, LeakSample))


@pytest.mark.parametrize("first", ["RAW_IMU", "ATTITUDE"])
def test_gravity_stays_down_while_it_swings(first: str) -> None:
    """Its accelerations are older than its attitude: by a filter, and by a message when they come after it."""
    telemetry = ArduSubTelemetry(load_vehicle("bluerov2"), density_kg_m3=998.0, depth_sigma_m=0.01, ground_pa=None)
    mav, worst_m_s2, per_s = ardupilotmega, 0.0, 2.5
    for k in range(1, 400):
        t_us = 10_000 * k
        pitch, rate = 0.3 * math.sin(per_s * 1e-6 * t_us), 0.3 * per_s * math.cos(per_s * 1e-6 * t_us)
        before = 0.3 * math.sin(per_s * (1e-6 * t_us - 0.005))
        gravity = [round(1000.0 * part) for part in (math.sin(before), 0.0, -math.cos(before))]
        imu = mav.MAVLink_raw_imu_message(t_us, *gravity, 0, 0, 0, 0, 0, 0)
        attitude = mav.MAVLink_attitude_message(t_us // 1000, 0.0, pitch, 0.0, 0.0, rate, 0.0)
        both = (imu, attitude) if first == "RAW_IMU" else (attitude, imu)
        for sample in (sample for message in both for sample in telemetry.take(t_us, message)):
            assert isinstance(sample, AhrsSample)
            worst_m_s2 = max(worst_m_s2, abs(level(sample).accel_level_m_s2[0]))
    assert worst_m_s2 < 0.02, "gravity by the attitude of then would be 0.04 or 0.11 off"


def test_its_depth_is_that_of_the_pressure_sensor(bench: Bench) -> None:
    bench.ready()
    bench.armed, bench.pulses = True, FORWARD
    apart_m, pitched_m = [], []
    for _ in range(200):
        bench.samples.clear()
        bench.tick()
        truth = bench.world.truth
        behind_m = float(r_ned_from_frd(truth.rpy_rad)[2] @ load_vehicle("bluerov2").depth_sensor.position_frd_m)
        for sample in bench.samples:
            if isinstance(sample, DepthSample):
                apart_m.append(sample.depth_m - float(truth.pos_ned_m[2]) - behind_m)
                pitched_m.append(behind_m)
    assert len(apart_m) >= 15 and np.ptp(pitched_m) > 0.03, "it pitches as it sets off"
    assert np.ptp(apart_m) < 0.02


def test_thrust_goes_ahead_and_comes_out_as_it_was_meant(bench: Bench) -> None:
    bench.fly()
    truth = bench.world.truth
    assert truth.vel_water_frd_m_s[0] > 0.3
    front, rear = truth.thrust_n[:2], truth.thrust_n[2:4]
    assert front[0] == pytest.approx(front[1], abs=0.01) and front[0] > 4.0
    assert rear[0] == pytest.approx(rear[1], abs=0.01) and rear[0] < -3.5
    bench.run(2.0)
    assert bench.driver.mismatch_count == 0
    assert bench.state.problem == ""


@pytest.mark.parametrize("directions", [(1, 1, -1, -1, -1, 1), (-1,) * 6])
def test_motors_that_are_wired_the_other_way_make_no_difference(directions: tuple[int, ...]) -> None:
    speeds = []
    for wired in ((1,) * 6, directions):
        bench = Bench(directions=wired)
        bench.fly()
        bench.run(1.0)
        speeds.append(bench.world.truth.vel_frd_m_s[0])
        assert bench.driver.mismatch_count == 0
        bench.close()
    assert speeds[0] == pytest.approx(speeds[1], abs=0.01)


def test_overrides_go_fifty_times_a_second_and_stop_with_neutral(bench: Bench) -> None:
    bench.fly()
    count = 0
    for _ in range(100):
        bench.tick()
        count += len(bench.overrides)
    assert count == 50
    bench.armed = False
    bench.pulses = NEUTRAL
    bench.tick()
    said = bench.overrides
    assert said and (said[0].chan5_raw, said[0].chan3_raw, said[0].chan7_raw) == (1500, 1500, 65535)
    bench.run(0.5)
    assert not bench.below.armed
    bench.tick()
    bench.tick()
    assert not bench.overrides  # a pilot has his channels for himself


def test_a_mode_switch_takes_the_vehicle_within_a_tick_and_gives_it_back(bench: Bench) -> None:
    bench.fly()
    bench.set_mode(0)
    bench.tick()
    assert bench.state.authority is Authority.PILOT
    assert bench.state.text == "STABILIZE"
    assert not bench.state.acts
    assert [message.chan5_raw for message in bench.overrides] == [1500]
    for _ in range(100):
        bench.tick()
        assert not bench.overrides
        bench.says(bench.pilot.manual_control_encode(1, 300, 0, 500, 0, 0))
    assert bench.below.armed
    bench.set_mode(19)
    bench.tick()
    assert bench.state.authority is Authority.OURS
    bench.run(0.2)
    assert bench.state.acts
    assert bench.overrides or bench.tick() is None
    assert bench.driver.mismatch_count < 10


def test_disarmed_below_is_told_and_not_undone(bench: Bench) -> None:
    bench.fly()
    bench.says(bench.pilot.command_long_encode(1, 1, 400, 0, 0, 0, 0, 0, 0, 0, 0))
    bench.run(0.03)
    assert bench.state.authority is Authority.STOPPED
    bench.run(2.0)
    assert not bench.below.armed
    bench.armed = False
    bench.run(0.5)
    bench.armed = True
    bench.run(1.5)
    assert bench.below.armed  # asked for anew


@pytest.mark.parametrize("later_s", [1.5, 6.0], ids=["soon", "late"])
@pytest.mark.parametrize("rearmed", [False, True])
@pytest.mark.parametrize("ours", [False, True], ids=["told", "untold"])
def test_disarmed_below_in_a_pilots_mode_it_is_not_armed_again(
    bench: Bench, later_s: float, rearmed: bool, ours: bool
) -> None:
    bench.fly()
    bench.set_mode(2)
    bench.run(0.2)
    bench.says(bench.pilot.command_long_encode(1, 1, 400, 0, 0, 0, 0, 0, 0, 0, 0))
    bench.run(0.03)
    assert bench.state.authority is Authority.STOPPED
    assert bench.state.text == "disarmed by pilot or failsafe"
    bench.armed = ours  # the service disarms with it; the driver does not depend on that
    if rearmed:
        bench.says(bench.pilot.command_long_encode(1, 1, 400, 0, 1, 21196, 0, 0, 0, 0, 0))
    bench.run(later_s)
    bench.set_mode(19)
    bench.run(7.0)
    assert bench.below.armed is rearmed
    assert bench.below.servos_us == NEUTRAL and not bench.overrides
    assert not bench.state.acts


def test_a_process_that_dies_leaves_the_thrusters_to_its_failsafe(bench: Bench) -> None:
    bench.fly()
    assert bench.below.servos_us != NEUTRAL
    bench.silent = True
    bench.run(0.55)
    assert bench.below.servos_us == NEUTRAL


def test_handed_back_it_stays_armed_and_is_taken_anew_by_a_new_arming(bench: Bench) -> None:
    bench.fly()
    bench.armed = False
    bench.tick()
    bench.driver.hand_back(bench.t_us)
    bench.run(0.2)
    assert bench.below.armed and bench.below.servos_us == NEUTRAL
    bench.run(1.0)
    assert bench.below.armed and not bench.overrides
    bench.armed = True
    bench.run(1.5)
    assert bench.below.servos_us != NEUTRAL


def test_closing_leaves_it_neutral_and_disarmed(bench: Bench) -> None:
    bench.fly()
    bench.driver.close()
    bench.silent = True
    bench.run(0.05)
    assert bench.below.servos_us == NEUTRAL
    assert not bench.below.armed


def test_commands_that_stop_coming_are_stopped_by_the_driver(bench: Bench) -> None:
    bench.fly()
    bench.commanding = False
    bench.run(0.6)
    assert bench.below.servos_us == NEUTRAL


WRONG = [
    (
        ("FRAME_CONFIG", 2.0, "FRAME_CONFIG = 2: set 1"),
        ("FS_PILOT_INPUT", 0.0, "FS_PILOT_INPUT = 0: set 1"),
        ("FS_PILOT_TIMEOUT", 3.0, "FS_PILOT_TIMEOUT = 3: set 0.4"),
        ("MOT_FV_CPLNG_K", 1.0, "MOT_FV_CPLNG_K = 1: set 0"),
        ("RC_PROTOCOLS", 1.0, "RC_PROTOCOLS = 1: set 0, else thrust goes on without us"),
        ("RC_OVERRIDE_TIME", -1.0, "RC_OVERRIDE_TIME = -1: set 3"),
        ("RC_OPTIONS", 34.0, "RC_OPTIONS = 34: set it without 2"),
        ("FS_THR_ENABLE", 2.0, "FS_THR_ENABLE = 2: set 0"),
        ("RC3_OPTION", 153.0, "RC3_OPTION = 153: set 0"),
        ("RCMAP_YAW", 1.0, "RCMAP_YAW = 1: set 4"),
        ("SERVO6_FUNCTION", 59.0, "SERVO6_FUNCTION = 59: set 38"),
        ("MAV_GCS_SYSID_HI", 258.0, "it obeys systems 255 to 258: set MAV_GCS_SYSID_HI 0"),
        ("RC5_TRIM", 1520.0, "RC5_TRIM = 1520: set 1500"),
        ("RC3_REVERSED", 1.0, "RC3_REVERSED = 1: set 0"),
    ),
    (
        ("RC_OVERRIDE_TIME", 0.0, "RC_OVERRIDE_TIME = 0: set 3"),
        ("MAV_GCS_SYSID", 254.0, "it obeys system 254: set MAV_GCS_SYSID 255"),
    ),
]


@pytest.mark.parametrize("wrong", WRONG)
def test_a_parameter_that_thrust_depends_on_refuses_arming(wrong: tuple[tuple[str, float, str], ...]) -> None:
    bench = Bench({name: value for name, value, _ in wrong})
    bench.run(5.0)
    refusals = bench.state.refusals
    assert len(refusals) == len(wrong)
    for name, value, text in wrong:
        assert [line for line in refusals if text in line], text
        assert bench.below.parameters[name] == value  # never written
    bench.close()


@pytest.mark.parametrize(
    ("every", "y", "overrides"),
    [(1, 800, False), (2, 300, True), (4, 0, False), (4, -800, True), (5, 0, True), (5, 500, False)],
)
def test_a_second_sender_is_noticed_within_fifteen_reports(bench: Bench, every: int, y: int, overrides: bool) -> None:
    bench.fly()
    noticed = None
    for turn in range(150):
        bench.tick()
        if noticed is None and bench.state.rival:
            noticed = turn
        if turn % every == 0:  # 100 to 20 times a second; a centred stick, too: the last of two senders wins
            pulses = (1500, 1500, 1500, 1500, 1500, 1500 + round(0.2 * y), 65535, 65535)
            override = bench.pilot.rc_channels_override_encode(1, 1, *pulses)
            bench.says(override if overrides else bench.pilot.manual_control_encode(1, 0, y, 500, 0, 0))
        assert bench.state.problem == ""
    assert noticed is not None and noticed <= 32  # reports come on every second tick, and one more on the way
    assert bench.state.rival
    bench.run(1.1)
    assert not bench.state.rival


@pytest.mark.parametrize(("late", "slow"), [(3, False), (10, True), (30, False), (44, True), (60, False), (100, True)])
def test_reports_and_commands_that_come_in_bunches_are_no_second_sender(bench: Bench, late: int, slow: bool) -> None:
    bench.fly()
    if slow:  # what its depth hold leaves behind
        bench.set_mode(2)
        bench.run(1.0)
        bench.set_mode(19)
    for turn in range(900):  # thrust changes all the time, and the loop stands for up to a second again and again
        push, up = 40 * (turn // 7 % 5), 30 * (turn // 9 % 4)
        bench.pulses = (1500 + push, 1500 + push, 1500 - push, 1500 - push, 1500 + up, 1500 + up)
        bench.silent = turn % 150 < late
        bench.tick()
        assert not bench.state.rival and bench.state.problem == ""


def test_neutral_outputs_for_want_of_our_commands_are_no_second_sender(bench: Bench) -> None:
    bench.fly()
    bench.deaf = True  # its failsafe makes them neutral
    for _ in range(100):
        bench.tick()
        assert not bench.state.rival
    assert "motor" in bench.state.problem


@pytest.mark.parametrize("holds_depth", [False, True])
def test_heave_that_depth_hold_has_left_slow_is_no_joystick(bench: Bench, holds_depth: bool) -> None:
    bench.fly()
    bench.set_mode(2 if holds_depth else 0)
    bench.run(1.0)
    bench.set_mode(19)
    seen = set()
    for turn in range(300):
        up, roll = 90 * (turn // 10 % 2), 35 * (turn // 4 % 3 - 1)  # roll beside it is not filtered
        bench.pulses = (*FORWARD[:4], 1500 + up + roll, 1500 + up - roll)
        bench.tick()
        assert bench.state.problem == "" and not bench.state.rival
        seen.add(bench.below.servos_us[4])
    assert (len(seen) > 10) == holds_depth
    # What a joystick does is noticed all the same, in the plane and upright.
    for x, z in ((800, 500), (0, 900)):
        bench.pulses = FORWARD
        bench.run(1.0)
        for _ in range(150):
            bench.tick()
            bench.says(bench.pilot.manual_control_encode(1, x, 0, z, 0, 0))
        assert bench.state.rival


def test_disarming_by_us_is_no_news_of_a_lost_pilot(bench: Bench) -> None:
    bench.fly()
    bench.armed = False
    bench.run(2.0)
    assert not any("Lost manual" in text for _, text in bench.driver.take_notices())
    bench.fly()
    bench.silent = True  # ours has died: that it has to say
    bench.run(0.7)
    bench.silent = False
    bench.run(0.5)
    assert any("Lost manual" in text for _, text in bench.driver.take_notices())


@pytest.mark.parametrize("directions", [(1, 1, 1, 1, 1, 1), (-1, 1, -1, 1, 1, -1)])
def test_what_its_pilot_does_is_told_as_pulses_of_ours(directions: tuple[int, ...]) -> None:
    bench = Bench(directions=directions)
    bench.fly()
    bench.set_mode(0)
    for _ in range(50):
        bench.tick()
        bench.says(bench.pilot.manual_control_encode(1, 400, 0, 300, 0, 0))
    moved = [pulse - 1500 for pulse in bench.state.pulses_us]
    assert not bench.state.acts
    # Half gain: 80 us ahead, the rear thrusters of the file push aft; 80 us down.
    assert moved == [80, 80, -80, -80, 80, 80]
    bench.below.mute = True
    bench.run(0.6)
    assert bench.state.pulses_us == ()
    bench.close()


def test_a_pressure_that_is_sent_again_is_no_new_measurement(bench: Bench) -> None:
    bench.ready()
    bench.below.pressure_hz = 10.0  # what is sent is asked for twenty times a second
    bench.samples.clear()
    bench.run(3.0)
    depths = [sample.depth_m for sample in bench.samples if isinstance(sample, DepthSample)]
    assert 25 <= len(depths) <= 33
    assert len(set(depths)) == len(depths)
    bench.below.pressure_hz = 0.01  # a sensor that stands is still heard of, twice a second
    bench.run(0.2)
    bench.samples.clear()
    bench.run(3.0)
    assert 5 <= sum(isinstance(sample, DepthSample) for sample in bench.samples) <= 7


def test_a_cable_that_is_off_and_on_again(bench: Bench) -> None:
    bench.fly()
    bench.below.mute = True
    with pytest.raises(DriverError, match="silent: check cable"):
        bench.run(1.0)
    bench.wire.recv(bench.t_us)
    bench.run_down(50)
    reader: Any = bench.below.codec(1, 1)
    sent = [message for item in bench.wire.recv(bench.t_us) for message in reader.parse_buffer(item.data) or ()]
    pulses = [message.chan5_raw for message in sent if message.get_type() == "RC_CHANNELS_OVERRIDE"]
    assert pulses == [1500] * len(pulses) and len(pulses) <= 3
    assert bench.state.refusals == ("flight controller is silent: check cable and link",)
    assert not bench.state.acts
    bench.below.mute = False
    bench.armed = False
    bench.run(2.0)
    assert bench.state.refusals == ()


@pytest.mark.parametrize("opened_anew", [False, True])
def test_after_a_silence_nothing_is_sent_before_it_is_known_whose_it_is(bench: Bench, opened_anew: bool) -> None:
    bench.fly()
    bench.below.mute = True
    bench.run_down(70)  # its switch is not heard
    bench.below._set_mode(0)
    bench.run_down(1)
    if opened_anew:
        bench.driver.close()
        bench.driver.open()
    bench.wire.recv(bench.t_us)  # lost on the way
    bench.below.mute = False
    sent: list[Any] = []
    for _ in range(10):
        with contextlib.suppress(DriverError):  # until its first message
            bench.tick()
        sent += bench.overrides
    assert all(message.chan5_raw == 1500 for message in sent)
    assert len(sent) <= 1
    assert bench.state.authority is Authority.PILOT  # asked for, not waited for: heartbeats come once a second
    assert bench.below.armed
    bench.set_mode(19)
    bench.run(0.2)
    assert bench.state.acts


def test_a_pilot_has_it_through_a_silence(bench: Bench) -> None:
    bench.fly()
    bench.set_mode(0)
    bench.run(0.1)
    bench.below.mute = True
    for _ in range(100):
        bench.run_down(1)
        assert bench.state.authority is Authority.PILOT
    bench.driver.close()
    assert bench.state.authority is Authority.PILOT
    bench.driver.open()
    bench.below.mute = False
    for _ in range(50):
        bench.tick()
        assert bench.state.authority is Authority.PILOT


def test_a_device_that_is_opened_anew_after_a_silence_is_not_disarmed(bench: Bench) -> None:
    bench.fly()
    bench.below.mute = True
    bench.run_down(70)
    bench.driver.close()
    bench.below.mute = False  # what was on its way arrives after all
    for received in bench.wire.recv(bench.t_us):
        bench.below.receive(bench.t_us, received.data)
    assert bench.below.armed
    bench.driver.open()


def test_junk_on_the_line_is_counted(bench: Bench) -> None:
    bench.ready()
    rng = np.random.default_rng(1)
    for _ in range(200):
        bench.wire.send(rng.integers(0, 256, size=int(rng.integers(1, 60)), dtype=np.uint8).tobytes())
        bench.tick()
    bench.run(1.0)
    assert bench.state.refusals == ()
    assert bench.state.authority is Authority.OURS


def test_options_are_checked_by_name() -> None:
    def refused(**table: Any) -> str:
        with pytest.raises(ConfigError) as refusal:
            read_devices({"flight_controller": {"driver": "ardusub", **table}}, "rov.toml")
        return str(refusal.value)

    assert "`connect`" in refused(frame="vectored")
    assert "$.devices.flight_controller.frame" in refused(connect="udpin:127.0.0.1:1", frame="hexa")
    assert "`spede`" in refused(connect="udpin:127.0.0.1:1", frame="vectored", spede=1)
    with pytest.raises(ConfigError, match="both `thrusters` and `flight_controller`"):
        read_devices(_both(), "rov.toml")


def _both() -> dict[str, dict[str, Any]]:
    from autopilot.drivers.registry import backend_names

    outputs = backend_names("thrusters")
    if not outputs:
        pytest.skip("no thruster output is registered")
    return {
        "flight_controller": {"driver": "ardusub", "connect": "udpin:127.0.0.1:1", "frame": "vectored"},
        "thrusters": {"driver": outputs[0]},
    }
