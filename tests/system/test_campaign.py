"""Campaigns: kept, resumed, sharded, refused when changed, summed up."""

import csv
import json
import os
import re
import signal
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

import matplotlib as mpl
import msgspec
import numpy as np
import pytest
from click.testing import CliRunner, Result
from deadly_runs import Deadly, Spinning

from autopilot.campaign.campaign_figures import _margins, write_figures
from autopilot.campaign.definition import Campaign, define, first_difference
from autopilot.campaign.engines import DaskCluster, InProcess, LocalPool, interrupt_later, make_engine
from autopilot.campaign.flight import fly
from autopilot.campaign.results import Margin, RunResult, Task
from autopilot.campaign.run_store import Shard, Store, read_results, scenario_file
from autopilot.campaign.run_table import write_tables
from autopilot.campaign.summary import failure_bound, failure_interval, summarise
from autopilot.campaign.worst import logs_of, worst_first
from autopilot.cli.campaign import stoppable
from autopilot.cli.main import cli
from autopilot.core.errors import ConfigError, LogError, PlanError
from autopilot.log.check import acceptance_table
from autopilot.log.reader import open_log
from autopilot.run.children import autopilot_command, free_port, python_command
from tests.short_campaign import SHORT_S, SPREAD, command, lines, scenario_in


def campaign(out: Path, scenario: str, *arguments: str, runs: int = 2) -> tuple[int, Any]:
    """Exit code and what --json printed."""
    fixed = ("--runs", str(runs), "--out", str(out), "--json", "--jobs", "1", "--logs", "0")
    code, printed = command(scenario, *fixed, *arguments)
    return code, json.loads(printed) if printed.startswith("{") else None


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, Any]:
    """Two short runs: folder, scenario, what was printed."""
    folder = tmp_path_factory.mktemp("campaign")
    scenario = scenario_in(folder / "in")
    code, printed = campaign(folder / "out", scenario)
    assert code == 1, "nobody finishes laps in that time"
    return folder / "out", scenario, printed


def test_two_runs_are_flown_and_judged(flown: tuple[Path, str, Any]) -> None:
    out, _, printed = flown
    first, second = read_results(out).values()
    assert (first.run, second.run) == (0, 1)
    assert (first.seed, second.seed) == (1_000_000, 1_000_001)
    assert first.drawn != second.drawn
    assert 0.7 <= float(first.drawn["vehicle.mismatch.drag"]) <= 1.3
    for result in (first, second):
        assert result.error is None
        assert result.simulated_s == SHORT_S
        assert result.laps == 0
        assert result.laps_asked == 1
        assert result.failed
        assert result.beyond == []
        names = {"cylinder 1", "cylinder 2", "walls", "fence", "shallowest", "deepest"}
        assert set(result.margins) == names | {"planar speed", "heave", "yaw rate", "thrust"}
        assert 0.0 < result.pos_rms_m < 0.01
        assert result.steps > 10
    bars = {bar["name"]: bar for bar in printed["bars"]}
    assert bars["laps done"]["held"] is False
    assert bars["a bound broken beyond its tolerance"]["held"] is True
    assert printed["passed"] is False
    assert [each["what"] for each in printed["failed"]] == ["0 of 1 laps", "0 of 1 laps"]
    assert (out / "margins.png").is_file()


def test_a_drawn_run_flown_alone_is_the_same(flown: tuple[Path, str, Any], tmp_path: Path) -> None:
    out, _, _ = flown
    log = tmp_path / "alone.mcap"
    subprocess.run(
        [
            *autopilot_command("sitl", str(scenario_file(out, 1)), "--seed", "1000001", "--start"),
            *("--speed", "0", "--quiet", "--connect", f"udpin:127.0.0.1:{free_port()}", "--log", str(log)),
        ],
        check=True,
        env={**os.environ, "AUTOPILOT_STATE_DIR": str(tmp_path)},
    )
    rows = {row.name: row for row in acceptance_table(open_log(log))}
    result = read_results(out)[1]
    worst = rows["distance to cylinder 1"].worst
    assert worst is not None
    # The log keeps the truth at 50 Hz, the campaign looks at 100 Hz.
    assert worst - 0.46 == pytest.approx(result.margins["cylinder 1"].margin, abs=2e-3)


