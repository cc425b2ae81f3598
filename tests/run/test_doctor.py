"""The doctor on the emulated BlueROV2, in lockstep: every obstacle to arming is generated, found and named."""

import dataclasses
import importlib
import json
import os
import pty
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from autopilot.cli.console_output import print_table
from autopilot.cli.doctor_command import doctor as command
from autopilot.command import failsafes
from autopilot.command.failsafe_table import ROWS
from autopilot.core.messages import Failsafe, Outputs
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.drivers.ardusub_settings import RULES
from autopilot.drivers.links import open_link
from autopilot.mission.plan_files import write_plan
from autopilot.run.children import free_port
from autopilot.run.config import gather, vehicle_defaults
from autopilot.run.demo import paper_plan
from autopilot.run.doctor import examine
from autopilot.run.doctor_computer import CONTROL_S, FLOWN_S, FlightTests
from autopilot.run.findings import Finding, FindingSeverity
from autopilot.run.neutral_time import measure
from autopilot.run.vehicle_config import VehicleConfig, load_config
from autopilot.sitl.ardusub_vehicle import ArduSubVehicle
from autopilot.sitl.scenario import load_scenario, with_vehicle

DIALECT: Any = importlib.import_module("pymavlink.dialects.v20.development")


class Bench:
    """A BlueROV2 with ArduSub in the paper's tank, a tracking system, and a configuration file."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.below_port, self.port = free_port(), free_port()
        self.options: dict[str, object] = {"frame": "vectored", "connect": f"udpin:127.0.0.1:{self.below_port}"}
        self.parameters: dict[str, float] = {}
        self.planned = True
        scenario = with_vehicle(load_scenario("paper-tank"), "bluerov2", "--vehicle")
        self.place = {"origin_lat_deg": scenario.origin.lat_deg, "origin_lon_deg": scenario.origin.lon_deg}
        self.world = ArduSubVehicle(scenario, load_vehicle("bluerov2"), "vectored", seed=1)
        self.below = self.world.controller
        self.tracked = True
        self.shift_m = 0.0
        """So far to the north of where it is it is reported."""
        self.drops: frozenset[str] = frozenset()
        """Messages of the flight controller that do not arrive."""
        self.changes: list[Callable[[Any], None]] = []
        """What becomes of the others on the way."""
        self.others: Callable[[int], list[bytes]] = lambda t_us: []
        """What somebody else sends on our link."""
        self.beside: Callable[[int], list[bytes]] = lambda t_us: []
        """And on that to the flight controller."""
        self._wire = open_link(f"udpout:127.0.0.1:{self.below_port}")
        self._client = open_link(f"udpout:127.0.0.1:{self.port}")
        self._reader = self.below.codec(1, 1)
        self.overrides: list[tuple[int, ...]] = []

    @property
    def config(self) -> VehicleConfig:
        """The file, read."""
        lines = ['vehicle = "bluerov2"', "[service]", 'state_dir = "state"', 'log_dir = "logs"', "[place]"]
        lines += [f"{name} = {value}" for name, value in self.place.items()]
        lines += ["[parameters]", *(f"{name} = {value}" for name, value in self.parameters.items())]
        lines += ["[devices.flight_controller]", 'driver = "ardusub"']
        lines += [f"{name} = {json.dumps(value)}" for name, value in self.options.items()]
        path = self.folder / "rov.toml"
        path.write_text("\n".join(lines))
        return load_config(str(path))

    def plan(self) -> Path:
        """The paper's mission and fence."""
        path = self.folder / "paper.plan"
        write_plan(path, paper_plan(1))
        return path

    def look(self, seconds: float = 2.0, flying: FlightTests | None = None) -> list[Finding]:
        """What the doctor finds."""
        config = self.config
        given: dict[str, object] = {"connect": (f"udpin:127.0.0.1:{self.port}",)}
        if self.planned:
            given["plan"] = str(self.plan())
        settings = gather(vehicle_defaults(0), given, {}, file=config.file.service.given(self.folder))
        return examine(config, settings, seconds, speed=0.0, on_tick=self._tick, flying=flying)

    def measured(self) -> Finding:
        """How long thrust goes on in silence."""
        return measure(self.config, speed=0.0, on_step=self.world_goes_on)

    def _tick(self, outputs: Outputs) -> None:
        assert not outputs.mode.armed
        t_us = outputs.t_us
        self.world_goes_on(t_us)
        pose = self._pose(t_us)
        for data in ([pose] if pose is not None and self.tracked else []) + self.others(t_us):
            self._client.send(data)
        self._client.recv(t_us)

    def _pose(self, t_us: int) -> bytes | None:
        """What the tracking system sends."""
        pose = self.world.pose(t_us)
        if pose is None or not self.shift_m:
            return pose
        message = self._reader.decode(bytearray(pose))
        message.x += self.shift_m
        return bytes(message.pack(self.below.codec(200, 197)))

    def world_goes_on(self, t_us: int) -> None:
        """Water, vehicle and flight controller."""
        for received in self._wire.recv(t_us):
            self.below.receive(t_us, received.data)
        for data in (*self.world.advance(t_us), *self.beside(t_us)):
            message = self._reader.decode(bytearray(data))
            if message.get_type() in self.drops:
                continue
            for change in self.changes:
                change(message)
            self._wire.send(bytes(message.pack(self.below.codec(message.get_srcSystem(), message.get_srcComponent()))))

    def close(self) -> None:
        """Let go."""
        self._wire.close()
        self._client.close()


