"""Cutting a stream into MAVLink frames."""

from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.drivers.framing import FrameCutter


def v1(payload: bytes) -> bytes:
    return bytes([0xFE, len(payload), 0, 1, 1, 0]) + payload + b"\x12\x34"


def v2(payload: bytes, signed: bool = False) -> bytes:
    head = bytes([0xFD, len(payload), int(signed), 0, 0, 1, 1, 0, 0, 0])
    return head + payload + b"\x12\x34" + (bytes(13) if signed else b"")


FRAMES = st.one_of(st.builds(v1, st.binary(max_size=255)), st.builds(v2, st.binary(max_size=255), st.booleans()))


@settings(deadline=None)
@given(st.lists(FRAMES, max_size=6), st.data())
def test_whole_frames_come_out_however_the_stream_is_cut(frames: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(frames)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    cutter, out = FrameCutter(), []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        out += cutter.feed(stream[start:end])
    assert out == frames
    assert cutter.skipped == 0


@settings(deadline=None)
@given(st.lists(st.binary(max_size=400), max_size=6))
def test_any_bytes_never_raise_and_little_is_kept(chunks: list[bytes]) -> None:
    cutter = FrameCutter()
    fed = sum(map(len, chunks))
    out = sum(len(frame) for chunk in chunks for frame in cutter.feed(chunk))
    assert out + cutter.skipped + len(cutter._buffer) == fed
    assert len(cutter._buffer) <= 280


@settings(deadline=None)
@given(st.binary(max_size=40), st.binary(max_size=255))
def test_finds_its_way_back_after_noise(noise: bytes, payload: bytes) -> None:
    frame = v2(payload.replace(b"\xfd", b"-").replace(b"\xfe", b"-"))
    cutter = FrameCutter()
    out = cutter.feed(noise + 30 * frame)  # longer than any frame that the noise may seem to begin
    assert out[-1] == frame


def test_text_is_skipped() -> None:
    cutter = FrameCutter()
    assert cutter.feed(b"GET / HTTP/1.1\r\n\r\n") == []
    assert cutter.skipped == 18
