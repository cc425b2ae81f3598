"""What the vehicle carries: what moves, and its stills."""

from collections.abc import Sequence

from autopilot.core.payload import MAX_PAYLOAD, PayloadState
from autopilot.core.stills import StillRecord
from autopilot.log.cdr import ENCAPSULATION
from autopilot.log.packing.parts import FRD, NED, NS, UINT16, UINT32, clip, padded
from autopilot.log.packing.records import packer_of
from autopilot.log.schemas import layout

outputs = packer_of(
    PayloadState, "PayloadOutputs", "frd", put={"pulse_us": lambda state: padded(state.pulses_us, MAX_PAYLOAD)}
)
"""The pulses that are commanded."""
_truth = layout("autopilot_msgs/PayloadTruth").packer.pack
_still = layout("autopilot_msgs/Still").packer.pack

_UNKNOWN3 = (0.0,) * 3
_UNKNOWN6 = (0.0,) * 6


def still(stamp_ns: int, record: StillRecord) -> bytes:
    """Still: where the vehicle was when it was exposed, and what became of it."""
    pos, rpy, variance, taken = record.pos_ned_m, record.rpy_rad, record.variance, record.still
    return _still(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *NED,
        clip(taken.index, UINT32),
        record.seq,
        0 if taken.problem else 1,
        0 if pos is None else 1,
        *(_UNKNOWN3 if pos is None else pos.tolist()),
        *(_UNKNOWN3 if rpy is None else rpy.tolist()),
        *(_UNKNOWN6 if variance is None else variance.tolist()),
        clip(taken.width_px, UINT16),
        clip(taken.height_px, UINT16),
        clip(taken.size, UINT32),
        (record.t_us - taken.exposure_us) * 1e-6,
    )


def truth(stamp_ns: int, shares: Sequence[float]) -> bytes:
    """PayloadTruth: where simulated equipment really is."""
    return _truth(ENCAPSULATION, *divmod(stamp_ns, NS), *FRD, *padded(shares, MAX_PAYLOAD))