@pytest.fixture
def bench(tmp_path: Path) -> Any:
    made = Bench(tmp_path)
    yield made
    made.close()


Make = Callable[[Bench], object]


def of(findings: list[Finding], what: str) -> list[Finding]:
    return [finding for finding in findings if finding.what == what]


def failed(findings: list[Finding]) -> list[str]:
    return [f"{one.what}: {one.found}: {one.remedy}" for one in findings if one.verdict is FindingSeverity.FAIL]


def sets(name: str, value: float) -> Callable[[Bench], None]:
    """A parameter of ours."""
    return lambda bench: bench.parameters.update({name: value})


def below_sets(name: str, value: float) -> Callable[[Bench], None]:
    """A parameter of the flight controller."""
    return lambda bench: bench.below.parameters.update({name: value})


def attribute(name: str, value: object, *, below: bool = False) -> Callable[[Bench], None]:
    return lambda bench: setattr(bench.below if below else bench, name, value)


def changing(kind: str, **fields: object) -> Callable[[Bench], None]:
    """Fields of a message of the flight controller that are others."""

    def change(message: Any) -> None:
        if message.get_type() == kind:
            for name, value in fields.items():
                setattr(message, name, value)

    return lambda bench: bench.changes.append(change)


def test_all_good_would_arm(bench: Bench) -> None:
    findings = bench.look()
    assert {finding.verdict for finding in findings} == {FindingSeverity.OK}, findings
    assert of(findings, "arming")[0].found == "would be accepted"
    assert of(findings, "position")[0].found.startswith("good, from external")
    assert of(findings, "fence")[0].found != "0 items" and of(findings, "plan")[0].found != "0 items"


OBSTACLES: dict[str, list[tuple[Make, str]]] = {
    "no position, no attitude": [
        (attribute("tracked", False), "no position"),
        (attribute("drops", frozenset({"ATTITUDE", "RAW_IMU"})), "AHRS is silent"),
    ],
    "flight controller mute": [(attribute("mute", True, below=True), "flight controller is silent")],
    "what the flight controller says and what ours finds": [
        (attribute("mode", 2, below=True), "pilot has it in ALT_HOLD: switch it to MANUAL"),
        (attribute("wet", True, below=True), "water in the hull"),
        (sets("FS_BATT_LOW", 1.0), "battery at"),
        (lambda bench: bench.parameters.update(THR5_HEALTH=0.0, THR6_HEALTH=0.0), "THRn_HEALTH"),
        (
            attribute("objection", "Leak detector fails", below=True),
            "checks fail, Leak detector fails: fix",
        ),
        (attribute("shift_m", 40.0), "outside the fence"),
        (below_sets("FRAME_CONFIG", 2.0), "FRAME_CONFIG = 2: set 1"),
        (below_sets("MAV_GCS_SYSID", 254.0), "it obeys system 254: set MAV_GCS_SYSID 255"),
    ],
    "depth band empty": [(sets("DEPTH_MIN", 3.0), "depth band"), (attribute("planned", False), "")],
}
"""What makes arming impossible, and words of what is said of each."""


