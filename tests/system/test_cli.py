"""The command line: bad input gets one line on stderr that names the thing and the remedy, and leaves nothing."""

import json
import re
import shutil
import signal
import socket
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import click
import pytest
from plan_text import PILLARS, WORKSPACE, pillar, waypoint
from pymavlink.dialects.v20 import development as mav
from system_harness import PAPER_PLAN, ROOT, OpenSession, RunningService
from wire_client import Harbour, WireClient

from autopilot.cli.main import cli, run
from autopilot.core.param_file import scan_param_file
from autopilot.run.children import Child, autopilot_command, free_port

TANK = (ROOT / "sitl/scenarios/paper-tank.toml").read_text()
VEHICLE = (ROOT / "autopilot/data/vehicles/lbv150.toml").read_text()
NOBODY = "udpout:127.0.0.1:9"
"""Nobody listens on the discard port."""


@dataclass(frozen=True)
class Done:
    code: int
    out: str
    err: str


Command = Callable[..., Done]


@pytest.fixture
def autopilot(tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Iterator[Command]:
    """``autopilot ARGUMENTS`` in an empty folder, with state and logs in ``tmp_path``."""
    monkeypatch.setenv("AUTOPILOT_STATE_DIR", str(tmp_path / "state"))
    monkeypatch.setenv("AUTOPILOT_LOG_DIR", str(tmp_path / "logs"))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    interval = sys.getswitchinterval()

    def call(*arguments: str) -> Done:
        capfd.readouterr()
        code = run(lambda: cli(list(arguments), prog_name="autopilot", standalone_mode=False))
        out, err = capfd.readouterr()
        return Done(code, out, err)

    yield call
    sys.setswitchinterval(interval)
    for number, handler in handlers.items():
        signal.signal(number, handler)


def _files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def _assert_refused(done: Done, *named: str, code: int = 1) -> None:
    assert done.code == code
    lines = done.err.splitlines()
    assert len(lines) == 1, done.err
    assert lines[0].startswith("error: ")
    assert any(word in lines[0] for word in (";", "check", "use", "write")), f"no remedy in {lines[0]!r}"
    for word in named:
        assert word in lines[0], lines[0]


def _assert_warned(done: Done, *named: str) -> None:
    (line,) = done.err.splitlines()
    assert line.startswith("warning: ")
    for word in named:
        assert word in line, line


def _sitl(autopilot: Command, scenario: str | Path, *more: str) -> Done:
    """A short run, if it starts at all."""
    given = ("--duration", "0.05", "--speed", "0", "--sensors", "pose", "--quiet")
    connect = () if "--connect" in more else ("--connect", NOBODY)
    return autopilot("sitl", str(scenario), *given, *connect, *more)


SCENARIOS = {
    "unknown key": (TANK.replace("seed = 1", "sed = 1"), ("`sed`", "`$.scenario`")),
    "unknown table": (TANK + "\n[wether]\nrain = true\n", ("`wether`",)),
    "wrong type": (
        TANK.replace("speed_m_s = 0.25", 'speed_m_s = "fast"'),
        ("`float`", "`str`", "`$.current.speed_m_s`"),
    ),
    "wrong unit": (TANK.replace("speed_m_s", "speed_knots"), ("`speed_knots`",)),
    "negative depth": (TANK.replace("depth_m = 1.5", "depth_m = -1.5"), ("`$.tank.depth_m`", "> 0")),
    "not a number": (TANK.replace("speed_m_s = 0.25", "speed_m_s = nan"), ("`$.current.speed_m_s`", "nan")),
    "unknown kind": (TANK.replace('"jet"', '"tsunami"'), ("'tsunami'", "`$.current.kind`")),
    "unknown vehicle": (TANK.replace('"lbv150"', '"lbv151"'), ("'lbv151'", "lbv150")),
    "not TOML": (TANK + "\n[[", ("not valid TOML",)),
    "not text": ("\udcff\udcfe", ("UTF-8",)),
}


@pytest.mark.parametrize("name", SCENARIOS)
def test_bad_scenario(autopilot: Command, tmp_path: Path, name: str) -> None:
    text, named = SCENARIOS[name]
    file = tmp_path / "bad.toml"
    file.write_bytes(text.encode(errors="surrogateescape"))
    log = tmp_path / "run.mcap"
    before = _files(tmp_path)
    _assert_refused(_sitl(autopilot, file, "--log", str(log)), str(file), *named)
    _assert_refused(autopilot("config", "show", str(file)), *named)
    assert _files(tmp_path) == before


VEHICLES = {
    "unknown key": (VEHICLE.replace("mass_kg", "mass", 1), ("`mass`", "`$.body`")),
    "wrong unit": (
        re.sub(r"mass_kg = ([\d.]+)", r'mass_kg = "\1 lb"', VEHICLE, count=1),
        ("`$.body.mass_kg`", "`str`"),
    ),
    "negative mass": (re.sub(r"mass_kg = ", "mass_kg = -", VEHICLE, count=1), ("`$.body.mass_kg`", "> 0")),
    "no thrusters": (VEHICLE.replace("[[thruster]]", "[[truster]]"), ("`truster`",)),
}


@pytest.mark.parametrize("name", VEHICLES)
def test_bad_vehicle(autopilot: Command, tmp_path: Path, name: str) -> None:
    text, named = VEHICLES[name]
    vehicle, scenario = tmp_path / "boat.toml", tmp_path / "scenario.toml"
    vehicle.write_text(text)
    scenario.write_text(TANK.replace('"lbv150"', f'"{vehicle}"'))
    before = _files(tmp_path)
    _assert_refused(_sitl(autopilot, scenario, "--log", str(tmp_path / "run.mcap")), str(vehicle), *named)
    _assert_refused(autopilot("mission", "check", str(PAPER_PLAN), "--vehicle", str(vehicle)), str(vehicle), *named)
    assert _files(tmp_path) == before


@pytest.mark.parametrize(
    ("more", "code", "named"),
    [
        (("--param", "SPD_CRUISE"), 1, ("'SPD_CRUISE'", "NAME=VALUE")),
        (("--param", "SPD_CRUISE=fast"), 1, ("'SPD_CRUISE=fast'", "NAME=VALUE")),
        (("--param", "SPEED=1"), 2, ("'SPEED'", "params list")),
        (("--param", "SPD_CRUISE=99"), 1, ("SPD_CRUISE = 99", "use 0.02 to 2 m/s")),
        (("--param", "SPD_CRUISE=nan"), 1, ("SPD_CRUISE = nan", "give 0.02 to 2")),
        (("--connect", "pigeon"), 1, ("'pigeon'", "use e.g. udpout:")),
        (("--connect", "udpin:127.0.0.1"), 1, ("no port", "'udpin:127.0.0.1'")),
        (("--connect", "udpin:127.0.0.1:99999"), 1, ("port between 1 and 65535",)),
        (("--connect", "tcp:127.0.0.1:1"), 1, ("127.0.0.1:1", "start the server")),
        (("--connect", "/dev/nothing:57600"), 1, ("/dev/nothing", "check cable")),
        (("--plan", "missing.plan"), 2, ("missing.plan", "sitl --help")),
        (("--log", "/proc/none/run.mcap"), 1, ("/proc/none/run.mcap", "choose another place")),
        (("--estimator", "ukf"), 2, ("'ukf'", "use one of ekf, complementary")),
        (("--controller", "pid"), 2, ("'--controller'", "'pid'", "use one of nmpc", "package:Class")),
        (("--controller", "nowhere:Pid"), 2, ("--controller 'nowhere:Pid'", "no module 'nowhere'", "PYTHONPATH")),
        (("--plant", "json:JSONEncoder"), 1, ("--plant 'json:JSONEncoder'", "PlantContext", "docs/extend.md")),
        (("--estimator", "json:Loud"), 2, ("--estimator 'json:Loud'", "has no 'Loud'")),
        (("--seed", "-3"), 2, ("-3", "--seed")),
        (("--speeed", "3"), 2, ("--speeed", "sitl --help")),
    ],
)
def test_bad_option(
    autopilot: Command, tmp_path: Path, more: tuple[str, ...], code: int, named: tuple[str, ...]
) -> None:
    _assert_refused(_sitl(autopilot, "paper-tank", *more), *named, code=code)
    assert _files(tmp_path) == []


def test_start_needs_a_plan(autopilot: Command, tmp_path: Path) -> None:
    _assert_refused(_sitl(autopilot, "vortex", "--start"), "--start", "vortex", "--plan FILE")
    assert _files(tmp_path) == []


@pytest.mark.parametrize(
    ("variable", "text", "use"),
    [
        ("ESTIMATOR", "ukf", "use one of ekf, complementary"),
        ("CONTROLLER", "pid", "use one of nmpc, los-pid, or package:Class"),
        ("SENSORS", "sonar", "use one of camera, pose"),
        ("PROFILE", "apm", "use one of generic, px4, ardusub"),
        ("SPEED", "-3", "use 0 or more"),
        ("SPEED", "fast", "not a number"),
        ("DURATION", "0", "above 0"),
        ("DURATION", "nan", "above 0"),
        ("SEED", "-1", "use 0 or more"),
    ],
)
def test_bad_environment(
    autopilot: Command, monkeypatch: pytest.MonkeyPatch, variable: str, text: str, use: str
) -> None:
    monkeypatch.setenv(f"AUTOPILOT_{variable}", text)
    for command in (("sitl", "--connect", NOBODY), ("config", "show")):
        _assert_refused(autopilot(*command), f"AUTOPILOT_{variable}='{text}'", use, "unset it")


PLAN_TEXT = PAPER_PLAN.read_text()
PLANS = {
    "cut.plan": (PLAN_TEXT[:400], ("cut.plan", "not complete JSON", "export")),
    "other.plan": ('{"fileType": "Recipe", "version": 1}', ("other.plan", "Recipe")),
    "newer.plan": (PLAN_TEXT.replace('"version": 1', '"version": 7', 1), ("newer.plan", "version")),
    "nan.plan": (re.sub(r"37\.97\d+", "NaN", PLAN_TEXT, count=1), ("nan.plan", "nan")),
    "short.waypoints": ("QGC WPL 110\n0\t1\t0\t16\n", ("short.waypoints: line 2", "4 columns")),
    "old.waypoints": ("QGC WPL 100\n", ("old.waypoints: line 1", "version 110")),
    "typo.toml": ("[orign]\nlat_deg = 1.0\nlon_deg = 2.0\n", ("typo.toml", "orign")),
    "plan.doc": ("A - B - A", ("plan.doc", "use .plan")),
}


@pytest.mark.parametrize("name", PLANS)
def test_bad_plan_file(autopilot: Command, tmp_path: Path, name: str) -> None:
    text, named = PLANS[name]
    file = tmp_path / name
    file.write_text(text)
    _assert_refused(autopilot("mission", "check", str(file)), *named)
    _assert_refused(autopilot("mission", "upload", str(file), "--connect", NOBODY), *named)
    _assert_refused(_sitl(autopilot, "paper-tank", "--plan", str(file)), *named)
    assert _files(tmp_path) == [file]


def test_plan_with_a_waypoint_in_an_obstacle(autopilot: Command, tmp_path: Path) -> None:
    """As a preloaded plan it is on board and warned of, and never started; `mission check` lists what is wrong."""
    file = tmp_path / "bad.toml"
    file.write_text(WORKSPACE + pillar(*PILLARS[1]) + waypoint(0.9, 0.0, 0.4))
    named = (str(file), "item 0", "inside", "move it 0.43 m")
    loaded = _sitl(autopilot, "paper-tank", "--plan", str(file))
    assert loaded.code == 0
    _assert_warned(loaded, *named, "will not arm until it is fixed")
    _assert_refused(_sitl(autopilot, "paper-tank", "--plan", str(file), "--start"), *named, "mend the plan")
    checked = autopilot("mission", "check", str(file), "--json")
    assert checked.code == 3
    assert '"INVALID_PARAM5_X"' in checked.out
    assert checked.err == ""


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("sitl", "missing.toml"), ("missing.toml", "check the name")),
        (("config", "show", "missing.toml"), ("missing.toml", "check the name")),
        (("mission", "check", "missing.plan"), ("missing.plan", "check the name")),
        (("mission", "upload", "missing.plan"), ("missing.plan", "check the name")),
        (("mission", "start", "missing.plan"), ("missing.plan", "check the name")),
        (("params", "check", "missing.params"), ("missing.params", "check the name")),
        (("params", "defaults", "/proc/none/all.params"), ("/proc/none/all.params", "check folder and rights")),
        (
            ("markers", "board", "--rows", "1", "--columns", "1", "--out", "/proc/none"),
            ("/proc/none/", "another place"),
        ),
        (("currents", "b6", "/proc/none/b6.npz"), ("/proc/none/b6.npz", "another place")),
        (("scenario", "markers", "paper-tank", "--out", "/proc/none/a.toml"), ("/proc/none/a.toml", "another place")),
        (("demo", "--laps", "1", "--out", "/proc/none"), ("/proc/none", "--out")),
        (("mission", "download", "a.plan", "--connect", NOBODY, "--patience", "0.2"), ("no vehicle heard",)),
        (("mission", "download", "a.plan", "--connect", "tcp:127.0.0.1:1"), ("tcp:127.0.0.1:1",)),
    ],
)
def test_missing_things(autopilot: Command, tmp_path: Path, arguments: tuple[str, ...], named: tuple[str, ...]) -> None:
    done = autopilot(*arguments)
    assert done.code == 1
    assert len(done.err.splitlines()) == 1
    for word in named:
        assert word in done.err
    assert _files(tmp_path) == []


