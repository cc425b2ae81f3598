"""``autopilot log export|diff|recover|find`` on logs that are whole, cut off, foreign and missing."""

import csv
import json
import resource
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from log_synthetic import Run, write_run

from autopilot.cli.main import cli
from autopilot.core.errors import LogError, UnknownNameError
from autopilot.log.container import read_contents
from autopilot.log.reader import open_log


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With every topic."""
    return write_run(tmp_path_factory.mktemp("tools") / "flown.mcap", Run(laps=1, step_us=500_000, full_inputs=True))


def call(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["log", *map(str, arguments)])


def test_export_holds_every_digit(flown: Path, tmp_path: Path) -> None:
    done = call("export", flown, "--out", tmp_path)
    assert done.exit_code == 0, done.output
    log = open_log(flown)
    assert len(done.output.splitlines()) == sum(info.count > 0 for info in log.topics.values())
    with (tmp_path / "nav_state.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    nav = log["/nav/state"]
    assert [int(row["t_us"]) for row in rows] == nav["t_us"].tolist()
    for axis in range(3):
        assert np.array_equal([float(row[f"pos_ned_m[{axis}]"]) for row in rows], nav["pos_ned_m"][:, axis])
    with (tmp_path / "ctl_horizon.csv").open(newline="") as file:
        paths = [json.loads(row["poses"]) for row in csv.DictReader(file)]
    assert len(paths) == log.topics["/ctl/horizon"].count and paths[0][0]["pose"]
    with (tmp_path / "rosout.csv").open(newline="") as file:
        events = list(csv.DictReader(file))
    assert [row["msg"] for row in events] == [event.value["msg"] for event in log.messages("/rosout")]


def test_export_of_some_topics_and_of_none_such(flown: Path, tmp_path: Path) -> None:
    done = call("export", flown, "--topic", "/sys/mode", "--out", tmp_path / "out")
    assert done.output.split() == [str(tmp_path / "out" / "sys_mode.csv")]
    done = call("export", flown, "--topic", "/sys/mood")
    assert "has no topic /sys/mood; did you mean /sys/mode? it has " in str(done.exception)


@pytest.mark.parametrize("command", ["export", "recover"])
def test_a_full_disk_leaves_what_was_there(flown: Path, tmp_path: Path, command: str) -> None:
    unfinished, table = tmp_path / "unfinished.mcap", tmp_path / "sys_mode.csv"
    unfinished.write_bytes(flown.read_bytes()[:-8])
    table.write_text("the old one")
    before = {path: path.read_bytes() for path in (unfinished, table)}
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (16, hard))
    try:
        done = call(command, unfinished, *(("--out", tmp_path) if command == "export" else ()))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert isinstance(done.exception, LogError) and "cannot be written (File too large)" in str(done.exception)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    "command",
    [
        ("replay", "--out"),
        ("replay", "--only", "estimator", "--out"),
        ("replay", "--step", "1", "--figure"),
        ("report", "--out"),
    ],
)
def test_no_result_is_written_over_its_log(flown: Path, tmp_path: Path, command: tuple[str, ...]) -> None:
    log, link = tmp_path / "mine.mcap", tmp_path / "link.mcap"
    log.write_bytes(flown.read_bytes())
    link.symlink_to(log)
    for out in (log, link):
        done = call(command[0], log, *command[1:], out)
        assert done.exit_code == 2 and "would be lost; name another file" in done.output
    assert log.read_bytes() == flown.read_bytes()


def test_parquet_needs_pyarrow(flown: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    done = call("export", flown, "--format", "parquet", "--out", tmp_path)
    told = str(done.exception or done.output)
    assert done.exit_code == 1 and "pip install pyarrow" in told
    extra = told[told.index("extra [") + len("extra [") :].split("]")[0]
    extras = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    named = [name for name, packages in extras["optional-dependencies"].items() if f"{packages}".count("pyarrow")]
    assert named == [extra], "one extra brings it, and the message names it"


def test_parquet_where_pyarrow_is(flown: Path, tmp_path: Path) -> None:
    parquet: Any = pytest.importorskip("pyarrow.parquet")
    done = call("export", flown, "--format", "parquet", "--out", tmp_path)
    assert done.exit_code == 0, done.output
    log = open_log(flown)
    for topic in (name for name, info in log.topics.items() if info.count):
        table = parquet.read_table(tmp_path / f"{topic.strip('/').replace('/', '_')}.parquet")
        assert table.column_names == list(log.columns(topic)) and table.num_rows == log.topics[topic].count


def test_a_topic_that_a_damaged_log_lacks_is_no_usage_error(flown: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(flown.read_bytes()[:100])
    done = call("export", cut, "--topic", "/nav/state", "--out", tmp_path)
    assert done.exit_code == 1 and "it has none" in str(done.exception) and "cut off" in str(done.exception)
    done = call("export", flown, "--topic", "/no/such", "--out", tmp_path)
    assert isinstance(done.exception, UnknownNameError)


def test_what_is_nested_has_a_column_for_each_number(flown: Path) -> None:
    log = open_log(flown)
    columns = log.columns("/in/ahrs")
    assert np.array_equal(columns["orientation.w"], log["/in/ahrs"]["orientation"]["w"])
    numbers = {name: np.asarray(column).dtype.kind for name, column in columns.items()}
    assert set(numbers.values()) <= set("fiub"), numbers


def test_diff_names_the_first_difference(flown: Path, tmp_path: Path) -> None:
    same = call("diff", flown, flown)
    assert same.exit_code == 0 and "the same messages" in same.output
    other = write_run(tmp_path / "other.mcap", Run(laps=2, step_us=500_000))
    done = call("diff", flown, other)
    assert done.exit_code == 1 and "/nav/state" in done.output and "messages" in done.output
    listed = json.loads(call("diff", flown, other, "--json").output)
    assert {"topic", "field", "t_s", "what"} == set(listed["differences"][0])
    left = json.loads(call("diff", flown, other, "--ignore", "/nav/state", "--json").output)
    assert not [one for one in left["differences"] if one["topic"] == "/nav/state"]


def test_recover(flown: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(flown.read_bytes()[: flown.stat().st_size * 2 // 3])
    done = call("recover", cut)
    assert done.exit_code == 3 and "messages saved" in done.output
    assert open_log(cut).verify() == ()
    again = call("recover", cut)
    assert again.exit_code == 0 and "nothing to repair" in again.output
    junk = tmp_path / "junk.mcap"
    junk.write_bytes(b"nothing of the kind")
    assert call("recover", tmp_path).exit_code == 1
    for place in (junk, tmp_path / "none.mcap"):
        done = call("recover", place)
        assert done.exit_code == 1 and str(place) in str(done.exception or done.output)


def test_damage_within_a_finished_log_is_named_by_every_command(flown: Path, tmp_path: Path) -> None:
    """A stretch of zeros where the file system lost a block: the end of the file, and with it the index, are sound."""
    chunk = read_contents(flown).chunks[2]
    data = bytearray(flown.read_bytes())
    data[chunk.offset + 60 : chunk.offset + 200] = bytes(140)
    hurt = tmp_path / "hurt.mcap"
    hurt.write_bytes(data)
    before = hurt.read_bytes()
    for args in (("programs", hurt), ("diff", hurt, hurt), ("export", hurt, "--out", tmp_path / "csv")):
        done = call(*args)
        assert done.exit_code == 3, args[0]
        assert f"{hurt}: " in done.output and "left out" in done.output, args[0]
    done = call("recover", hurt)
    assert done.exit_code == 1 and "left as it is" in done.output and "it was finished" in done.output
    assert hurt.read_bytes() == before
    assert json.loads(call("diff", hurt, flown, "--json").stdout)["problems"]
    assert json.loads(call("diff", flown, flown, "--json").stdout)["problems"] == []


def test_find(flown: Path, tmp_path: Path) -> None:
    (tmp_path / "day").mkdir()
    (tmp_path / "day" / "a.mcap").write_bytes(flown.read_bytes())
    (tmp_path / "b.mcap").write_bytes(flown.read_bytes()[:5000])
    (tmp_path / "c.mcap").write_bytes(b"junk")
    found = {Path(one["path"]).name: one for one in json.loads(call("find", tmp_path, "--json").output)}
    assert set(found) == {"a.mcap", "b.mcap", "c.mcap"}
    assert found["a.mcap"]["problem"] == "" and found["b.mcap"]["problem"] and found["c.mcap"]["problem"]
    key, value = next(iter(open_log(flown).run.items()))
    some = json.loads(call("find", tmp_path, "--where", f"{key}={value}", "--json").output)
    assert "a.mcap" in {Path(one["path"]).name for one in some}
    assert json.loads(call("find", tmp_path, "--where", f"{key}=no such {value}", "--json").output) == []
    assert "a.mcap" in call("find", tmp_path).output
    assert call("find", tmp_path / "none").exit_code == 1
    assert call("find", tmp_path, "--where", "nonsense").exit_code == 1
    slip = call("find", tmp_path, "--where", "scenaro=x")
    assert isinstance(slip.exception, UnknownNameError) and "did you mean scenario?" in str(slip.exception)