@pytest.mark.parametrize("name", OBSTACLES)
def test_every_obstacle_to_arming_is_found_and_named(bench: Bench, name: str) -> None:
    for make, _ in OBSTACLES[name]:
        make(bench)
    findings = bench.look(2.0)
    reasons = of(findings, "arming")
    assert all(reason.verdict is FindingSeverity.FAIL and reason.remedy for reason in reasons), findings
    for _, words in OBSTACLES[name]:
        assert any(words in f"{reason.found}: {reason.remedy}" for reason in reasons), (words, reasons)
    assert all(finding.remedy for finding in findings if finding.verdict is not FindingSeverity.OK), findings


def test_every_parameter_of_the_flight_controller_that_forbids_arming_is_named(bench: Bench) -> None:
    wrong = {rule.name: next(value for value in (-777.0, 777.0) if not rule.fits(value)) for rule in RULES}
    bench.below.parameters.update(wrong)
    told = "\n".join(f"{reason.found}: {reason.remedy}" for reason in of(bench.look(1.0), "arming"))
    for rule in RULES:
        assert f"{rule.name} = {wrong[rule.name]:g}: set {rule.wanted}" in told


def test_every_failsafe_that_forbids_arming_is_in_the_doctors_mouth(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The conditions are forced, the texts are the table's: the doctor has no list of its own, and asks for a check
    that nobody has thought of here."""

    def forced(row: Any, words: str) -> Any:
        return dataclasses.replace(
            row, level=lambda c, s: 1.0, enter=0.5, below=False, zero_is_off=False, arming=f"{words}: undo it"
        )

    words = [f"{row.rule.name} made up" for row in ROWS if row.arming]
    rows = [forced(row, f"{row.rule.name} made up") if row.arming else row for row in ROWS]
    new = forced(dataclasses.replace(ROWS[0], rule=Failsafe(max(Failsafe))), "sea serpent")
    monkeypatch.setattr(failsafes, "ROWS", (*rows, new))
    assert [one.found for one in of(bench.look(1.0), "arming")] == [*words, "sea serpent"]


IMPLAUSIBLE: dict[str, dict[str, tuple[Make, str]]] = {
    "nothing, much": {
        "depth": (changing("SCALED_PRESSURE2", press_abs=0.0), "-10.35"),
        "battery": (changing("BATTERY_STATUS", voltages=[33_000, 33_000, *([65535] * 8)]), "66.0 V"),
        "attitude": (changing("RAW_IMU", xacc=0, yacc=0, zacc=0), "9.81"),
    },
    "much, nothing": {
        "depth": (changing("SCALED_PRESSURE2", press_abs=50_000.0), "can be true"),
        "battery": (changing("BATTERY_STATUS", voltages=[3_000, *([65535] * 9)]), "3.0 V"),
        "attitude": (attribute("drops", frozenset({"RAW_IMU", "ATTITUDE"})), "0.0 Hz"),
    },
}
"""What is measured -> what spoils it, and words of what is said of that."""


@pytest.mark.parametrize("name", IMPLAUSIBLE)
def test_what_cannot_be_true_is_named(bench: Bench, name: str) -> None:
    for make, _ in IMPLAUSIBLE[name].values():
        make(bench)
    findings = bench.look(3.0)
    for what, (_, words) in IMPLAUSIBLE[name].items():
        bad = [one for one in of(findings, what) if one.verdict is FindingSeverity.FAIL]
        assert bad and words in f"{bad[0].found} {bad[0].remedy}" and bad[0].remedy, what


def test_what_the_flight_controller_does_not_measure_is_a_warning(bench: Bench) -> None:
    bench.drops = frozenset({"SCALED_PRESSURE2", "BATTERY_STATUS"})
    findings = bench.look(3.0)
    for what, words in (("depth", "SCALED_PRESSURE2"), ("battery", "BATTERY_STATUS")):
        found = of(findings, what)[0]
        assert found.verdict is FindingSeverity.WARN and words in found.remedy


def test_a_depth_that_repeats_itself_is_a_warning(bench: Bench) -> None:
    changing("SCALED_PRESSURE2", press_abs=1050.0)(bench)
    found = of(bench.look(3.0), "depth")[0]
    assert found.verdict is FindingSeverity.WARN and "repeats itself" in found.remedy


def test_what_is_not_on_board_is_a_warning(bench: Bench) -> None:
    bench.planned, bench.place = False, {}
    findings = bench.look(1.0)
    for what in ("origin", "fence", "plan"):
        found = of(findings, what)[0]
        assert found.verdict is FindingSeverity.WARN and found.remedy, what


@pytest.mark.parametrize(
    ("connect", "words", "never"),
    [
        ("udpin:127.0.0.1:{port}", "UDP port {port}", "baud"),
        ("udpout:127.0.0.1:{port}", "127.0.0.1:{port} (UDP) does not answer", "baud"),
        ("tcpin:127.0.0.1:{port}", "TCP port {port}", "baud"),
        ("serial:{line}:57600", "57600 baud", "firewall"),
    ],
)
def test_a_silent_device_is_looked_for_where_it_is_connected(
    bench: Bench, connect: str, words: str, never: str
) -> None:
    leader, follower = pty.openpty()
    port = free_port()
    bench.options["connect"] = connect.format(port=port, line=os.ttyname(follower))
    try:
        findings = bench.look(4.0)
    finally:
        os.close(leader)
        os.close(follower)
    device, slow = of(findings, "Flight controller")[0], of(findings, "attitude")[0]
    assert device.found == "silent" and words.format(port=port) in device.remedy
    assert never not in device.remedy + slow.remedy and slow.verdict is FindingSeverity.FAIL


def test_a_wrong_system_id_is_told_with_the_one_that_is_heard(bench: Bench) -> None:
    bench.options["system"] = 7
    findings = bench.look(4.0)
    told = [f"{reason.found}: {reason.remedy}" for reason in of(findings, "arming")]
    assert any("system 1 is heard, 7 expected: set `system` = 1" in text for text in told)
    device = of(findings, "Flight controller")[0]
    assert device.verdict is FindingSeverity.FAIL and "system 1 is heard" in device.found
    assert "`system`" in device.remedy and not {"power", "firewall"} & set(device.remedy.split())


def test_who_speaks_is_named_and_nobody_can_arm_it(bench: Bench) -> None:
    """Two ground stations, both steer, one orders; another vehicle of our id; a rival at the flight controller."""
    first, second, redundant_one = (bench.below.codec(system, 190) for system in (255, 254, 1))
    redundant_one.srcComponent = 1
    order = DIALECT.MAVLink_command_long_message(1, 1, 400, 0, 1, 21196, 0, 0, 0, 0, 0)

    def others(t_us: int) -> list[bytes]:
        if t_us % 500_000:
            return []
        beat = DIALECT.MAVLink_heartbeat_message
        sent = [
            (first, beat(6, 8, 0, 0, 4, 3)),
            (second, beat(6, 8, 0, 0, 4, 3)),
            (redundant_one, beat(12, 12, 0, 0, 4, 3)),
        ]
        stick = DIALECT.MAVLink_manual_control_message
        sent += [(first, stick(1, 500, 0, 500, 0, 0)), (second, stick(1, 500, 0, 500, 0, 0)), (first, order)]
        return [bytes(message.pack(codec)) for codec, message in sent]

    def beside(t_us: int) -> list[bytes]:
        rival = bench.below.codec(255, 191)
        return [] if t_us % 500_000 else [bytes(rival.heartbeat_encode(6, 8, 0, 0, 4).pack(rival))]

    bench.others, bench.beside = others, beside
    findings = bench.look()
    told = {f"{one.verdict.value} {one.found}" for one in of(findings, "who speaks")}
    assert sum(line.startswith("ok ground station: system 25") for line in told) == 2, told
    assert any(line.startswith("fail another vehicle is system 1 at") for line in told)
    assert sum("steers (MANUAL_CONTROL)" in line and line.startswith("warn") for line in told) == 2
    assert any("255/191 speaks to it, too" in one.found for one in of(findings, "Flight controller"))
    assert not bench.below.armed and of(findings, "arming")[0].found == "would be accepted"


def test_nothing_that_is_kept_is_touched_and_damage_is_found(bench: Bench) -> None:
    state = bench.folder / "state" / "bluerov2-0"
    state.mkdir(parents=True)
    (state / "plans.json").write_text("{ damaged")
    bench.planned = False
    bench.look(1.0)
    assert [path.name for path in state.iterdir()] == ["plans.json"]
    assert (state / "plans.json").read_text() == "{ damaged"
    assert list((bench.folder / "logs").iterdir()) == []


@pytest.mark.parametrize(
    ("timeout_s", "verdict"), [(0.4, FindingSeverity.OK), (0.5, FindingSeverity.OK), (3.0, FindingSeverity.FAIL)]
)
def test_silence_to_neutral_is_measured(bench: Bench, timeout_s: float, verdict: FindingSeverity) -> None:
    bench.below.parameters["FS_PILOT_TIMEOUT"] = timeout_s
    found = bench.measured()
    assert found.verdict is verdict, found
    assert float(found.found.split()[0]) == pytest.approx(timeout_s, abs=0.05)
    assert not bench.below.armed and set(bench.below.servos_us) == {1500}


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda bench: bench.below.parameters.update(FS_PILOT_INPUT=0.0, FS_GCS_ENABLE=0.0), "more than 10 s"),
        (below_sets("MAV_GCS_SYSID", 254.0), "no thrust comes out"),
        (attribute("mode", 0, below=True), "not in MANUAL"),
        (attribute("mute", True, below=True), "silent"),
        (attribute("armed", True, below=True), "armed already"),
    ],
)
def test_what_keeps_silence_from_being_measured_is_named(
    bench: Bench, make: Callable[[Bench], None], words: str
) -> None:
    make(bench)
    bench.below._shown_armed = armed_before = bench.below.armed
    found = bench.measured()
    assert found.verdict is FindingSeverity.FAIL and words in found.found and found.remedy
    assert bench.below.armed is armed_before


def test_what_to_do_is_shown_whole(capsys: pytest.CaptureFixture[str]) -> None:
    """Names of tables of the file in square brackets are no markup."""
    print_table("Doctor", ("what", "to do"), [("origin", "set it in [place]"), ("system", "[devices]")])
    shown = capsys.readouterr().out
    assert "[place]" in shown and "[devices]" in shown


def test_thrusters_turn_only_after_asking(bench: Bench) -> None:
    assert bench.config.path.exists()
    given = ["--config", str(bench.config.path), "--measure-neutral"]
    done = CliRunner().invoke(command, given, input="n\n")
    assert done.exit_code == 1 and "propellers off" in done.output and "Doctor" not in done.output


class Flights:
    """Count what is flown."""

    def __init__(self) -> None:
        self.steps, self.costs, self.closed = 0, list[int](), 0

    def start(self, vehicle: Vehicle, cost: int) -> "Flights":
        self.costs.append(cost)
        return self

    def step(self) -> None:
        self.steps += 1

    def close(self) -> None:
        self.closed += 1

    def horizons(self, vehicle: Vehicle) -> dict[float, float]:
        return {8.0: 1.0}


def test_flights_go_on_beside_the_service_and_change_nothing_else(bench: Bench) -> None:
    flights = Flights()
    found = {f.what: f.found for f in bench.look(flying=flights)}
    assert (flights.costs, flights.closed) == ([0, 1], 2)
    assert flights.steps == 2 * round(FLOWN_S / CONTROL_S), "as many as the ticks call for"
    assert {"computer", "in flight", "at most"} <= set(found)
    assert found["attitude"].startswith("50."), "what comes during the flights is not counted"
