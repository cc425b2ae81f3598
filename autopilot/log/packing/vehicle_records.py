"""The vehicle: what it does in the simulation, and in the same form what the estimator believes."""

from typing import Protocol

from autopilot.core.frames import FloatArray
from autopilot.core.messages import MAX_THRUSTERS, NavState
from autopilot.log.cdr import ENCAPSULATION
from autopilot.log.packing.parts import FRD, NED, NS, UINT32, clip, padded
from autopilot.log.packing.records import packer_of
from autopilot.log.schemas import layout

vehicle_state = packer_of(NavState, "VehicleState", "ned")
"""Of the truth or of the estimate."""
_thruster_state = layout("autopilot_msgs/ThrusterState").packer.pack
_contact_state = layout("autopilot_msgs/ContactState").packer.pack


class TruthLike(Protocol):
    """What the log needs of the simulated vehicle: shapes and frames as in ``autopilot_msgs/VehicleState``."""

    @property
    def pos_ned_m(self) -> FloatArray: ...
    @property
    def rpy_rad(self) -> FloatArray: ...
    @property
    def vel_frd_m_s(self) -> FloatArray: ...
    @property
    def vel_water_frd_m_s(self) -> FloatArray: ...
    @property
    def rate_frd_rad_s(self) -> FloatArray: ...
    @property
    def current_ned_m_s(self) -> FloatArray: ...
    @property
    def thrust_n(self) -> FloatArray:
        """(n,) acting force of each thruster, n <= 8."""
        ...

    @property
    def power_w(self) -> float:
        """Electrical power drawn from the battery: thrusters and everything else."""
        ...


def thruster_state(stamp_ns: int, truth: TruthLike) -> bytes:
    """ThrusterState: acting forces and electrical power."""
    return _thruster_state(
        ENCAPSULATION, *divmod(stamp_ns, NS), *FRD, *padded(truth.thrust_n, MAX_THRUSTERS), float(truth.power_w)
    )


def contact_state(stamp_ns: int, count: int, penetration_m: float) -> bytes:
    """ContactState: contacts of the simulated hull begun so far, and how deep the deepest of now is."""
    return _contact_state(ENCAPSULATION, *divmod(stamp_ns, NS), *NED, clip(count, UINT32), penetration_m)
