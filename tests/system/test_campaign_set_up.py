"""Campaigns whose runs cannot be set up: the cause is named and no bound called broken; mended, they are flown."""

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from autopilot.campaign import engines, fault_campaign
from autopilot.campaign.definition import define
from autopilot.campaign.engines import InProcess
from autopilot.campaign.run_store import IDENTITY, RUNS, Shard, Store, read_results, settle_identity
from autopilot.campaign.worlds import vehicles
from autopilot.campaign.worlds.world_results import read_flights
from autopilot.cli.main import cli
from autopilot.core.errors import ConfigError
from autopilot.mission.paper import paper_plan
from autopilot.mission.plan_files import write_plan
from autopilot.run.children import autopilot_command
from autopilot.sitl.scenario import scenario_path

SHORT_S = 2.0
VEHICLE = scenario_path("r1").parents[2] / "data" / "vehicles" / "lbv150.toml"


def command(*arguments: str) -> Result:
    return CliRunner().invoke(cli, ["campaign", *arguments])


def short(folder: Path, name: str) -> str:
    """The shipped scenario with a short flight of a vehicle file beside it."""
    text = scenario_path(name).read_text(encoding="utf-8").replace("duration_s = 150.0", f"duration_s = {SHORT_S}")
    (folder / f"{name}.toml").write_text(text.replace('model = "lbv150"', 'model = "mine.toml"'), encoding="utf-8")
    (folder / "mine.toml").write_bytes(VEHICLE.read_bytes())
    write_plan(folder / "paper.plan", paper_plan(1))
    return str(folder / f"{name}.toml")


def no_import(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "autopilot.campaign.flight", None)


def later(spoil: Callable[[Path], object]) -> Callable[[Path, pytest.MonkeyPatch], None]:
    """Something happens to the vehicle file after the campaign was defined, before its runs."""

    def when_flown(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def make(*_: object) -> InProcess:
            spoil(folder / "mine.toml")
            return InProcess()

        monkeypatch.setattr(engines, "make_engine", make)

    return when_flown


CAUSES: dict[str, tuple[Callable[[Path, pytest.MonkeyPatch], None], str]] = {
    "a module that cannot be imported": (no_import, "ModuleNotFoundError: import of autopilot.campaign.flight halted"),
    "a missing file": (later(Path.unlink), "mine.toml: cannot be read"),
    "an unreadable vehicle file": (later(lambda path: path.write_text("name = ")), "mine.toml: is not valid TOML"),
}


@pytest.mark.parametrize("name", ["r1", "by-hand"])
@pytest.mark.parametrize("cause", CAUSES)
def test_runs_that_cannot_be_set_up_break_no_bound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cause: str, name: str
) -> None:
    scenario, out = short(tmp_path, name), tmp_path / "out"
    spoil, text = CAUSES[cause]
    spoil(tmp_path, monkeypatch)
    arguments = (scenario, "--runs", "2", "--out", str(out), "--jobs", "1", "--no-figures", "--logs", "0")
    done = command(*arguments)
    assert done.exit_code == 1
    (verdict,) = [line for line in done.stdout.splitlines() if line.startswith(f"{name}: ") and "runs in" in line]
    assert verdict.startswith(f"{name}: 2 of 2 runs could not be flown: ") and text in verdict
    assert "A BOUND" not in done.output
    assert len(read_results(out)) == 2


def test_once_mended_the_same_command_flies_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = [short(tmp_path, "r1"), "--runs", "1", "--out", str(tmp_path / "out"), "--jobs", "1", "--no-figures"]
    arguments += ["--logs", "0"]
    with monkeypatch.context() as patch:
        no_import(tmp_path, patch)
        printed = json.loads(command(*arguments, "--json").stdout)
    assert printed["passed"] is False and printed["not_flown"].startswith("1 of 1 runs could not be flown: ")
    assert [bar["name"] for bar in printed["bars"] if bar["held"] is False] == ["runs flown to their end"]
    done = command(*arguments)
    (result,) = read_results(tmp_path / "out").values()
    assert result.flown and result.simulated_s == SHORT_S
    assert "A BOUND IS BROKEN; runs in" in done.stdout, "nobody finishes laps in that time"


OWN = """
from autopilot.control.protocol import Controller, simple_output
import numpy as np

class Still(Controller):
    def __init__(self, given):
        {begin}
    def reset(self): pass
    def step(self, t_us, nav, goal, fence, params, thruster_limit_n, tracks, *, delay_s):
        return simple_output(t_us, nav, np.zeros(len(thruster_limit_n)))
"""


def test_a_class_that_cannot_be_made_is_refused_before_there_is_a_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "no_licence.py").write_text(OWN.format(begin='raise ValueError("no licence")'))
    arguments = (short(tmp_path, "r1"), "--runs", "40", "--out", str(tmp_path / "out"), "--jobs", "1", "--no-figures")
    with pytest.raises(ConfigError, match=r"^scenario\.toml: .*'no_licence:Still': cannot be made: .*no licence"):
        CliRunner().invoke(cli, ["campaign", *arguments, "--controller", "no_licence:Still"], catch_exceptions=False)
    assert not (tmp_path / "out").exists()


def test_runs_of_an_edited_class_are_another_campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    module = tmp_path / "edited_later.py"
    module.write_text(OWN.format(begin="pass"))
    scenario = short(tmp_path, "r1")
    first, again = (define(scenario, controller="edited_later:Still").identity for _ in range(2))
    module.write_text(OWN.format(begin="self.gain = 2.0"))
    edited = define(scenario, controller="edited_later:Still").identity
    assert first == again != edited and define(scenario).identity.own_code == {}


