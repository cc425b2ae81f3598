"""The camera component and its stills: the real service, the simulated camera, a client of raw MAVLink."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from pymavlink.dialects.v20 import development as mav
from system_harness import OpenSession
from wire_client import Harbour, WireClient

from autopilot.core.background import BackgroundWorker
from autopilot.log.directory_reader import LogDirectoryReader
from autopilot.log.export import export_stills
from autopilot.log.reader import open_log

CAMERA = 100


class CameraClient(WireClient):
    """Asks the camera, or whoever is told, and keeps the answers of each component."""

    def ask(self, harbour: Harbour, command: int, *params: float, component: int = CAMERA) -> tuple[int, int]:
        """COMMAND_LONG; result and the component that answered."""
        self.inbox.clear()
        filled = (*params, *(0.0,) * (7 - len(params)))
        self.send(mav.MAVLink_command_long_message(1, component, command, 0, *filled))

        def acks() -> list[Any]:
            return [m for m in self.received("COMMAND_ACK") if m.command == command]

        harbour.until(lambda: bool(acks()))
        harbour.tick()
        assert len(acks()) == 1
        return acks()[0].result, acks()[0].get_srcComponent()

    def pictures(self) -> list[Any]:
        return self.received("CAMERA_IMAGE_CAPTURED")


def test_a_client_finds_the_camera_and_gets_every_message(session: OpenSession, tmp_path: Path) -> None:
    client = CameraClient()
    harbour = Harbour(session(sensors="camera", peers=(client,), log=tmp_path / "run.mcap"))
    harbour.run(1.1)
    beats = [m for m in client.received("HEARTBEAT") if m.get_srcComponent() == CAMERA]
    assert len(beats) == 2
    assert (beats[0].type, beats[0].autopilot) == (mav.MAV_TYPE_CAMERA, mav.MAV_AUTOPILOT_INVALID)

    asked = {
        "CAMERA_INFORMATION": (521, 1.0),
        "CAMERA_SETTINGS": (522, 1.0),
        "STORAGE_INFORMATION": (525, 0.0, 1.0),
        "CAMERA_CAPTURE_STATUS": (527, 1.0),
    }
    for name, legacy in asked.items():
        number = getattr(mav, f"MAVLINK_MSG_ID_{name}")
        for component in (CAMERA, 0):
            assert client.ask(harbour, mav.MAV_CMD_REQUEST_MESSAGE, number, component=component) == (0, CAMERA)
            (message,) = client.received(name)
            assert message.get_srcComponent() == CAMERA
        for component in (CAMERA, 0):
            assert client.ask(harbour, int(legacy[0]), *legacy[1:], component=component) == (0, CAMERA)
            assert [m.get_srcComponent() for m in client.received(name)] == [CAMERA]
        # The autopilot does not say it as its own: clients would take it for another camera.
        assert client.ask(harbour, int(legacy[0]), *legacy[1:], component=1) == (mav.MAV_RESULT_UNSUPPORTED, 1)
    client.ask(harbour, 521, 1.0)
    (about,) = client.received("CAMERA_INFORMATION")
    assert (about.resolution_h, about.resolution_v) == (640, 480)
    assert about.flags == mav.CAMERA_CAP_FLAGS_CAPTURE_IMAGE
    client.ask(harbour, 525, 1.0, 1.0)
    (storage,) = client.received("STORAGE_INFORMATION")
    assert storage.total_capacity > storage.available_capacity > 0.0


REFUSED = (
    (mav.MAV_CMD_VIDEO_START_CAPTURE, (0.0, 1.0), "no video"),
    (mav.MAV_CMD_VIDEO_STOP_CAPTURE, (0.0,), "no video"),
    (mav.MAV_CMD_VIDEO_START_STREAMING, (0.0,), "no video"),
    (mav.MAV_CMD_REQUEST_VIDEO_STREAM_INFORMATION, (0.0,), "no video"),
    (mav.MAV_CMD_SET_CAMERA_MODE, (0.0, 1.0), "no video"),
    (mav.MAV_CMD_SET_CAMERA_ZOOM, (0.0, 1.0), "no zoom"),
    (mav.MAV_CMD_SET_CAMERA_FOCUS, (0.0, 1.0), "no focus"),
    (mav.MAV_CMD_STORAGE_FORMAT, (1.0, 1.0), "not formatted"),
    (mav.MAV_CMD_REQUEST_STORAGE_INFORMATION, (7.0, 1.0), "Storage 7"),
    (mav.MAV_CMD_IMAGE_START_CAPTURE, (0.0, 0.01, 5.0), "interval"),
    (mav.MAV_CMD_IMAGE_START_CAPTURE, (0.0, 1.0, -2.0), "-2 pictures"),
    (mav.MAV_CMD_DO_SET_CAM_TRIGG_DIST, (-1.0,), "every -1 m"),
    (mav.MAV_CMD_REQUEST_CAMERA_IMAGE_CAPTURE, (3.0,), "no photo 3"),
)


def test_clients_count_their_stills_for_themselves(session: OpenSession, tmp_path: Path) -> None:
    """MAVSDK numbers from 1 each time it is started."""
    clients = CameraClient(), CameraClient()
    harbour = Harbour(session(sensors="camera", peers=clients, log=tmp_path / "run.mcap"))
    harbour.run(2.0)
    for number, client in enumerate(clients):
        assert client.ask(harbour, mav.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 0.0, 1.0, 1.0) == (0, CAMERA)
        harbour.run(1.0)
        assert [m.image_index for m in client.pictures()] == [number]


def test_what_it_cannot_do_is_refused_with_the_reason(session: OpenSession, tmp_path: Path) -> None:
    client = CameraClient()
    harbour = Harbour(session(sensors="camera", peers=(client,), log=tmp_path / "run.mcap"))
    harbour.tick()
    texts: list[str] = []
    for command, params, reason in REFUSED:
        result, _ = client.ask(harbour, command, *params)
        texts += client.texts()
        assert result == mav.MAV_RESULT_DENIED, command
        assert any(reason in text for text in texts), (command, texts)  # the same reason is not said twice in 5 s


def test_a_still_is_in_the_log_in_full_size_with_its_pose(session: OpenSession, tmp_path: Path) -> None:
    client, log = CameraClient(), tmp_path / "run.mcap"
    flown = session(sensors="camera", peers=(client,), log=log)
    harbour = Harbour(flown)
    harbour.run(2.0)
    asked_ms = 2000
    assert client.ask(harbour, mav.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 0.0, 1.0, 1.0) == (0, CAMERA)
    harbour.until(lambda: bool(client.pictures()))
    (told,) = client.pictures()
    assert (told.image_index, told.capture_result, told.get_srcComponent()) == (0, 1, CAMERA)
    assert asked_ms <= told.time_boot_ms <= asked_ms + 200
    # The autopilot passes on what is sent to it; a repeated order is the same still; one that is there is told again.
    assert client.ask(harbour, mav.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 0.0, 1.0, 2.0, component=1) == (0, 1)
    harbour.run(0.5)
    assert client.ask(harbour, mav.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 0.0, 1.0, 2.0) == (0, CAMERA)
    harbour.run(0.5)
    assert not client.pictures()
    assert client.ask(harbour, mav.MAV_CMD_REQUEST_CAMERA_IMAGE_CAPTURE, 1.0) == (0, CAMERA)
    assert [m.image_index for m in client.pictures()] == [1]
    truth = flown.device.truth.pos_ned_m
    flown.runtime.close()
    flown.recorder.close()

    found = open_log(log)
    stills = found["/payload/still"]
    assert stills["index"].tolist() == [0, 1]
    assert stills["stored"].all() and stills["pose_known"].all()
    assert abs(stills["t_us"][0] * 1e-3 - told.time_boot_ms) < 1.0
    assert np.linalg.norm(stills["pos_ned_m"] - truth, axis=1).max() < 0.1
    assert (stills["variance"] > 0.0).all()
    images = found.messages("/payload/image")
    assert [image.t_us for image in images] == stills["t_us"].tolist()
    for number, image in enumerate(images):
        assert image.value["format"] == "png"
        data = bytes(image.value["data"])
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert pixels is not None and pixels.shape == (480, 640, 3)
        assert log.with_name(f"run.still-{number:04d}.png").read_bytes() == data
        assert len(data) == stills["size"][number]
    assert [path.name for path in export_stills(found, tmp_path / "out")] == ["0000.png", "0001.png"]
    assert (tmp_path / "out" / "0001.png").read_bytes() == data
    # Who downloads logs finds the stills beside them, and nothing else.
    shelf = LogDirectoryReader(tmp_path / "elsewhere", BackgroundWorker(), log)
    listing = shelf.list(0).poll(1)
    assert listing is not None
    names = {file.path for file in listing.get()}
    assert names == {"run.mcap", "run.tlog", "run.still-0000.png", "run.still-0001.png"}
    piece = shelf.read(0, "run.still-0001.png", 0, 4).poll(1)
    assert piece is not None and piece.get() == b"\x89PNG"
    outside = shelf.read(0, "out/0001.png", 0, 4).poll(1)
    assert outside is not None and outside.error is not None


def test_sequences_by_time_end_by_count_and_by_order(session: OpenSession, tmp_path: Path) -> None:
    client = CameraClient()
    harbour = Harbour(session(sensors="camera", peers=(client,), log=tmp_path / "run.mcap"))
    harbour.run(0.5)
    assert client.ask(harbour, mav.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 0.5, 3.0)[0] == 0
    harbour.run(2.5)
    pictures = client.pictures()
    assert [m.image_index for m in pictures] == [0, 1, 2]
    steps = np.diff([m.time_boot_ms for m in pictures])
    assert np.abs(steps - 500).max() <= 100
    assert client.ask(harbour, mav.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 0.5, 0.0)[0] == 0
    client.ask(harbour, 527, 1.0)
    (status,) = client.received("CAMERA_CAPTURE_STATUS")
    assert status.image_status in (2, 3) and status.image_interval == 0.5
    harbour.run(1.2)
    assert client.ask(harbour, mav.MAV_CMD_IMAGE_STOP_CAPTURE, 0.0)[0] == 0
    harbour.run(0.5)
    client.inbox.clear()
    harbour.run(1.0)
    assert not client.pictures()
    client.ask(harbour, 527, 1.0)
    (status,) = client.received("CAMERA_CAPTURE_STATUS")
    assert status.image_status == 0 and 5 <= status.image_count <= 7


def test_without_pictures_there_is_no_camera_and_nothing_hangs(session: OpenSession) -> None:
    client = CameraClient()
    harbour = Harbour(session(sensors="pose", peers=(client,)))
    harbour.run(1.5)
    assert {m.get_srcComponent() for m in client.received("HEARTBEAT")} == {1}
    for command in (521, 527, mav.MAV_CMD_IMAGE_START_CAPTURE, mav.MAV_CMD_VIDEO_START_CAPTURE):
        assert client.ask(harbour, command, 1.0, component=1) == (mav.MAV_RESULT_UNSUPPORTED, 1)


def test_a_camera_that_goes_dark_and_a_log_that_is_not_there(session: OpenSession, tmp_path: Path) -> None:
    client = CameraClient()
    harbour = Harbour(session(sensors="camera", peers=(client,)))
    harbour.run(0.1)
    assert client.ask(harbour, mav.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 0.0, 1.0)[0] == (
        mav.MAV_RESULT_TEMPORARILY_REJECTED
    )
    assert any("no log" in text for text in client.texts())

    other = CameraClient()
    silent = session(sensors="camera", peers=(other,), log=tmp_path / "run.mcap")
    _silence(silent.device)
    harbour = Harbour(silent)
    harbour.run(0.1)
    assert other.ask(harbour, mav.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 0.0, 1.0)[0] == 0
    harbour.run(2.2)
    (failed,) = other.pictures()
    assert failed.capture_result == 0
    assert any("Photo 0 failed: camera delivers no picture" in text for text in other.texts())


def _silence(device: Any) -> None:
    """The camera's cable is off."""
    nothing: Callable[[int], tuple[()]] = lambda t_us: ()  # noqa: E731
    device.frames = nothing
