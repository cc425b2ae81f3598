"""Every row of the table of failsafes has a fault scenario; some are flown here, all by ``campaign faults``."""

import importlib
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

from autopilot.campaign import fault_campaign
from autopilot.campaign.fault_campaign import fly_campaign, results, table, tasks
from autopilot.campaign.fault_cases import CASES, FaultCase
from autopilot.campaign.fault_flights import SCENARIOS, FaultResult, fly_fault_case
from autopilot.cli.campaign import campaign
from autopilot.command.failsafe_table import ROWS, FailsafeRow
from autopilot.core.errors import ConfigError
from autopilot.core.messages import Failsafe
from autopilot.core.params import ParamSet
from autopilot.sitl.scenario_tables import Fault

BY_RULE = {case.rule: case for case in CASES}


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.rule.name)
def test_a_row_has_a_scenario_that_can_be_flown_and_asks_for_an_effect_of_the_row(row: FailsafeRow) -> None:
    case = BY_RULE[row.rule]
    params = ParamSet({**case.params, **case.set_then})
    for fault in case.faults:
        msgspec.convert({**fault, "at_s": 1.0}, Fault)
    assert case.faults or case.set_then or case.controller or case.estimator
    for module, _, name in (part.partition(":") for part in (case.controller, case.estimator) if part and ":" in part):
        assert hasattr(importlib.import_module(module), name)
    assert case.effect in row.effects or case.rule.name == "FAULT"  # FAULT: the guard acts, docs/reliability.md
    if row.action:
        assert row.effects[int(params[row.action])] == case.effect


@pytest.mark.long
@pytest.mark.parametrize("rule", ["SOLVER", "COLLISION"])
def test_the_failsafe_comes_in_time_and_the_vehicle_ends_as_promised(rule: str) -> None:
    """What takes the longest ways: a controller that is broken, a motion that is felt."""
    case = BY_RULE[Failsafe[rule]]
    result = fly_fault_case(case, "paper-tank", seed=7, at_s=6.0)
    assert result.armed and result.contacts == 0
    assert result.raised_s is not None and 0.0 <= result.raised_s <= case.within_s
    assert result.kept, result


def test_what_a_flight_draws_depends_on_nothing_but_its_name() -> None:
    some, more = tasks(2), tasks(5)
    assert len(some) == 2 * len(ROWS) * len(SCENARIOS) and more[: len(some)] == some
    assert [task.key for task in tasks(2, ["LEAK"])] == [task.key for task in some if task.case.rule.name == "LEAK"]
    assert len({task.at_s for task in more}) > len(more) // 2
    with pytest.raises(ConfigError, match="row 'LEEK' is not known; did you mean LEAK"):
        tasks(1, ["LEEK"])


def made_up(task: fault_campaign.FaultTask) -> FaultResult:
    return FaultResult(
        rule=task.case.rule.name,
        scenario=task.scenario,
        seed=task.seed,
        at_s=task.at_s,
        effect=task.case.effect,
        armed=True,
        raised_s=0.5,
        acted_s=None,
        end="HOLD at 0.40 m",
        kept=True,
        closest_m=0.4,
        contacts=0,
        texts=("one",),
    )


def test_a_campaign_goes_on_where_it_was_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flown: list[tuple[str, str, int]] = []

    def fly(case: FaultCase, scenario: str, seed: int, at_s: float) -> FaultResult:
        flown.append((case.rule.name, scenario, seed))
        return made_up(next(task for task in tasks(2) if task.key == flown[-1]))

    monkeypatch.setattr(fault_campaign, "fly_fault_case", fly)
    wanted = tasks(2, ["LEAK", "GCS"], ["harbour"])
    first = fly_campaign(tmp_path, wanted)
    next(first)
    next(first)
    first.close()
    with (tmp_path / fault_campaign.FILE).open("a") as file:
        file.write('\n{"rule": "LEAK", "scena')
    assert len(results(tmp_path)) == 2
    assert len(list(fly_campaign(tmp_path, wanted))) == 2
    assert sorted(flown) == sorted(task.key for task in wanted)
    rows = table(list(results(tmp_path).values()))
    assert [(row.rule, row.flights, row.kept, row.reaction_s) for row in rows] == [
        ("GCS", 2, 2, 0.5),
        ("LEAK", 2, 2, 0.5),
    ]
    shown = CliRunner().invoke(campaign, ["faults", "--runs", "2", "--out", str(tmp_path), "--table", "--markdown"])
    assert shown.exit_code == 0 and "| LEAK | harbour | 2 | drop | 0.5 | HOLD 2 | 0.4 | 0 | 2 |" in shown.output