def test_runs_of_an_edited_vehicle_file_are_another_campaign(tmp_path: Path) -> None:
    scenario, identity, vehicle = short(tmp_path, "r1"), tmp_path / "campaign.json", tmp_path / "mine.toml"
    settle_identity(identity, define(scenario).identity, RUNS)
    settle_identity(identity, define(scenario).identity, RUNS)
    vehicle.write_text(f"# edited\n{vehicle.read_text(encoding='utf-8')}", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"holds another campaign: files\..*mine\.toml was '.* and is now "):
        settle_identity(identity, define(scenario).identity, RUNS)
    noted = json.loads(identity.read_text(encoding="utf-8"))
    del noted["files"]
    identity.write_text(json.dumps(noted), encoding="utf-8")
    settle_identity(identity, define(scenario).identity, RUNS)


def test_runs_without_their_campaign_are_taken_up_by_no_other(tmp_path: Path) -> None:
    defined, out = define(short(tmp_path, "r1")), tmp_path / "out"
    Store(out, defined, Shard()).close()
    kept = (out / IDENTITY).read_bytes()
    (out / IDENTITY).unlink()
    (out / "runs-1of2.jsonl").write_bytes(b"{}\n")
    with pytest.raises(ConfigError, match=r"holds runs-1of2\.jsonl without campaign\.json.* copy the campaign\.json"):
        Store(out, defined, Shard())
    (out / IDENTITY).write_bytes(kept)
    Store(out, defined, Shard()).close()


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no pidfd")
def test_workers_end_with_a_campaign_that_is_killed(tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ("campaign", "r1", "--runs", "40", "--duration", "60", "--jobs", "2", "--out", str(out), "--no-figures")
    with subprocess.Popen(autopilot_command(*arguments), start_new_session=True, stderr=subprocess.DEVNULL) as made:

        def alive() -> int:
            pids = [entry.name for entry in Path("/proc").iterdir() if entry.name.isdecimal()]
            return sum(session_of(pid) == made.pid for pid in pids)

        wait_for(lambda: list(out.glob("runs*.jsonl")) and alive() > 2)
        made.kill()
    wait_for(lambda: alive() == 0)


def session_of(pid: str) -> int:
    with contextlib.suppress(OSError):
        return os.getsid(int(pid))
    return 0


def wait_for(done: Callable[[], object]) -> None:
    """A busy machine may take long; only what never comes fails."""
    until_s = time.monotonic() + 300.0
    while not done():
        assert time.monotonic() < until_s
        time.sleep(0.1)


def test_sets_name_the_set_and_the_cause(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    no_import(tmp_path, monkeypatch)
    sets = [part for name in ("r1", "by-hand") for part in ("--set", short(tmp_path, name))]
    done = command("sets", *sets, "--runs", "1", "--out", str(tmp_path / "out"), "--jobs", "1", "--no-figures")
    assert done.exit_code == 1
    for name in ("r1", "by-hand"):
        assert f"{name}: 1 of 1 runs could not be flown: ModuleNotFoundError: import of" in done.stdout


def test_random_worlds_name_the_cause_and_are_flown_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first world of this seed is refused, so that nothing has to fly."""
    arguments = ("rooms", "--runs", "1", "--seed", "3", "--jobs", "1", "--out", str(tmp_path))
    with monkeypatch.context() as patch:
        patch.setattr(vehicles, "SHIPPED", "nobody")
        done = command(*arguments)
        assert done.exit_code == 1
        assert "2 of 2 flights could not be flown: " in done.stdout and "nobody.toml: cannot be read" in done.stdout
        assert not any(flight.flown for flight in read_flights(tmp_path).values())
    done = command(*arguments)
    assert done.exit_code == 0 and "could not be flown" not in done.stdout
    assert all(flight.flown for flight in read_flights(tmp_path).values())


def test_fault_flights_name_the_cause_and_are_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fault_campaign, "fly_fault_case", lambda *_: Path("/nowhere/at-all").read_text())
    done = command("faults", "--runs", "1", "--row", "LEAK", "--out", str(tmp_path), "--json")
    assert done.exit_code == 1 and json.loads(done.stdout) == []
    assert "2 of 2 flights could not be flown: LEAK paper-tank at " in done.stderr
    assert "FileNotFoundError: [Errno 2]" in done.stderr
    assert fault_campaign.results(tmp_path) == {}


SITE = """
import os, sys
class Broken:
    def find_spec(self, name, *more):
        if name == "autopilot.campaign.worker":
            {what}
sys.meta_path.insert(0, Broken())
"""


@pytest.mark.parametrize(
    ("what", "cause"), [("raise ImportError('numpy is damaged')", "ImportError: numpy is damaged"), ("os._exit(9)", "")]
)
def test_processes_that_cannot_start_end_it_at_once(tmp_path: Path, what: str, cause: str) -> None:
    """No run is blamed, and the next command finds none finished."""
    (tmp_path / "sitecustomize.py").write_text(SITE.format(what=what), encoding="utf-8")
    done = subprocess.run(
        [
            *autopilot_command("campaign", short(tmp_path, "r1"), "--runs", "20", "--jobs", "2"),
            *("--out", str(tmp_path / "out"), "--no-figures", "--logs", "0"),
        ],
        env={**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1, done.stderr
    assert done.stderr.splitlines()[-1].startswith(f"error: --engine local: a worker process cannot start: {cause}")
    assert read_results(tmp_path / "out") == {}
