"""What a step took in beside samples, as it is logged and read again."""

from dataclasses import fields

import msgspec

from autopilot.core.clients import Reach
from autopilot.core.guard import Fault
from autopilot.core.messages import (
    Authority,
    Between,
    DeviceRole,
    DeviceTrouble,
    Event,
    FlightControllerState,
    Inputs,
    MavlinkFrame,
)
from autopilot.core.nondeterminism import Note
from autopilot.core.samples import FrameVerdict, PictureReport
from autopilot.core.stills import CameraReport, StoredStill
from autopilot.log.mavlink_frames import NOTHING_REMOVED, StreamCutter
from autopilot.log.packing import step_notes
from autopilot.mavlink.dialect import mav


def test_every_input_comes_back_from_its_notes() -> None:
    """All fields of Inputs: one that is added and not noted fails here."""
    event = Event(t_us=9, severity=4, text="link back")
    given = Inputs(
        t_us=20_000,
        overruns=3,
        cpu_load=0.25,
        mavlink_rx=(MavlinkFrame(link=1, data=b"abc", client=2, sender="gcs", reach=Reach.MACHINE),),
        notices=(event,),
        troubles=(DeviceTrouble(t_us=10_000, device=DeviceRole.CAMERA, text="gone"),),
        pictures=(
            PictureReport(t_us=5, verdict=FrameVerdict.DARK, contrast=1.5, white_fraction=0.1, black_fraction=0.9),
        ),
        log_lost=True,
        clock_jump_s=-0.5,
        frame_counts={"frames.ok": 7},
        below=FlightControllerState(
            t_us=19_000, authority=Authority.PILOT, acts=False, text="MANUAL", pulses_us=(1500, 1600), armed=True
        ),
        refusals=("no AHRS",),
        camera=CameraReport(frame_us=None, total_bytes=10, free_bytes=5, refusal="full"),
        stills=(StoredStill(index=1, exposure_us=4, path="a.png", width_px=6, height_px=4, size=99),),
        between=(Between(t_us=15_000, frames=1), Between(t_us=None)),
        answers=(Note("routes ready", 2, True), Note("parameters saved", 1, (4, ""))),
        faults=(Fault(t_us=1, part="p", kind="k", place="here", text="t", traceback="tb", inputs="i"),),
    )
    bare = Inputs(t_us=given.t_us)
    blank = {field.name for field in fields(Inputs) if getattr(given, field.name) == getattr(bare, field.name)}
    assert blank == {"t_us", "samples"}
    notes = step_notes.notes_of(given, [NOTHING_REMOVED], step_notes.LatchedNotes())
    assert notes is not None
    again = step_notes.unpack(msgspec.json.encode(notes).decode(), "here")
    bare = Inputs(t_us=given.t_us, overruns=3, cpu_load=0.25)
    back = step_notes.inputs_with(bare, again, (b"abc",), step_notes.LatchedNotes())
    for field in fields(Inputs):
        assert repr(getattr(back, field.name)) == repr(getattr(given, field.name)), field.name


def test_a_key_is_another_in_the_notes_and_its_packet_as_good() -> None:
    key = bytes(range(1, 33))
    codec = mav.MAVLink(None, 255, 190)
    packet = bytes(mav.MAVLink_setup_signing_message(1, 1, key, 77).pack(codec))
    beat = bytes(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3).pack(codec))
    cutter = StreamCutter()
    pieces = cutter.cut(beat + packet + beat)
    assert [piece.data for piece in pieces] == [beat, beat]
    assert cutter.removed.count == len(packet)
    ((offset, other),) = cutter.removed.keys
    assert offset == len(beat)
    assert key not in other and len(other) == len(packet)
    (message,) = mav.MAVLink(None).parse_buffer(other)
    assert message.get_type() == "SETUP_SIGNING"
    assert message.initial_timestamp == 77
    assert bytes(message.secret_key) == b"\xa5" * 32
