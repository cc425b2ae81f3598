"""The service itself: what came into a tick, what it cost, and the bytes of the links."""

from autopilot.core.messages import Inputs, LoopStats
from autopilot.log.cdr import ENCAPSULATION
from autopilot.log.packing.parts import FRD, NS, UINT16, UINT32, clip
from autopilot.log.schemas import layout

_loop_stats = layout("autopilot_msgs/LoopStats").packer.pack
_input_tick = layout("autopilot_msgs/InputTick").packer.pack
_mavlink_frame = layout("autopilot_msgs/MavlinkFrame").packer.pack

MAVLINK_MAX_BYTES = 280
"""Largest MAVLink 2 packet with signature (mavlink.io, Packet Serialization)."""
ALL_LINKS = 255
"""``MavlinkFrame.link`` for a frame that goes to all links."""


def input_tick(stamp_ns: int, inputs: Inputs) -> bytes:
    """InputTick: opens the group of messages that one call of ``step`` took in."""
    return _input_tick(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *FRD,
        clip(len(inputs.samples), UINT16),
        clip(len(inputs.mavlink_rx), UINT16),
        clip(inputs.overruns, UINT32),
        inputs.cpu_load,
    )


def loop_stats(stamp_ns: int, stats: LoopStats) -> bytes:
    """LoopStats."""
    return _loop_stats(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *FRD,
        stats.tick_s,
        stats.cpu_s,
        clip(stats.overruns, UINT32),
        clip(stats.dropped_log, UINT32),
        clip(stats.dropped_frames, UINT32),
        int(stats.late_part),
        *stats.part_s,
        *stats.part_cpu_s,
    )


def mavlink_frame(stamp_ns: int, data: bytes, link: int, client: int = 0) -> bytes:
    """MavlinkFrame of at most MAVLINK_MAX_BYTES bytes; link -1 = all links, client 0 = everyone there."""
    number = link if 0 <= link < ALL_LINKS else ALL_LINKS
    return _mavlink_frame(ENCAPSULATION, *divmod(stamp_ns, NS), *FRD, data, len(data), number, client & UINT16)