def test_finished_runs_are_not_repeated_and_more_can_be_added(flown: tuple[Path, str, Any], tmp_path: Path) -> None:
    out, scenario, _ = flown
    fresh = tmp_path / "out"
    assert campaign(fresh, scenario, runs=1)[0] == 1
    with (fresh / "runs.jsonl").open("ab") as file:
        file.write(b'{"run":1,"se')  # a crash cut this line off
    data = (fresh / "runs.jsonl").read_bytes()
    code, printed = campaign(fresh, scenario)
    assert (code, printed["finished"]) == (1, 2)
    again = (fresh / "runs.jsonl").read_bytes()
    assert again.startswith(data[: data.index(b"\n") + 1])
    assert again.count(b"\n") == 2
    assert lines(fresh) == lines(out), "interrupted and resumed = flown in one go"
    campaign(fresh, scenario)
    assert (fresh / "runs.jsonl").read_bytes() == again


def test_shards_together_are_the_whole(flown: tuple[Path, str, Any], tmp_path: Path) -> None:
    out, scenario, _ = flown
    together = tmp_path / "out"
    code, first = campaign(together, scenario, "--shard", "2/2")
    assert first["finished"] == 1
    code, both = campaign(together, scenario, "--shard", "1/2")
    assert (code, both["finished"]) == (1, 2)
    assert sorted(path.name for path in together.glob("runs*.jsonl")) == ["runs-1of2.jsonl", "runs-2of2.jsonl"]
    assert lines(together) == lines(out)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("--seed", "2"), "holds another campaign: seed was 1 and is now 2"),
        (("--sensors", "camera"), "sensors was absent and is now 'camera'"),
        (("--param", "THR_LIMIT=11"), "params.THR_LIMIT was absent and is now 11.0"),
        (("--duration", "3"), "duration_s was absent and is now 3.0"),
        (None, "scenario.spread.vehicle.mismatch.drag.high was 1.3 and is now 1.2"),
    ],
)
def test_another_campaign_in_the_same_folder_is_refused(
    flown: tuple[Path, str, Any],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    change: tuple[str, ...] | None,
    message: str,
) -> None:
    out, scenario, _ = flown
    if change is None:
        scenario, change = scenario_in(tmp_path, SPREAD.replace("1.3", "1.2")), ()
    assert campaign(out, scenario, *change)[0] == 1
    error = capsys.readouterr().err
    assert message in error
    assert "choose another --out" in error
    assert error.count("\n") == 1


def test_another_version_is_refused(flown: tuple[Path, str, Any]) -> None:
    out, scenario, _ = flown
    defined = define(scenario)
    other = Campaign(
        identity=msgspec.structs.replace(defined.identity, version="0.0.9"),
        scenario=defined.scenario,
        tables=defined.tables,
    )
    with pytest.raises(ConfigError, match=r"version was '.*' and is now '0\.0\.9'"):
        Store(out, other, Shard())


def test_two_processes_do_not_fly_the_same_runs(flown: tuple[Path, str, Any]) -> None:
    out, scenario, _ = flown
    store = Store(out, define(scenario), Shard())
    with pytest.raises(ConfigError, match="another process flies these runs now"):
        Store(out, define(scenario), Shard())
    store.close()


def test_a_damaged_line_is_named(tmp_path: Path) -> None:
    (tmp_path / "runs.jsonl").write_bytes(b'{"run":0,"seed":1,"drawn":{}}\n{"run":\n')
    with pytest.raises(LogError, match=r"runs\.jsonl:2: damaged"):
        read_results(tmp_path)


