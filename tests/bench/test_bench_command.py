"""``autopilot bench``: one command per benchmark, and the command lines from before there were such."""

import json
from collections import Counter
from typing import Any

import pytest
from click.testing import CliRunner

from autopilot.bench.estimator_row import bench_estimator
from autopilot.cli import bench_rows
from autopilot.cli.bench import ALL, KNOWN_STUDIES, LONG, bench
from autopilot.cli.bench_rows import TITLES, Rows
from autopilot.cli.console_output import emit_json
from tests.bench import studies, tables
from tests.bench.fuzz.result import Result
from tests.bench.replays import planned_flights

OLD_LINES: dict[str, tuple[str, dict[str, Any]]] = {
    "nmpc --short": ("nmpc", {"short": True}),
    "--short nmpc": ("nmpc", {"short": True}),
    "--json --short energy --figures out": ("energy", {"as_json": True, "short": True, "figures": "out"}),
    "--only calibration --only pictures estimator": ("estimator", {"only": ("calibration", "pictures")}),
    "estimator --attitude --seeds 7..9": ("estimator", {"attitude": True, "seeds": range(7, 10)}),
    "--seed -3 fuzz --messages 10": ("fuzz", {"seed": -3, "messages": 10}),
    "fuzz": ("fuzz", {"seed": 1, "messages": None}),
    "vehicles --runs 2": ("vehicles", {"runs": 2, "seed": 1}),
    "--runs 2 --out kept thruster-health": ("thruster-health", {"runs": 2}),
    "picture-faults --kind repeated --sensors pose --seeds 3..4": (
        "picture-faults",
        {"kinds": ("repeated",), "sensors": "pose", "seeds": range(3, 5)},
    ),
    "sensor-faults --short --json": ("sensor-faults", {"short": True, "as_json": True}),
}
"""As one command with all options took them, and what they mean."""


@pytest.mark.parametrize("line", OLD_LINES)
def test_old_command_lines_go_on_working(line: str) -> None:
    name, values = OLD_LINES[line]
    context = bench.make_context("bench", line.split())
    found, command, rest = bench.resolve_command(context, [*context._protected_args, *context.args])
    assert found == name and command is not None
    given = command.make_context(name, rest, parent=context).params
    assert {key: given[key] for key in values} == values


def test_options_of_others_are_told_to_whom_they_belong() -> None:
    done = CliRunner().invoke(bench, ["nmpc", "--frames", "3"])
    assert done.exit_code == 2 and "--frames belongs to the benchmark detection" in done.output
    done = CliRunner().invoke(bench, ["--seed", "3", "nmpc"])
    assert done.exit_code == 2
    assert "belongs to the benchmarks fuzz, detection, vehicles, kills, soak and alarms" in done.output


def test_every_benchmark_has_a_title_and_says_what_it_takes() -> None:
    assert set(bench.commands) <= {*TITLES, *tables.TITLES} and set(ALL) <= set(bench.commands)
    for name, command in bench.commands.items():
        assert isinstance(command.help, str) and len(command.help) > 40, name
        assert {"short", "as_json"} <= {each.name for each in command.params}, name


def test_an_installation_knows_every_study_by_name() -> None:
    everywhere = {"estimator"}  # a study adds to its command
    assert sorted(KNOWN_STUDIES) == sorted({each.name for each in studies.COMMANDS} - everywhere)


def test_figures_of_the_fuzzer_are_readable_by_machines(capsys: pytest.CaptureFixture[str]) -> None:
    found = Result(seed=1, messages=3, seconds=2.0, accepted=Counter({"plan refused": 2}), least_m=0.5)
    emit_json(found.figures())
    told = json.loads(capsys.readouterr().out)
    assert told["accepted"] == {"plan refused": 2} and told["handled"] == {}
    assert (told["messages"], told["per_second"], told["least_m"]) == (3, 1.5, 0.5)


def test_all_are_run_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[tuple[str, bool]] = []

    def work(name: str) -> bench_rows.Work:
        def rows(short: bool) -> Rows:
            ran.append((name, short))
            return [{"case": name, "value": 1.0}]

        return rows

    monkeypatch.setattr(bench_rows, "_slowness", lambda: 1.0)
    for name in list(ALL):
        monkeypatch.setitem(ALL, name, (name, work(name)))
    done = CliRunner().invoke(bench, [])
    assert done.exit_code == 0, done.output
    assert ran == [(name, name in LONG) for name in ALL]
    assert "times slower" in done.output


def test_each_part_of_a_long_benchmark_is_told_before_the_next_begins(capsys: pytest.CaptureFixture[str]) -> None:
    told: list[str] = []

    def work(part: str) -> int:
        told.append(capsys.readouterr().err)
        return len(part)

    assert tables.printed_one_by_one(("one", "three"), work, lambda length: f"{length} letters") == [3, 5]
    assert told == ["", "1 of 2  one: 3 letters\n"]
    assert capsys.readouterr() == ("", "2 of 2  three: 5 letters\n")


@pytest.mark.long
def test_whole_flights_end_with_their_mission_where_there_is_one() -> None:
    flights = planned_flights(whole=True)
    assert {flight.scenario for flight in flights if not flight.whole} == {"narrow-gap", "vortex"}
    assert [str(flight) for flight in planned_flights(only=["b5"])] == ["b5, pose", "paper-tank, pose, in real time"]


@pytest.mark.long
def test_the_short_estimator_row_is_what_log_check_says() -> None:
    rows = bench_estimator((3,))
    assert {"estimate position rms", "estimate yaw rms", "NEES of the position"} <= {row.figure for row in rows}
    assert all(row.verdict == "pass" for row in rows)
