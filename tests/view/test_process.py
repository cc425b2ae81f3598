"""The live view through the process, as a browser sees it."""

import json
import socket
import time
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner
from viewers import Run, Stream, free_port, get, page_token, post, run

from autopilot.cli.sitl_command import sitl as command
from autopilot.core.errors import ConfigError
from autopilot.log.reader import open_log
from autopilot.view.http_server import ViewServer
from autopilot.view.hub import MAX_VIEWERS
from autopilot.view.page_state import FlowView, Measured, PictureView, SceneView, ViewFrame

SCENARIO = """
[scenario]
name = "small pool"
description = "A pool with one pillar"
[origin]
lat_deg = 1.0
lon_deg = 2.0
alt_m = 0.0
[tank]
polygon_m = [[-3, -2], [3, -2], [3, 2], [-3, 2]]
depth_m = 1.5
[vehicle]
model = "lbv150"
start_m = [-2.0, 0.0, 0.5]
held = true
[sensors]
position = "pose"
[current]
kind = "uniform"
velocity_m_s = [0.05, 0.0, 0.0]
[[obstacle]]
kind = "cylinder"
center_m = [1.0, 0.5]
radius_m = 0.2
"""


@pytest.fixture(scope="module")
def sitl(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A run in real time with pictures off."""
    folder = tmp_path_factory.mktemp("view")
    (folder / "pool.toml").write_text(SCENARIO)
    with run(folder, str(folder / "pool.toml"), "--log", str(folder / "run.mcap")) as made:
        made.printed("small pool: seed")
        yield made


def test_the_stream_has_every_field(sitl: Run) -> None:
    stream = Stream(sitl.port)
    assert stream.answer.getheader("Content-Type") == "text/event-stream"
    scene = msgspec.convert(stream.until("scene"), SceneView)
    assert scene.simulated and scene.title == "small pool" and scene.limits.thrust_n == 12.0
    assert len(scene.thrusters) == 4 and scene.tank_m[1] == (3.0, -2.0)
    wanted = stream.until("frame", lambda data: data["estimate"] and data["battery"] and data["loop"])
    assert set(wanted) == set(ViewFrame.__struct_fields__)
    frame = msgspec.convert(wanted, ViewFrame)
    assert frame.estimate is not None and frame.truth is not None
    assert frame.estimate.pos_ned_m == pytest.approx(frame.truth.pos_ned_m, abs=0.1)
    assert frame.solids[0].center_m == (1.0, 0.5)
    assert not frame.armed and frame.mode == "HOLD" and frame.thrust_n == (0.0,) * 4
    assert {sensor.name for sensor in frame.sensors} >= {"markers"}
    stream.until("frame", lambda data: data["t_s"] > frame.t_s)
    flow = msgspec.convert(stream.until("flow"), FlowView)
    assert {arrow[2:] for arrow in flow.arrows} == {(0.05, 0.0)}
    stream.close()


def test_the_current_of_open_water_is_shown_wherever_the_plan_can_show(tmp_path: Path) -> None:
    plan = tmp_path / "far.mission.toml"
    text = (files("autopilot") / "sitl" / "scenarios" / "open-water.mission.toml").read_text(encoding="utf-8")
    plan.write_text(text.replace(" = 6.0", " = 180.0"), encoding="utf-8")
    with run(tmp_path, "open-water", "--start", "--plan", str(plan)) as made:
        stream = Stream(made.port)
        frame = msgspec.convert(stream.until("frame", lambda data: data["estimate"]), ViewFrame)
        flow = msgspec.convert(stream.until("flow", lambda data: data["near"]), FlowView)
        stream.close()
        made.end()
    assert frame.estimate is not None
    for axis in (0, 1):
        values = [arrow[axis] for arrow in flow.arrows]
        assert min(values) < 0 and max(values) > 180 and len(set(values)) > 15
        near = sorted({arrow[axis] for arrow in flow.near})
        assert near[0] < frame.estimate.pos_ned_m[axis] - 5 and near[-1] > frame.estimate.pos_ned_m[axis] + 5
        assert near[1] - near[0] < 2
    assert {arrow[2:] for arrow in (*flow.arrows, *flow.near)} == {(0.13, 0.075)}


def test_strangers_are_refused(sitl: Run) -> None:
    port = sitl.port
    assert get(port)[0] == 200
    for host in ("evil.example", f"evil.example:{port}", "127.0.0.1.evil.example", "10.0.0.1", ""):
        assert get(port, headers={"Host": host})[0] == 403, host
    for host in ("localhost", f"localhost:{port}", "LOCALHOST:1", "[::1]:80", "127.0.0.1"):
        assert get(port, headers={"Host": host})[0] == 200, host
    for headers in (
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": f"http://127.0.0.1:{port + 1}"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ):
        assert get(port, "/events", headers)[0] == 403, headers
        assert post(port, {"do": "pause"}, headers)[0] == 403, headers
    for headers in ({"Origin": ""}, {"X-View-Token": "x"}, {"Host": "evil.example"}):
        assert post(port, {"do": "pause"}, headers)[0] == 403, headers
    assert post(port, {"do": "pause"}, {"Content-Type": "text/plain"})[0] == 415
    assert get(port, "/../../etc/passwd")[0] == 404
    headers = get(port)[1]
    assert "default-src 'none'" in headers["content-security-policy"]
    assert "access-control-allow-origin" not in headers
    stream = Stream(port)
    assert not stream.until("frame")["paused"]
    stream.close()


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"{",
        b'{"do": "dance"}',
        b'{"do": "speed", "value": 1e9}',
        b'{"do": "speed", "value": NaN}',
        b'{"do": "current", "north_m_s": 5, "east_m_s": 0}',
        b'{"do": "obstacle", "number": 0, "north_m": 0, "east_m": 0}',
        b'{"do": "obstacle", "number": 9, "north_m": 0, "east_m": 0}',
        b'{"do": "obstacle", "number": 1, "north_m": -2.0, "east_m": 0}',
        b'{"do": "fault", "fault": {"kind": "flood"}}',
        b'{"do": "fault", "fault": {"kind": "thruster_loss", "thruster": "wing"}}',
        b'{"do": "fault", "fault": {"kind": "slow_loop"}}',
        b"x" * 5000,
        b"\xff\xfe",
    ],
)
def test_bad_asks_are_answered(sitl: Run, body: bytes) -> None:
    status, answer = post(sitl.port, body)
    assert 400 <= status < 500
    assert answer["error"]


def test_ten_viewers_and_one_that_does_not_read(sitl: Run) -> None:
    deaf = socket.create_connection(("127.0.0.1", sitl.port))
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    deaf.sendall(b"GET /events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
    viewers = [Stream(sitl.port) for _ in range(10)]
    first = [viewer.until("frame")["t_s"] for viewer in viewers]
    assert viewers[0].until("frame", lambda data: data["viewers"] >= 11)
    # All others go on; the deaf one is dropped without a word.
    assert viewers[0].until("frame", lambda data: data["viewers"] == 10)
    for viewer, begin_s in zip(viewers, first, strict=True):
        assert viewer.until("frame")["t_s"] > begin_s
        viewer.close()
    deaf.close()


def test_no_room_for_a_crowd(sitl: Run) -> None:
    viewers = [Stream(sitl.port)]  # those of another test may still be leaving
    while viewers[-1].answer.status == 200 and len(viewers) <= MAX_VIEWERS:
        viewers.append(Stream(sitl.port))
    assert viewers[-1].answer.status == 503
    for viewer in viewers:
        viewer.close()


def test_what_is_asked_for_is_done(sitl: Run) -> None:
    port, stream = sitl.port, None
    while stream is None or stream.answer.status == 503:  # the crowd of another test leaves
        stream = Stream(port)
        time.sleep(0.1)
    assert post(port, {"do": "pause"})[0] == 200
    held = stream.until("frame", lambda data: data["paused"])["t_s"]
    assert stream.until("frame", lambda data: data["stale_s"] > 0.5)["t_s"] == held
    assert post(port, {"do": "speed", "value": 4})[0] == 200
    assert post(port, {"do": "go"})[0] == 200
    assert stream.until("frame", lambda data: not data["paused"] and data["t_s"] > held)["speed"] == 4.0
    assert post(port, {"do": "current", "north_m_s": 0.1, "east_m_s": -0.2})[0] == 200
    stream.until("frame", lambda data: data["extra_current_ned_m_s"] == [0.1, -0.2])
    flows = pytest.approx([0.15, -0.2, 0.0])
    stream.until("frame", lambda data: data["truth"]["current_ned_m_s"] == flows)  # from the next tick on
    stream.until("flow", lambda data: {tuple(arrow[2:]) for arrow in data["arrows"]} == {(0.15, -0.2)})
    assert post(port, {"do": "obstacle", "number": 1, "north_m": -1.0, "east_m": -0.3})[0] == 200
    stream.until("frame", lambda data: data["solids"][0]["center_m"] == [-1.0, -0.3])
    # Nobody has told the fence of it: the obstacle sensor reports it now.
    track = stream.until("frame", lambda data: data["tracks"])["tracks"][0]
    assert track["pos_ned_m"] == pytest.approx([-1.0, -0.3], abs=0.2)
    other = Stream(port)
    name = other.until("scene")["thrusters"][0]
    other.close()
    assert post(port, {"do": "fault", "fault": {"kind": "thruster_loss", "thruster": name}})[0] == 200
    silence = {"kind": "camera_blackout", "duration_s": 5.0}
    assert post(port, {"do": "fault", "fault": silence})[0] == 200
    stream.until("frame", lambda data: any(s["name"] == "markers" and s["age_s"] > 2.0 for s in data["sensors"]))
    said = [m["text"] for m in stream.until("frame")["messages"]]
    assert "View: Obstacle 1 moved to -1.00 N -0.30 E" in said and "View: Fault camera_blackout" in said
    assert f"View: Fault thruster_loss {name}" in said, "which one"
    token = page_token(port)
    assert post(port, {"do": "reset"})[0] == 200
    assert stream.until("scene")["title"] == "small pool"
    again = stream.until("frame", lambda data: data["t_s"] < held)
    assert again["solids"][0]["center_m"] == [1.0, 0.5] and again["extra_current_ned_m_s"] == [0.0, 0.0]
    assert page_token(port) == token
    stream.close()
    assert sitl.end() == 0
    # What was done stands in the log of the run; the one after the reset has a log of its own.
    folder = sitl.out.parent
    assert any(
        "View: Current +0.10 N -0.20 E" in str(m.value) for m in open_log(folder / "run.mcap").messages("/rosout")
    )
    assert (folder / "run_2.mcap").exists()


def test_a_service_that_was_killed_and_started_again_takes_what_its_stream_says(tmp_path: Path) -> None:
    """The first thing on the stream of a page that stays open is the token that the new process takes."""
    tokens: list[str] = []
    port = 0
    for turn in range(2):
        with run(tmp_path, "paper-tank", "--sensors", "pose", view=port) as made:
            stream, port = Stream(made.port), made.port
            name, hello = next(stream.events())
            assert name == "hello" and set(hello) == {"token", "version"}
            tokens.append(hello["token"])
            stream.until("frame")
            statuses = [post(port, {"do": "pause"}, token=token)[0] for token in tokens]
            assert statuses == [403] * turn + [200]
            stream.close()
            made.process.kill()
            made.process.wait()
    assert len(set(tokens)) == 2


def test_every_frame_carries_ages_in_the_vehicles_time(tmp_path: Path) -> None:
    """Tracking falls silent, the AHRS repeats itself; time that is paused ages nothing."""
    text = SCENARIO + "".join(
        f'[[fault]]\nkind = "{kind}"\nat_s = {at_s}\nduration_s = 600.0\n'
        for kind, at_s in (("camera_blackout", 2.0), ("ahrs_freeze", 3.0))
    )
    (tmp_path / "pool.toml").write_text(text)
    with run(tmp_path, str(tmp_path / "pool.toml"), "--log", str(tmp_path / "run.mcap")) as made:
        stream = Stream(made.port)
        limits = stream.until("scene")["ages"]

        def silent(data: Any, name: str, kind: str) -> bool:
            return any(each["name"] == name and each["age_s"] > each["limit_s"] for each in data[kind])

        frame = stream.until("frame", lambda data: silent(data, "markers", "sensors"))
        assert not silent(frame, "ahrs", "devices") and frame["estimate"]["age_s"] <= limits["estimate_s"]
        frame = stream.until("frame", lambda data: silent(data, "ahrs", "devices"))
        assert frame["estimate"]["age_s"] > limits["estimate_s"], "an estimate is no newer than its attitude"
        assert not silent(frame, "battery", "devices") and frame["battery"]["age_s"] < limits["battery_s"]
        assert post(made.port, {"do": "pause"})[0] == 200
        held = stream.until("frame", lambda data: data["paused"] and data["stale_s"] > 1.0)
        later = stream.until("frame", lambda data: data["stale_s"] > held["stale_s"] + 1.0)
        assert later["devices"] == held["devices"] and later["sensors"] == held["sensors"]
        assert later["sent_s"] > held["sent_s"] + 1.0
        stream.close()


def test_pictures_come_with_what_was_found(tmp_path: Path) -> None:
    with run(tmp_path, "paper-tank") as made:
        stream = Stream(made.port, "/events?pictures=1")
        data = stream.until("picture", lambda data: len(data["markers"]) >= 2)
        picture = msgspec.convert(data, PictureView)
        assert (picture.width_px, picture.height_px) == (640, 480)
        assert all(len(corners) == 4 for _, corners in picture.markers)
        assert picture.jpeg.startswith("/9j/")
        plain = Stream(made.port)
        assert [name for (name, _), _ in zip(plain.events(), range(12), strict=False)].count("picture") == 0
        assert made.end() == 0


def test_a_real_vehicle_is_only_shown_and_to_its_network_where_asked(tmp_path: Path) -> None:
    config = tmp_path / "rov.toml"
    config.write_text(
        'vehicle = "bluerov2"\n[devices.flight_controller]\ndriver = "ardusub"\nframe = "vectored"\n'
        f'connect = "udpin:127.0.0.1:{free_port()}"\n'
    )
    with run(tmp_path, "--config", str(config), "--view-address", "0.0.0.0", command="run") as made:
        own = ("127.0.0.1", "localhost:80", "192.168.2.2", f"192.168.2.2:{made.port}", "[fe80::1]:80", "BlueOS.local")
        for host in own:
            assert get(made.port, headers={"Host": host})[0] == 200, host
        for host in ("evil.example", "local", "blueos.local.evil.example", "192.168.2.2.evil.example", "blueos", ""):
            assert get(made.port, headers={"Host": host})[0] == 403, host
        for origin in ("http://evil.example", "http://192.168.2.2:9000", "http://192.168.2.3"):
            assert get(made.port, "/events", {"Host": "192.168.2.2", "Origin": origin})[0] == 403, origin
        assert "frame-ancestors 'self'" in get(made.port)[1]["content-security-policy"]
        status, headers, body = get(made.port, "/register_service")
        service = json.loads(body)
        assert status == 200 and headers["content-type"] == "application/json"
        assert service["version"] == version("underwater-autopilot") and service["works_in_relative_paths"] is True
        for name in ("name", "description", "icon", "company", "version", "webpage", "api"):
            assert isinstance(service[name], str), name
        stream = Stream(made.port)
        scene = msgspec.convert(stream.until("scene"), SceneView)
        assert not scene.simulated and scene.steerable.faults == () and not scene.steerable.pause
        frame = msgspec.convert(stream.until("frame"), ViewFrame)
        assert frame.estimate is None and frame.truth is None and frame.solids == () and not frame.paused
        assert frame.measured == Measured(rpy_rad=None, depth_m=None), "no device has said anything"
        asks: tuple[dict[str, object], ...] = (
            {"do": "pause"},
            {"do": "reset"},
            {"do": "speed", "value": 2},
            {"do": "current", "north_m_s": 0.1, "east_m_s": 0.0},
            {"do": "obstacle", "number": 1, "north_m": 0.0, "east_m": 0.0},
            {"do": "fault", "fault": {"kind": "leak"}},
        )
        for ask in asks:
            status, answer = post(made.port, ask)
            assert status == 409 and "read-only" in answer["error"]
        assert not stream.until("frame", lambda data: data["t_s"] > frame.t_s)["paused"]
        stream.close()
        assert made.end() == 0


def test_a_port_that_is_taken_or_none_is_named() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=f"port {port} of 127.0.0.1 cannot be had"):
            ViewServer(port)
    for wrong in ("paper-tank", "70000", "1e3"):
        done = CliRunner().invoke(command, ["--view", wrong])
        assert done.exit_code == 2 and "is no port" in done.output