def test_results_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    (tmp_path / "runs.jsonl").mkdir()
    with pytest.raises(LogError, match=r"runs\.jsonl: cannot be read \(Is a directory\)"):
        read_results(tmp_path)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nowhere",), "scenario 'nowhere' is not known"),
        (("vortex",), "has no plan"),
        (("paper-tank",), "does not say when a run ends"),
        (("r1", "--shard", "3/2"), "--shard '3/2': write I/N"),
        (("r1", "--shard", "x"), "--shard 'x': write I/N"),
        (("r1", "--engine", "abacus"), "--engine 'abacus': use local, dask or dask+tcp://HOST:PORT"),
        (("r1", "--param", "NO_SUCH=1"), "parameter 'NO_SUCH' is not known"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], message: str
) -> None:
    scenario, *rest = arguments
    assert campaign(tmp_path / "out", scenario, *rest)[0] == (2 if "is not known" in message else 1)
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not list(tmp_path.glob("out/runs*"))


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").write_text("a file")
    assert campaign(tmp_path / "out", scenario_in(tmp_path / "in"))[0] != 0
    assert "out" in capsys.readouterr().err


def test_a_disk_that_is_full_ends_it_in_words_and_keeps_what_was_flown(tmp_path: Path) -> None:
    """A file may not grow beyond a limit: the system then writes half of a line and refuses the rest, as a full disk
    does. The half line is taken back; with room again the same command goes on."""
    scenario, out = scenario_in(tmp_path / "in"), tmp_path / "out"
    assert campaign(out, scenario, "--no-figures", runs=1)[0] == 1
    (first,) = read_results(out).values()
    # Longer than any other file that is written.
    kept = msgspec.json.encode(msgspec.structs.replace(first, events=["x" * 30_000])) + b"\n"
    (out / "runs.jsonl").write_bytes(kept)
    code = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({len(kept) + 300}, resource.RLIM_INFINITY));"
        "from autopilot.cli.main import main; main()"
    )
    command = [*python_command(code), "campaign", scenario, "--runs", "2", "--out", str(out), "--jobs", "1"]
    # The limit holds for bytecode, too: half of a module would be kept for later tests.
    done = subprocess.run(
        [*command, "--no-figures", "--logs", "0"],
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "run 1 cannot be written" in done.stderr and "finished runs are kept; make room" in done.stderr
    assert "Traceback" not in done.stderr
    assert (out / "runs.jsonl").read_bytes() == kept
    assert campaign(out, scenario, "--no-figures")[1]["finished"] == 2


def test_the_table_of_runs_can_be_read_back(flown: tuple[Path, str, Any]) -> None:
    out, _, printed = flown
    with (out / "runs.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    results = read_results(out)
    assert [int(row["run"]) for row in rows] == [0, 1]
    for row, result in zip(rows, results.values(), strict=True):
        assert float(row["drawn.vehicle.mismatch.drag"]) == result.drawn["vehicle.mismatch.drag"]
        assert float(row["margin.cylinder_1"]) == result.margins["cylinder 1"].margin
        assert row["failed"] == "True"
    assert str(out / "runs.csv") in printed["files"]


def test_parquet_where_pyarrow_is(tmp_path: Path) -> None:
    parquet: Any = pytest.importorskip("pyarrow.parquet")
    runs = [made_up(0), made_up(1, error="no"), msgspec.structs.replace(made_up(2), drawn={"a": 1.0, "b": "x"})]
    assert [path.name for path in write_tables(runs, tmp_path)] == ["runs.csv", "runs.parquet"]
    table = parquet.read_table(tmp_path / "runs.parquet").to_pylist()
    assert [row["run"] for row in table] == [0, 1, 2]
    assert (table[2]["drawn.a"], table[2]["drawn.b"], table[0]["drawn.b"]) == (1.0, "x", None)
    assert table[1]["error"] == "no" and table[1]["failed"] is True


def test_a_seed_of_more_than_64_bits_is_kept(tmp_path: Path) -> None:
    parquet: Any = pytest.importorskip("pyarrow.parquet")
    write_tables([msgspec.structs.replace(made_up(0), seed=10**23)], tmp_path)
    assert parquet.read_table(tmp_path / "runs.parquet").to_pylist()[0]["seed"] == str(10**23)


def test_the_worst_runs_have_logs_of_the_same_run(flown: tuple[Path, str, Any]) -> None:
    out, scenario, _ = flown
    defined, results = define(scenario), list(read_results(out).values())
    said: list[str] = []
    logs = logs_of(results, 1, out, defined.task, lambda: False, said.append)
    assert said == [], "it flies as it did without a log"
    (run,) = logs
    assert {path.name for path in logs[run].parent.iterdir()} == {f"run-{run:04d}.mcap", f"run-{run:04d}.tlog"}
    assert run == worst_first(results)[0].run
    rows = {row.name: row for row in acceptance_table(open_log(logs[run]))}
    worst = rows["distance to cylinder 1"].worst
    assert worst is not None
    assert worst - 0.46 == pytest.approx(results[run].margins["cylinder 1"].margin, abs=2e-3)


def test_the_worst_come_first() -> None:
    runs = [made_up(0, 0.02), made_up(1, 0.01), made_up(2, 0.5, contacts=1), made_up(3, error="no")]
    assert [result.run for result in worst_first(runs)] == [2, 1, 0]


@pytest.mark.parametrize("deadly", [(), (1,), (0, 2), (0, 1, 2)])
def test_a_process_that_dies_takes_no_other_run_with_it(deadly: tuple[int, ...]) -> None:
    runs = [Deadly(number, number in deadly) for number in range(3)]
    found = sorted(LocalPool(2).run(runs, lambda: False))
    died = "failed: the process that flew it died each time (out of memory?)"
    assert found == [f"run {number} {died}" if number in deadly else f"run {number}" for number in range(3)]


def test_a_process_that_dies_holds_nothing_that_others_wait_for() -> None:
    found: list[str] = []
    runs = [Spinning(0, True), Spinning(1, False)]
    flying = threading.Thread(target=lambda: found.extend(LocalPool(2).run(runs, lambda: False)), daemon=True)
    flying.start()
    flying.join(300.0)
    assert not flying.is_alive(), "it waits for a dead process"
    assert [text.split(":")[0] for text in sorted(found)] == ["run 0 failed", "run 1"]


def test_a_plan_that_is_none_is_refused_before_anything_is_flown(tmp_path: Path) -> None:
    scenario = scenario_in(tmp_path)
    (tmp_path / "paper.plan").write_text("{}")
    with pytest.raises(PlanError):
        define(scenario)


def test_an_impossible_distribution_is_named_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spread = SPREAD.replace("drag", "colour")
    assert campaign(tmp_path / "out", scenario_in(tmp_path, spread))[0] == 1
    error = capsys.readouterr().err
    assert '$.spread."vehicle.mismatch.colour"` = 0.7' in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_an_interrupted_campaign_can_go_on(tmp_path: Path) -> None:
    """Ctrl-C while two processes fly: exit code 130, what was finished is kept, nothing else is left."""
    scenario, out = scenario_in(tmp_path / "in"), tmp_path / "out"
    command = [
        *autopilot_command("campaign", scenario, "--runs", "40", "--out", str(out)),
        *("--jobs", "2", "--no-figures"),
    ]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stderr is not None
            first = process.stderr.readline()
            assert re.match(r"r1: 1 of 40, about \d+ (s|min|h) left: run ", first)
            process.send_signal(signal.SIGINT)
            rest = process.stderr.read()
            assert process.wait() == 130
        finally:
            process.kill()
    kept = read_results(out)
    assert 1 <= len(kept) < 40
    assert f"r1: {len(kept)} of 40 runs are kept in {out}; the same command resumes" in rest
    assert "Traceback" not in rest
    assert all(result.error is None for result in kept.values())
    defined = define(scenario)
    again = fly(defined.task(min(kept)))
    assert again is not None
    alike = msgspec.structs.replace(again, cpu_s=kept[min(kept)].cpu_s)
    assert alike == kept[min(kept)], "a process of the pool flies the same run"


def test_ctrl_c_while_a_process_is_begun_is_kept() -> None:
    """It was ignored there, and a campaign of many short runs is there most of the time."""
    with stoppable() as stopped:
        with interrupt_later():
            os.kill(os.getpid(), signal.SIGINT)
        assert stopped == [signal.SIGINT]


def test_a_run_that_cannot_be_flown_is_a_failed_one(tmp_path: Path) -> None:
    """The start lies inside the cylinder in half of the range: those runs fail and the others are flown."""
    spread = (
        '[spread]\n"vehicle.start_m[0]" = { choice = [-1.6, -0.625] }\n"vehicle.start_m[1]" = { choice = [-0.625] }\n'
    )
    defined = define(scenario_in(tmp_path, spread), duration_s=1.2)
    results = list(InProcess().run([defined.task(run) for run in range(4)], lambda: False))
    inside = [float(result.drawn["vehicle.start_m[0]"]) == -0.625 for result in results]
    assert any(inside)
    assert not all(inside)
    for result, bad in zip(results, inside, strict=True):
        assert (result.error is not None) == bad
        assert "inside obstacle 1" in (result.error or "inside obstacle 1")
    summary = summarise(results, 4)
    assert not summary.passed
    assert summary.bars[0].value == f"{4 - sum(inside)} of 4"


def test_parts_of_a_campaign_are_those_of_the_options(tmp_path: Path) -> None:
    """Runs of `los-pid` announce no prediction; every bound of the runs has its panel."""
    defined = define(scenario_in(tmp_path), controller="los-pid", estimator="complementary", duration_s=3.0)
    task = defined.task(0)
    assert 'controller = "los-pid"' in task.scenario_toml and task.estimator == "complementary"
    (result,) = InProcess().run([task], lambda: False)
    assert result.error is None and not any(result.tube_shares)
    with mpl.rc_context():
        figure = _margins([result], "one")
    assert figure is not None
    assert [ax.get_xlabel().partition(" [")[0] for ax in figure.axes if ax.get_visible()] == list(result.margins)
    assert len(result.margins) == 10
    for kind, name in (("controller", "nmcp"), ("plant", "nowhere:Plant"), ("estimator", "kf")):
        with pytest.raises(ConfigError, match=name):
            define(scenario_in(tmp_path), **{kind: name})


def test_a_run_that_is_never_armed_is_a_failed_one(tmp_path: Path) -> None:
    scenario = Path(scenario_in(tmp_path, '[accept]\ncampaign = "contact"\n' + SPREAD))
    text = scenario.read_text(encoding="utf-8").replace(
        'position = "pose"', 'position = "pose"\npose = { drop_probability = 1.0 }'
    )
    scenario.write_text(text, encoding="utf-8")
    (result,) = InProcess().run([define(str(scenario), duration_s=6.5).task(0)], lambda: False)
    assert result.failed
    assert result.error is not None
    assert result.error.startswith("was never armed: Arming denied: no position yet: check the pose source")


def test_engines_are_chosen_by_name() -> None:
    assert isinstance(make_engine("local", 1), InProcess)
    assert isinstance(make_engine("local", 3), LocalPool)
    try:
        import distributed  # noqa: F401
    except ImportError:
        with pytest.raises(ConfigError, match=r"install underwater-autopilot\[cluster\]"):
            make_engine("dask", 1)
    else:
        assert isinstance(make_engine("dask+tcp://127.0.0.1:1", 1), DaskCluster)


def test_a_stopped_engine_gives_nothing_more(tmp_path: Path) -> None:
    defined = define(scenario_in(tmp_path))
    asked: list[Task] = [defined.task(run) for run in range(3)]
    assert list(InProcess().run(asked, lambda: True)) == []
    begin_s = time.process_time()
    assert fly(asked[0], lambda: True) is None
    assert time.process_time() - begin_s < 30.0


def test_sets_are_flown_in_turn_and_go_on(tmp_path: Path) -> None:
    """Two sets by one command, flown by one pool, each in a folder that ``campaign`` and ``campaign table`` know."""
    files = [scenario_in(tmp_path / "in", name=f"{name}.toml") for name in ("one", "two")]
    out = tmp_path / "out"

    def sets(*arguments: str) -> Result:
        chosen = [part for file in files for part in ("--set", file)]
        return CliRunner().invoke(cli, ["campaign", "sets", *chosen, "--out", str(out), "--no-figures", *arguments])

    done = sets("--runs", "1", "--jobs", "1", "--logs", "0")
    assert done.exit_code == 1, "nobody finishes laps in that time"
    assert [line.split(",")[0] for line in done.stderr.splitlines()] == ["1 of 2: one run 0", "2 of 2: two run 0"]
    before = {name: (out / name / "runs.jsonl").read_bytes() for name in ("one", "two")}
    more = sets("--runs", "2", "--jobs", "1", "--json", "--logs", "1")
    assert [line.split(",")[0] for line in more.stderr.splitlines()] == ["3 of 4: one run 1", "4 of 4: two run 1"]
    printed = json.loads(more.stdout)
    assert [row["runs"] for row in printed["rows"]] == [2, 2]
    worst = str(worst_first(list(read_results(out / "one").values()))[0].run)
    for name, logs in printed["logs"].items():
        assert list(logs) == [worst]
        assert open_log(logs[worst]).duration_s == pytest.approx(SHORT_S, abs=0.1), name
    for name, kept in before.items():
        assert (out / name / "runs.jsonl").read_bytes().startswith(kept)
        assert (out / name / "runs.csv").is_file()
    assert lines(out / "one") == lines(out / "two"), "the same draws: the same runs"
    assert "| r1 |" in sets("--table", "--markdown").stdout
    assert "holds no campaigns" in str(
        CliRunner().invoke(cli, ["campaign", "sets", "--table", "--out", str(tmp_path / "no")]).exception
    )


def test_sets_that_would_share_a_folder_are_refused(tmp_path: Path) -> None:
    files = [scenario_in(tmp_path / folder, name="same.toml") for folder in ("one", "two")]
    command = ["campaign", "sets", "--set", files[0], "--set", files[1], "--out", str(tmp_path / "out")]
    assert "would share a folder; rename one" in str(CliRunner().invoke(cli, command).exception)
    assert not (tmp_path / "out").exists()


# Summing up.


def made_up(run: int, margin: float = 0.05, **changes: Any) -> RunResult:
    return RunResult(
        run=run,
        seed=run,
        drawn={},
        laps=3,
        laps_asked=3,
        completed=True,
        margins={"cylinder 1": Margin(margin=margin, at_s=3.0, tolerance=0.010)},
        energy_j=[400.0 + run] * 3,
        lap_s=[25.0 + 0.1 * run] * 3,
        **changes,
    )


def test_bars_and_percentiles() -> None:
    summary = summarise([made_up(run, 0.001 * run) for run in range(101)], 101)
    assert summary.passed
    assert summary.failed == summary.within_tolerance == ()
    (margin,) = summary.margins
    assert margin.percentiles == pytest.approx((0.0, 0.001, 0.005, 0.050, 0.095, 0.100))
    energy = {row.name: row for row in summary.figures}["energy per lap"]
    assert energy.count == 303
    assert energy.percentiles[3] == 450.0
    assert "<= 2.92%" in [bar.value for bar in summary.bars]


@pytest.mark.parametrize(
    ("bad", "failed", "within_tolerance"),
    [
        ({"margin": -0.005}, False, True),
        ({"margin": -0.0101}, True, False),
        ({"margin": float("nan")}, True, False),
        ({"contacts": 1}, True, False),
        ({"error": "ConfigError: no"}, True, False),
        ({"judged": "contact", "margin": -0.2}, False, True),
        ({"judged": "contact", "contacts": 1}, True, False),
    ],
)
def test_what_fails_a_run(bad: dict[str, Any], failed: bool, within_tolerance: bool) -> None:
    judged = bad.get("judged", "bounds")
    runs = [made_up(0, judged=judged), made_up(1, **bad)]
    summary = summarise(runs, 2)
    assert [result.run for result in summary.failed] == [1] * failed
    assert [result.run for result in summary.within_tolerance] == [1] * within_tolerance
    assert summary.passed is not failed


def test_missing_laps_fail_only_where_they_are_asked_for() -> None:
    late = msgspec.structs.replace(made_up(0), laps=2)
    assert late.failed
    assert not msgspec.structs.replace(late, judged="contact").failed
    assert not summarise([late], 1).passed


def test_the_tube_bar_is_judged_when_a_tube_was_announced() -> None:
    name = "nodes up to 0.5 s ahead inside the announced tube"
    assert {bar.name: bar for bar in summarise([made_up(0)], 1).bars}[name].held is None
    for share, held in ((0.9995, True), (0.99, False)):
        bars = {bar.name: bar for bar in summarise([made_up(0, tube_shares=[share, 0.9, 0.7, 0.5])], 1).bars}
        assert bars[name].held is held
    loose = made_up(0, judged="contact", tube_shares=[0.5, 0.4, 0.3, 0.2])
    assert summarise([loose], 1).passed


def test_the_interval_of_the_failure_rate_covers_what_it_says() -> None:
    """Of campaigns of 40 runs with a true rate of 10 %, at least 95 % have it in their interval."""
    rng = np.random.default_rng(2)
    counts = np.bincount(rng.binomial(40, 0.1, 20_000), minlength=41)
    inside = [low <= 0.1 <= high for low, high in (failure_interval(k, 40) for k in range(41))]
    assert 0.95 <= counts[inside].sum() / counts.sum() < 1.0
    assert failure_interval(0, 300) == pytest.approx((0.0, 0.0122), abs=1e-4)
    assert failure_interval(0, 0) == (0.0, 1.0) == failure_interval(0, 0)


def test_failure_rates_that_a_result_still_allows() -> None:
    assert failure_bound(0, 300) == pytest.approx(3.0 / 300.0, rel=0.01)
    assert failure_bound(3, 3) == 1.0
    # Three failures in 100 at the bound's rate or fewer happen in 5 % of such campaigns.
    rate = failure_bound(3, 100)
    rng = np.random.default_rng(1)
    assert np.mean(rng.binomial(100, rate, 100_000) <= 3) == pytest.approx(0.05, abs=0.003)


def test_figures_of_made_up_runs(tmp_path: Path) -> None:
    runs = [made_up(run, 0.001 * run - 0.005) for run in range(30)]
    drawn_files = {path.name for path in write_figures(runs, "made up", tmp_path)}
    assert drawn_files == {f"{name}.{ending}" for name in ("margins", "energy", "laps") for ending in ("png", "pdf")}
    drawn = [msgspec.structs.replace(run, drawn={"vehicle.mismatch.drag": 0.9 + 0.01 * run.run}) for run in runs]
    drawn.append(msgspec.structs.replace(made_up(30, error="no"), drawn={"vehicle.mismatch.drag": 1.3}))
    assert "failures.png" in {path.name for path in write_figures(drawn, "made up", tmp_path)}
    assert write_figures([], "none", tmp_path) == []


def test_the_first_difference_is_named() -> None:
    old = {"a": {"b": [1, {"c": 2}]}, "d": None}
    assert first_difference(old, {"a": {"b": [1, {"c": 2}]}, "d": None}, "") == ""
    assert first_difference(old, {"a": {"b": [1, {"c": 3}]}, "d": None}, "") == "a.b[1].c was 2 and is now 3"
    assert first_difference(old, {"a": {"b": [1]}, "d": None}, "") == "a.b was [1, {'c': 2}] and is now [1]"
