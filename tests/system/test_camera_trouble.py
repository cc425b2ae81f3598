"""A camera that shows nothing is named within a second, once, and again when it is well; its counts reach everybody."""

from pathlib import Path

import pytest
from pymavlink.dialects.v20 import development as mav
from system_harness import OpenSession
from wire_client import Harbour, WireClient

from autopilot.command.environment import FOGGY, MESSAGES, SILENT
from autopilot.core.messages import Outputs
from autopilot.core.operator_messages import CAMERA_WORKS
from autopilot.log.analysis import last_counts
from autopilot.log.packing.record_values import COUNTER_NAMES
from autopilot.log.reader import open_log
from autopilot.log.report import write_report
from autopilot.sitl.scenario import scenario_path

TEXTS = {name: row.template for name, row in MESSAGES.items()}
WELL = CAMERA_WORKS.template

TROUBLES = {"black": "dark", "white": "bright", "frozen": "frozen", "fog": FOGGY}
FIRST_S, EACH_S, LASTS_S, RATE_HZ = 1.5, 2.6, 1.3, 12.0


def scenario_with(tmp_path: Path, turbidity: float, faults: str) -> str:
    text = scenario_path("paper-tank").read_text(encoding="utf-8")
    assert "[camera]" not in text
    path = tmp_path / "scenario.toml"
    path.write_text(
        f"{text}\n[camera]\nturbidity_1_m = {turbidity}\n[sensors.camera]\nrate_hz = {RATE_HZ}\n{faults}",
        encoding="utf-8",
    )
    return str(path)


@pytest.mark.long
def test_each_trouble_is_told_within_a_second_and_when_it_is_over(session: OpenSession, tmp_path: Path) -> None:
    faults, log = "", tmp_path / "run.mcap"
    for number, looks in enumerate(TROUBLES):
        faults += f'[[fault]]\nkind = "camera_picture"\nlooks = "{looks}"\n'
        faults += f"at_s = {FIRST_S + EACH_S * number}\nduration_s = {LASTS_S}\n"
    said: list[tuple[float, str]] = []

    def on_tick(outputs: Outputs) -> None:
        said.extend((1e-6 * e.t_us, e.text) for e in outputs.events if e.text in (*TEXTS.values(), WELL))

    client = WireClient()
    flying = session(scenario_with(tmp_path, 0.5, faults), sensors="camera", log=log, peers=(client,), on_tick=on_tick)
    client.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    Harbour(flying).run(FIRST_S + EACH_S * len(TROUBLES) + 0.4)
    flying.runtime.close()
    flying.recorder.close()

    assert [text for _, text in said] == [text for name in TROUBLES.values() for text in (TEXTS[name], WELL)]
    for number in range(len(TROUBLES)):
        begin_s = FIRST_S + EACH_S * number
        assert begin_s < said[2 * number][0] <= begin_s + 1.0
        assert begin_s + LASTS_S < said[2 * number + 1][0] <= begin_s + LASTS_S + 1.0
    texts = client.texts(least=mav.MAV_SEVERITY_DEBUG)
    assert {text for _, text in said} <= set(texts), "STATUSTEXT"

    counts = last_counts(open_log(log))
    for name in ("dark", "bright", "frozen", "foggy"):
        assert 0.5 * RATE_HZ * LASTS_S < counts[f"frames.{name}"] <= RATE_HZ * LASTS_S + 1
    assert counts["frames.ok"] > 50
    assert counts["other"] == 0, "every count has its place"
    page = write_report(open_log(log), tmp_path / "report.html").read_text(encoding="utf-8")
    assert f"<td>frames.frozen</td><td>{counts['frames.frozen']}</td>" in page
    refused = sum(counts[f"frames.{name}"] for name in ("dark", "bright", "frozen"))
    status = [message for message in client.inbox if message.get_type() == "SYS_STATUS"]
    assert status[-1].errors_count2 >= refused - RATE_HZ


def test_thick_haze_in_which_markers_are_found_is_no_trouble(session: OpenSession, tmp_path: Path) -> None:
    said: list[str] = []
    flying = session(
        scenario_with(tmp_path, 2.5, ""),
        sensors="camera",
        on_tick=lambda outputs: said.extend(event.text for event in outputs.events),
    )
    Harbour(flying).run(2.5)
    assert not set(said) & {*TEXTS.values(), WELL}


def test_a_camera_that_falls_silent_is_told(session: OpenSession, tmp_path: Path) -> None:
    said: list[tuple[float, str]] = []
    fault = '[[fault]]\nkind = "camera_blackout"\nat_s = 1.5\nduration_s = 1.5\n'
    flying = session(
        scenario_with(tmp_path, 0.5, fault),
        sensors="camera",
        on_tick=lambda outputs: said.extend((1e-6 * event.t_us, event.text) for event in outputs.events),
    )
    Harbour(flying).run(4.5)
    told = [(t_s, text) for t_s, text in said if text in (TEXTS[SILENT], WELL)]
    assert [text for _, text in told] == [TEXTS[SILENT], WELL]
    assert told[0][0] <= 2.5
    assert told[1][0] <= 4.0


@pytest.mark.parametrize("text", [*TEXTS.values(), WELL])
def test_texts_fit_into_one_statustext(text: str) -> None:
    assert len(text) <= 50


def test_every_counter_has_one_place() -> None:
    names = [name for name in COUNTER_NAMES if name]
    assert len(names) == len(set(names))
