"""What the page shows is of now, or grey with its age: on what a process has sent."""

import copy
import re
from typing import Any

import pytest
from browser_module import needs_browser
from scripted_page import page
from viewers import Stream, run

from autopilot.core.vehicle import load_vehicle, vehicle_names
from autopilot.view.ages import LEAST_S, MISSED, age_limits, sensor_limits_s

Event = dict[str, Any]
LIVE = {
    "now",
    "alarms",
    "plan",
    "side",
    "legend",
    "flow",
    "state",
    "bars",
    "thrusters",
    "sensors",
    "messages",
    "camera",
    "pwm",
    "pace",
}
"""Everything that is grey once nothing comes any more."""
GREEN = "#27d07d"


@pytest.fixture(scope="module")
def heard(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Event]:
    """The newest of each event of a flight with pictures, once a picture with markers has been seen."""
    newest: dict[str, Event] = {}
    with run(tmp_path_factory.mktemp("ages"), "paper-tank", "--start") as made:
        for name, data in Stream(made.port, "/events?pictures=1").events():
            newest[name] = {"name": name, "data": data}
            frame, picture = (newest.get(kind, {}).get("data", {}) for kind in ("frame", "picture"))
            if name == "frame" and frame["estimate"] and frame["battery"] and picture.get("markers"):
                break
        made.end()
    return newest


class Page:
    """A page as events reach it. Times are vehicle times from that of the first frame on."""

    def __init__(self, heard: dict[str, Event]) -> None:
        self._heard = heard
        self.lines: list[Event] = [heard["hello"], heard["scene"], heard["flow"]]
        self.lines[0] = {"name": "hello", "data": {"token": "token", "version": ""}}
        self._t_s = heard["frame"]["data"]["t_s"]
        self._sent_s = 100.0

    def frame(self, *, late_s: float = 0.0, **changed: Any) -> None:
        """A frame of now; ``late_s``: it was that long on its way."""
        data = copy.deepcopy(self._heard["frame"]["data"])
        data |= {"t_s": self._t_s, "sent_s": self._sent_s - late_s, "stale_s": 0.0, "paused": False}
        self.lines.append({"name": "frame", "data": data | changed})

    def picture(self) -> None:
        """A picture that was taken now."""
        self.lines.append({"name": "picture", "data": self._heard["picture"]["data"] | {"t_s": self._t_s}})

    def wait(self, seconds: float, speed: float = 1.0) -> None:
        """Nothing comes for so long."""
        self.lines.append({"wait": seconds})
        self._t_s += speed * seconds
        self._sent_s += seconds

    def runs(self, seconds: float, *, speed: float = 1.0, pictures: bool = True, **changed: Any) -> None:
        """Frames ten times per second of real time, pictures five times."""
        for count in range(round(10 * seconds)):
            self.wait(0.1, speed)
            self.frame(**changed)
            if pictures and count % 2 == 0:
                self.picture()

    def note(self, name: str) -> None:
        """Keep what stands there now."""
        self.lines.append({"note": name})

    def made(self) -> dict[str, Any]:
        """What has become of it."""
        return page(self.lines)


@pytest.fixture
def seen(heard: dict[str, Event]) -> Page:
    return Page(heard)


def changed(heard: dict[str, Event], part: str, **fields: Any) -> dict[str, Any]:
    """A part of the frame with other fields."""
    return {part: heard["frame"]["data"][part] | fields}


@needs_browser
@pytest.mark.parametrize("speed", [0.05, 0.25, 1.0, 8.0, 20.0])
def test_nothing_is_grey_while_all_comes_at_any_speed(seen: Page, speed: float) -> None:
    for moment in range(6):
        seen.runs(0.5, speed=speed)
        seen.note(str(moment))
    notes = seen.made()["notes"].values()
    assert len(notes) == 6
    for note in notes:
        assert note["stale"] == [] and "old" not in " ".join(note["words"].values()) and GREEN in note["camera"]
        assert note["words"]["frameage"] == "0.0 s" and note["words"]["link"] == ""


