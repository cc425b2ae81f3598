"""The live view through the process, as a browser sees it."""

import socket
from pathlib import Path
from typing import Any

import msgspec
import pytest
from viewers import Run, Stream, get, post, run

from autopilot.view.hub import MAX_VIEWERS
from autopilot.view.shown import Flow, Frame, Picture, Scene

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
    scene = msgspec.convert(stream.until("scene"), Scene)
    assert scene.simulated and scene.title == "small pool" and scene.limits.thrust_n == 12.0
    assert len(scene.thrusters) == 4 and scene.tank_m[1] == (3.0, -2.0)
    wanted = stream.until("frame", lambda data: data["estimate"] and data["battery"] and data["loop"])
    assert set(wanted) == set(Frame.__struct_fields__)
    frame = msgspec.convert(wanted, Frame)
    assert frame.estimate is not None and frame.truth is not None
    assert frame.estimate.pos_ned_m == pytest.approx(frame.truth.pos_ned_m, abs=0.1)
    assert frame.solids[0].center_m == (1.0, 0.5)
    assert not frame.armed and frame.mode == "HOLD" and frame.thrust_n == (0.0,) * 4
    assert {sensor.name for sensor in frame.sensors} >= {"markers"}
    later = msgspec.convert(stream.until("frame"), Frame)
    assert later.t_s > frame.t_s
    flow = msgspec.convert(stream.until("flow"), Flow)
    assert {arrow[2:] for arrow in flow.arrows} == {(0.05, 0.0)}
    stream.close()


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
    viewers = [Stream(sitl.port) for _ in range(MAX_VIEWERS + 1)]
    codes = [viewer.answer.status for viewer in viewers]
    assert codes.count(200) <= MAX_VIEWERS and codes[-1] == 503
    for viewer in viewers:
        viewer.close()


def test_pictures_come_with_what_was_found(tmp_path: Path) -> None:
    with run(tmp_path, "paper-tank") as made:
        stream = Stream(made.port, "/events?pictures=1")
        data = stream.until("picture", lambda data: len(data["markers"]) >= 2)
        picture = msgspec.convert(data, Picture)
        assert (picture.width_px, picture.height_px) == (640, 480)
        assert all(len(corners) == 4 for _, corners in picture.markers)
        assert picture.jpeg.startswith("/9j/")
        plain = Stream(made.port)
        assert [name for (name, _), _ in zip(plain.events(), range(12), strict=False)].count("picture") == 0
        assert made.end() == 0