def test_bad_parameter_file(autopilot: Command, tmp_path: Path) -> None:
    """Lines that cannot be used do not keep a vehicle from starting, stay in the file and are warned of by name."""
    saved = tmp_path / "state/sitl-0/parameters.params"
    saved.parent.mkdir(parents=True)
    for text, named in (
        ("SPD_CRUISE much\n", "parameters.params:1: SPD_CRUISE = 'much' is not a number"),
        ("SPD_CRUISE 0.3\nDEPTH_MAX 1 2\n", "parameters.params:2: "),
        ("SPD_CRUISE 99\n", "use 0.02 to 2 m/s"),
    ):
        saved.write_text(text)
        started = _sitl(autopilot, "paper-tank")
        assert started.code == 0
        _assert_warned(started, named, "its default is used")
        _assert_refused(autopilot("params", "check", str(saved)), named)
        assert saved.read_text() == text
    saved.write_text("SPD_CRUISE 0.3\nSPD 3\n")
    started, checked = _sitl(autopilot, "paper-tank"), autopilot("params", "check", str(saved))
    assert (started.code, checked.code) == (0, 3)
    for done in (started, checked):
        _assert_warned(done, "parameters.params:2: parameter SPD does not exist")


@pytest.mark.parametrize(("kind", "text"), [(socket.SOCK_DGRAM, "udpin"), (socket.SOCK_STREAM, "tcpin")])
def test_port_in_use(autopilot: Command, tmp_path: Path, kind: socket.SocketKind, text: str) -> None:
    with socket.socket(socket.AF_INET, kind) as holder:
        holder.bind(("127.0.0.1", 0))
        if kind is socket.SOCK_STREAM:
            holder.listen()
        port = holder.getsockname()[1]
        connection, other = f"{text}:127.0.0.1:{port}", f"udpin:127.0.0.1:{free_port()}"
        done = _sitl(
            autopilot, "paper-tank", "--connect", other, "--connect", connection, "--log", str(tmp_path / "a.mcap")
        )
        _assert_refused(done, connection, "already in use", "another port")
        assert _files(tmp_path) == []
    # What was opened before the bad one is free again.
    assert _sitl(autopilot, "paper-tank", "--connect", other, "--connect", connection).code == 0