@needs_browser
@pytest.mark.parametrize("speed", [0.25, 1.0, 8.0])
def test_a_picture_of_before_a_blackout_is_grey_and_says_how_old_it_is(seen: Page, speed: float) -> None:
    seen.runs(1.0, speed=speed)
    seen.note("before")
    seen.runs(max(12.0 / speed, 4.0), speed=speed, pictures=False)
    seen.note("dark")
    seen.runs(0.5, speed=speed)
    seen.note("again")
    notes = seen.made()["notes"]
    for name in ("before", "again"):
        assert "camera" not in notes[name]["stale"] and GREEN in notes[name]["camera"], name
    assert notes["dark"]["stale"] == ["camera"], "all else is of now"
    assert GREEN not in notes["dark"]["camera"] and 'opacity="0.4"' in notes["dark"]["camera"]
    told = re.search(r"no picture for (\d+) s", notes["dark"]["camera"])
    assert told is not None and float(told[1]) == pytest.approx(max(12.0, 4.0 * speed), abs=0.3 * speed + 0.5)
    assert notes["dark"]["words"]["cameraage"] == f"{told[1]} s old"


@needs_browser
@pytest.mark.parametrize("state", [0, 1, 2])
def test_when_the_process_is_gone_everything_is_grey_with_its_age(seen: Page, state: int) -> None:
    """0: the browser tries again; 1: killed behind a tunnel, or stopped, the stream stays open; 2: it has given up."""
    seen.runs(1.0)
    seen.note("before")
    if state != 1:
        seen.lines.append({"stream": state, "event": "error"})
    for _ in range(7):
        seen.wait(0.5)
    seen.note("after")
    made = seen.made()
    assert made["notes"]["before"]["stale"] == []
    after = made["notes"]["after"]
    assert set(after["stale"]) >= LIVE and "3.5 s" in after["words"]["link"]
    for part in ("frame", "plan", "side", "state", "bars", "thrusters", "sensors", "messages", "camera"):
        assert "3.5 s old" in after["words"][f"{part}age"] or "3.6 s old" in after["words"][f"{part}age"], part
    assert (len(made["streams"]) > 1) is (state == 2), "what the browser gives up is asked for anew"


@needs_browser
def test_a_stream_that_says_nothing_for_long_is_opened_anew(seen: Page) -> None:
    seen.runs(1.0)
    for _ in range(20):
        seen.wait(0.5)
    made = seen.made()
    assert len(made["streams"]) == 2 and set(made["stale"]) >= LIVE


@needs_browser
def test_a_pause_ages_nothing_and_a_loop_that_hangs_everything(seen: Page) -> None:
    seen.runs(1.0)
    for held in range(20):
        seen.wait(0.5, speed=0.0)
        seen.frame(paused=True, stale_s=0.5 * (held + 1))
    seen.note("paused")
    seen.runs(0.5)
    for held in range(8):
        seen.wait(0.5, speed=0.0)
        seen.frame(stale_s=0.5 * (held + 1))
    seen.note("hangs")
    notes = seen.made()["notes"]
    assert notes["paused"]["stale"] == [] and GREEN in notes["paused"]["camera"]
    assert set(notes["hangs"]["stale"]) >= LIVE
    assert notes["hangs"]["words"]["link"] == "the loop has been silent for 4.0 s"
    assert notes["hangs"]["words"]["stateage"] == "4.0 s old"


@needs_browser
def test_what_comes_late_is_as_old_as_it_is(seen: Page) -> None:
    """A thin line behind a tunnel: frames come as often, but each later than the one before."""
    seen.runs(1.0)
    for count in range(60):
        seen.wait(0.1)
        seen.frame(late_s=0.1 * (count + 1))
    seen.note("late")
    late = seen.made()["notes"]["late"]
    assert set(late["stale"]) >= LIVE - {"camera"} and late["words"]["frameage"] == "6.0 s old"
    assert "the connection is slow" in late["words"]["link"]


@needs_browser
def test_a_tab_that_slept_shows_nothing_of_what_lay_in_its_buffers(seen: Page) -> None:
    seen.runs(1.0)
    old = copy.deepcopy(seen.lines[-1])
    seen.lines[-1] = {"sleep": 600.0}
    seen.lines += [old | {"to": 0}] * 3
    seen.note("woken")
    made = seen.made()
    assert len(made["streams"]) == 2, "a new stream"
    woken = made["notes"]["woken"]
    assert set(woken["stale"]) >= LIVE and woken["words"]["frameage"] == "10 min old"


