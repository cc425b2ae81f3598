"""The service itself: what came into a tick, what it cost, and the bytes of the links."""

from autopilot.core.messages import MAX_THRUSTERS, Authority, Below, Inputs, LoopStats, ProcessStats
from autopilot.log.cdr import ENCAPSULATION
from autopilot.log.packing.parts import FRD, NS, UINT16, clip
from autopilot.log.packing.records import packer_of
from autopilot.log.schemas import layout

loop_stats = packer_of(LoopStats, "LoopStats", "frd")
process_stats = packer_of(ProcessStats, "ProcessStats", "frd", put={"rss": lambda stats: stats.rss_bytes})
input_tick = packer_of(
    Inputs,
    "InputTick",
    "frd",
    put={
        "samples": lambda inputs: clip(len(inputs.samples), UINT16),
        "frames": lambda inputs: clip(len(inputs.mavlink_rx), UINT16),
    },
)
"""Opens the group of messages that one call of ``step`` took in."""
_below = layout("autopilot_msgs/Below").packer.pack
_parameter_change = layout("autopilot_msgs/ParameterChange").packer.pack
_mavlink_frame = layout("autopilot_msgs/MavlinkFrame").packer.pack

_AUTHORITIES = tuple(Authority)
ARMED = (False, True, None)
"""In the log by their place."""
_TEXT_BYTES, _PROBLEM_BYTES, _REFUSALS_BYTES = 64, 128, 512
"""Widths of the texts in Below."""

MAVLINK_MAX_BYTES = 280
"""Largest MAVLink 2 packet with signature (mavlink.io, Packet Serialization)."""
ALL_LINKS = 255
"""``MavlinkFrame.link`` for a frame that goes to all links."""


def below(stamp_ns: int, value: Below) -> bytes:
    """Below: the flight controller below us, texts cut to what the fields hold."""
    known = value.pulses_us[:MAX_THRUSTERS]
    return _below(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *FRD,
        _AUTHORITIES.index(value.authority),
        int(value.acts),
        len(known),
        *(clip(pulse, UINT16) for pulse in known),
        *(0,) * (MAX_THRUSTERS - len(known)),
        _text(value.text, _TEXT_BYTES),
        _text(value.problem, _PROBLEM_BYTES),
        _text("".join(f"{line}\n" for line in value.refusals), _REFUSALS_BYTES),
        ARMED.index(value.armed),
        int(value.rival),
    )


def _text(text: str, width: int) -> bytes:
    """UTF-8 of at most so many bytes, no character cut in two."""
    return text.encode(errors="replace")[:width].decode(errors="ignore").encode()


def parameter_change(stamp_ns: int, name: str, value: float) -> bytes:
    """ParameterChange."""
    return _parameter_change(ENCAPSULATION, *divmod(stamp_ns, NS), *FRD, name.encode("ascii", "replace"), value)


def mavlink_frame(stamp_ns: int, data: bytes, link: int, client: int = 0) -> bytes:
    """MavlinkFrame of at most MAVLINK_MAX_BYTES bytes; link -1 = all links, client 0 = everyone there."""
    number = link if 0 <= link < ALL_LINKS else ALL_LINKS
    return _mavlink_frame(ENCAPSULATION, *divmod(stamp_ns, NS), *FRD, data, len(data), number, client & UINT16)