# Logs


@pytest.fixture(scope="module")
def flight(module_session: OpenSession, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the log of a few seconds of flight."""
    path = tmp_path_factory.mktemp("flight") / "flown.mcap"
    module_session(sensors="pose", plan=str(PAPER_PLAN), start=True, duration=4.0, log=path).run()
    return path.parent


@pytest.fixture
def flown(flight: Path, tmp_path: Path) -> Path:
    return shutil.copytree(flight, tmp_path / "logs") / "flown.mcap"


def test_log_that_is_whole(autopilot: Command, flown: Path) -> None:
    done = autopilot("log", "info", str(flown))
    assert (done.code, done.err) == (0, "")
    assert "loss" not in done.out
    done = autopilot("log", "compare", str(flown), str(flown))
    assert (done.code, done.err) == (0, "") and "not comparable: flown.mcap: 0 of 3 laps are complete" in done.out
    assert "J/m (1.00 times)" in done.out.splitlines()[0]


@pytest.mark.long
def test_what_is_drawn_of_a_truncated_log_is_not_passed_off_as_whole(autopilot: Command, flown: Path) -> None:
    data = flown.read_bytes()
    flown.write_bytes(data[: len(data) // 2])
    for command in ("report", "plot"):
        done = autopilot("log", command, str(flown))
        assert done.code == 3
        assert done.out.strip()
        assert len(done.err.splitlines()) == 1
        assert "cut off" in done.err


def test_a_file_that_ends_early_is_no_interrupt() -> None:
    """click takes every EOFError for a closed terminal; a damaged module or pickle raises one, too."""

    @click.command()
    def command() -> None:
        raise EOFError("marshal data too short")

    with pytest.raises(EOFError, match="too short"):
        run(lambda: command([], standalone_mode=False))


# The service as a process


def test_interrupt_ends_well(tmp_path: Path) -> None:
    """Ctrl-C while flying: exit code 130, one line, and the log is whole."""
    from autopilot.log.reader import open_log

    log, port = tmp_path / "run.mcap", free_port()
    command = autopilot_command(
        *("sitl", "--quiet", "--sensors", "pose", "--speed", "0", "--start"),
        *("--plan", str(PAPER_PLAN), "--log", str(log), "--connect", f"udpin:127.0.0.1:{port}"),
    )
    said = tmp_path / "stderr"
    with said.open("w") as stderr:
        child = Child(command, {"AUTOPILOT_STATE_DIR": str(tmp_path / "state")}, stderr)
    service = RunningService(child=child, port=port, log=log)
    while not (log.exists() and log.stat().st_size > 100_000):
        service.keep_waiting()
        time.sleep(0.05)
    child.process.send_signal(signal.SIGINT)
    assert child.process.wait() == 130
    assert said.read_text() == "interrupted\n"
    opened = open_log(log)
    opened.verify()
    assert opened.problems == ()


def test_help_names_every_command(autopilot: Command) -> None:
    done = autopilot("--help")
    assert done.code == 0
    for name in ("bench", "config", "demo", "log", "mission", "params", "sitl"):
        assert re.search(rf"^  {name} ", done.out, re.MULTILINE)


def test_a_log_that_cannot_be_closed_does_not_lose_the_parameters(
    session: OpenSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each thing that is to be done at the end of a run is done, whatever another one raises."""
    client = WireClient()
    run_ = session(sensors="pose", peers=(client,), duration=0.05)
    client.send(mav.MAVLink_param_set_message(1, 1, b"SPD_CRUISE", 0.2, mav.MAV_PARAM_TYPE_REAL32))
    with monkeypatch.context() as patch:
        patch.setattr(run_.recorder, "close", lambda: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            run_.run()
    assert scan_param_file(tmp_path / "state/sitl-0/parameters.params").values == {"SPD_CRUISE": pytest.approx(0.2)}
    with pytest.raises(RuntimeError, match="disk"):
        run_.kept.disk.submit(0, lambda request, _: request, None)


def test_a_disk_that_recovers_has_the_parameters_and_the_operator_knows(session: OpenSession, tmp_path: Path) -> None:
    """Nobody has to set them again."""
    client = WireClient()
    harbour = Harbour(session(sensors="pose", peers=(client,)))
    (tmp_path / "state").write_text("a file where a folder should be")
    client.send(mav.MAVLink_param_set_message(1, 1, b"SPD_CRUISE", 0.2, mav.MAV_PARAM_TYPE_REAL32))
    harbour.until(lambda: any(text.startswith("Not saved") for text in client.texts()))
    run_ = harbour.session
    assert run_.parts.params["SPD_CRUISE"] == pytest.approx(0.2)
    assert "parameters are not saved: " in str(run_.kept.params.failure), "what the end of the run would say"
    (tmp_path / "state").unlink()
    harbour.until(lambda: "Parameters are saved now" in client.texts(least=mav.MAV_SEVERITY_INFO), 6.0)
    assert scan_param_file(tmp_path / "state/sitl-0/parameters.params").values == {"SPD_CRUISE": pytest.approx(0.2)}
    told = [text for text in client.texts() if text.startswith("Not saved")]
    assert told == ["Not saved (folder gone), lost at restart: SPD_CRUISE"]


def test_vehicle_new_check_and_fly(autopilot: Command, tmp_path: Path) -> None:
    """What a newcomer does: a template, a look at it, a mistake, a flight."""
    assert autopilot("vehicle", "new", "mine").code == 0
    again = autopilot("vehicle", "new", "mine")
    assert again.code == 1 and "mine.toml: is there already" in again.err
    checked = autopilot("vehicle", "check", "mine.toml", "--json")
    assert checked.code == 0
    assert [axis["axis"] for axis in json.loads(checked.out)["axes"]] == ["surge", "sway", "heave", "yaw"]
    file = Path("mine.toml")
    text = file.read_text()
    file.write_text(text.replace("# channel = 1 #", "channel = 2 #"))
    done = autopilot("vehicle", "check", "mine.toml")
    assert done.code == 1 and len(done.err.splitlines()) == 1 and "both have `channel` = 2" in done.err
    file.write_text(re.sub(r"\[camera\].*?\n\n", "", text, flags=re.S))
    blind = _sitl(autopilot, "paper-tank", "--vehicle", "mine.toml", "--sensors", "camera")
    _assert_refused(blind, "'mine' has no [camera]", "--sensors pose")
    assert _sitl(autopilot, "paper-tank", "--vehicle", "mine.toml").code == 0
    unfit = _sitl(autopilot, "thruster-loss", "--vehicle", "bluerov2")
    _assert_refused(unfit, "--vehicle: `$.fault[0].thruster`", "use one of front-starboard")
    names = [each["name"] for each in json.loads(autopilot("vehicle", "list", "--json").out)]
    assert names == ["bluerov2", "bluerov2-heavy", "lbv150"]


def test_a_campaign_of_another_vehicle_is_judged_by_its_ball() -> None:
    from autopilot.campaign.definition import define

    task = define("r1", vehicle="bluerov2").task(3)
    tables = tomllib.loads(task.scenario_toml)
    assert tables["vehicle"]["model"] == "bluerov2"
    assert tables["accept"]["cylinder_clearance_m"] == pytest.approx(0.48)
    assert tables["accept"]["wall_clearance_m"] == pytest.approx(0.32)
    assert define("r1").task(3).drawn == task.drawn