@needs_browser
def test_each_group_goes_grey_by_its_own_limit(seen: Page, heard: dict[str, Event]) -> None:
    limits = heard["scene"]["data"]["ages"]
    for name, part, limit_s in (("state", "estimate", limits["estimate_s"]), ("row", "battery", limits["battery_s"])):
        for which, share in (("fresh", 0.8), ("old", 1.2)):
            seen.runs(0.2, **changed(heard, part, age_s=share * limit_s))
            seen.note(f"{name} {which}")
    seen.runs(0.2, **changed(heard, "estimate", health="INVALID"))
    seen.note("invalid")
    seen.runs(0.2, estimate=None)
    seen.note("none")
    notes = seen.made()["notes"]
    assert notes["state fresh"]["stale"] == [] and notes["state fresh"]["rows"] == 0
    assert notes["state old"]["stale"] == ["dials", "bars"] and notes["state old"]["rows"] == 5
    assert notes["row fresh"]["rows"] == 0 and notes["row old"]["rows"] == 1
    body = "#0b6fa4"
    vehicle = f'stroke="{body}" stroke-width="2.0"'
    assert vehicle in notes["state fresh"]["plan"] and vehicle not in notes["state old"]["plan"]
    assert vehicle not in notes["invalid"]["plan"] and notes["invalid"]["words"]["planage"] == "estimate invalid"
    assert notes["none"]["words"]["stateage"] == "no estimate"


@needs_browser
def test_a_device_that_is_silent_is_named_for_as_long_as_it_is(seen: Page, heard: dict[str, Event]) -> None:
    devices = heard["frame"]["data"]["devices"]
    assert {"ahrs", "camera", "battery"} <= {device["name"] for device in devices}
    for device in devices:
        silent = [one | {"age_s": 900.0 if one is device else 0.1 * one["limit_s"]} for one in devices]
        seen.runs(0.1, devices=silent)
        seen.note(device["name"])
    for name, note in seen.made()["notes"].items():
        words = note["words"]["sensors"]
        assert f"{name} device silent" in words and words.count("device silent") == 1 and "15 min" in words


@needs_browser
def test_after_a_restart_the_page_is_of_the_new_process(seen: Page) -> None:
    """Same page, same port: until its first frame all is grey, what was seen is forgotten, controls go to it."""
    seen.runs(1.0)
    seen.lines += [{"stream": 0, "event": "error"}, {"wait": 0.5}, {"stream": 1, "event": "open"}]
    seen.lines += [{"event": "click", "name": "pause", "data": {}}, {"note": "sent"}]
    seen.lines.append({"name": "hello", "data": {"token": "another", "version": ""}})
    seen.note("hello")
    seen.lines.append({"name": "scene", "data": seen._heard["scene"]["data"]})
    seen.frame(t_s=0.3, sent_s=5.0)
    seen.note("frame")
    seen.lines += [{"event": "click", "name": "pause", "data": {}}]
    made = seen.made()
    assert set(made["notes"]["hello"]["stale"]) >= LIVE
    assert made["notes"]["frame"]["stale"] == [] and "no picture" in made["notes"]["frame"]["camera"]
    first, second = made["requests"]
    assert "token" not in first and second["token"] == "another"


@needs_browser
def test_a_refused_token_is_asked_for_anew_and_another_page_is_loaded(seen: Page) -> None:
    seen.runs(0.5)
    seen.lines += [{"refuse": 403}, {"event": "click", "name": "pause", "data": {}}, {"note": "refused"}]
    assert len(seen.made()["streams"]) == 2


def test_limits_come_from_the_nominal_rates() -> None:
    for name in vehicle_names():
        vehicle = load_vehicle(name)
        limits, sensors = age_limits(vehicle), sensor_limits_s(vehicle)
        assert limits.estimate_s == max(LEAST_S, MISSED / vehicle.ahrs.rate_hz)
        assert sensors["dvl"] == max(LEAST_S, MISSED / vehicle.dvl.rate_hz)
        assert limits.picture_s >= MISSED / vehicle.eye.rate_hz + vehicle.eye.latency_s
