"""The MAVLink server: bytes in, bytes out, no clock, no socket. One call of :meth:`MavlinkServer.step` per tick.

The dialect (a 2 MB module) is imported when a server is made, not when this module is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from autopilot.core.clients import ClientRecord
from autopilot.core.geodesy import GeodeticPosition
from autopilot.core.guard import Guard
from autopilot.core.log_directory import Shelf
from autopilot.core.messages import Event, MavlinkFrame
from autopilot.core.params import ParamSaving, ParamSet
from autopilot.core.plan import PlanStore
from autopilot.core.samples import ExternalPoseSample, ObstacleTrack
from autopilot.core.witness import Witness
from autopilot.mavlink.api import FlightMode, SigningStore, Sticks, VehicleCommands, VehicleView
from autopilot.mavlink.camera_api import CameraOrders
from autopilot.mavlink.equipment_api import EquipmentOrders
from autopilot.mavlink.profiles import profile_by_name

if TYPE_CHECKING:
    from autopilot.mavlink.dispatch import Dispatcher
    from autopilot.mavlink.operators import Rights

NAME = "Underwater Autopilot"
"""The true name, in the greeting."""

_NOWHERE = GeodeticPosition(lat_deg=0.0, lon_deg=0.0, alt_m=0.0)


class MavlinkServer:
    """All microservices behind one step function.

    ``patience`` multiplies the time that a client gets in transfers: a simulation that runs k times faster than real
    time passes k, because clients live in real time. ``links`` are the indices of the links that are open from the
    start; another one is added when something comes from it, or by :meth:`add_link`. ``rates`` are the bytes per second
    of slow links, ``shelf`` holds the logs that clients may download, ``camera`` takes stills, ``equipment`` moves
    what the vehicle carries, ``witness`` notes what follows from a key. ``version`` is the distribution's, ``git`` the
    revision in hex digits, ``uid`` 64 bits. ConfigError for an unknown profile.
    """

    def __init__(
        self,
        *,
        sysid: int,
        profile: str,
        params: ParamSet,
        plans: PlanStore,
        vehicle: VehicleCommands,
        version: str,
        git: str = "",
        uid: int = 0,
        links: Sequence[int] = (0,),
        patience: float = 1.0,
        guard: Guard | None = None,
        saving: ParamSaving | None = None,
        signing: SigningStore | None = None,
        shelf: Shelf | None = None,
        rates: Mapping[int, float] | None = None,
        camera: CameraOrders | None = None,
        witness: Witness | None = None,
        equipment: EquipmentOrders | None = None,
    ) -> None:
        identity = profile_by_name(profile)
        from autopilot.mavlink.dispatch import Dispatcher, VehicleIdentity
        from autopilot.mavlink.signing import Signing

        self._profile = identity
        self._dispatcher: Dispatcher = Dispatcher(
            sysid=sysid,
            profile=identity,
            identity=VehicleIdentity(name=NAME, version=version, git=git, uid=uid),
            params=params,
            plans=plans,
            vehicle=vehicle,
            view=blank_view(),
            patience=patience,
            guard=guard or Guard(),
            saving=saving,
            signing=Signing(signing, patience, witness),
            shelf=shelf,
            rates=rates,
            camera=camera,
            equipment=equipment,
        )
        for link in links:
            self._dispatcher.add_link(link)

    def step(
        self,
        t_us: int,
        rx: Sequence[MavlinkFrame],
        view: VehicleView,
        events: Sequence[Event] = (),
        reached: Sequence[int] = (),
    ) -> tuple[MavlinkFrame, ...]:
        """Handle what was received, then heartbeats, news, retries and telemetry. Never raises on received bytes."""
        return self._dispatcher.step(t_us, rx, view, events, reached)

    def serve(self, t_us: int, rx: Sequence[MavlinkFrame]) -> tuple[MavlinkFrame, ...]:
        """Receive between two ticks. Plan transfers, parameter reads and time requests are answered at once; anything
        else waits for :meth:`step`, and with it whatever its client sends after it."""
        return self._dispatcher.serve(t_us, rx)

    def beat(self) -> tuple[MavlinkFrame, ...]:
        """A HEARTBEAT of every component for every link while the loop waits; changes nothing, may be called at any
        moment of a tick."""
        return self._dispatcher.beat()

    def standing(self, link: int, client: int) -> ClientRecord:
        """What a client of a link has shown of itself so far."""
        return self._dispatcher.standing(link, client)

    def finish(self) -> None:
        """The end of a run, before what it keeps is written."""
        self._dispatcher.finish()

    def rights(self) -> Rights:
        """Who may send what."""
        return self._dispatcher.rights()

    def custom_mode(self, mode: FlightMode) -> int:
        """The profile's custom_mode number of a mode."""
        return self._profile.custom_modes[mode]

    def add_link(self, link: int) -> None:
        """Open a link: heartbeat and telemetry go out on it from now on."""
        self._dispatcher.add_link(link)

    def remove_link(self, link: int) -> None:
        """Close a link and forget its rates."""
        self._dispatcher.remove_link(link)

    def take_notices(self) -> tuple[Event, ...]:
        """What the server itself told operators since the last call (plans taken or refused, reasons), for the log."""
        return self._dispatcher.take_notices()

    def take_samples(self) -> tuple[ExternalPoseSample, ...]:
        """Poses that clients have sent since the last call (VISION_POSITION_ESTIMATE, ODOMETRY), for the estimator."""
        return self._dispatcher.take_samples()

    def take_tracks(self) -> tuple[tuple[ObstacleTrack, ...], tuple[int, ...]]:
        """Obstacles and vehicles that others have told of since the last call, and numbers of those that have gone."""
        return self._dispatcher.take_tracks()

    @property
    def dropped_rx(self) -> int:
        """Stretches of damaged input so far, all links."""
        return self._dispatcher.dropped_rx

    @property
    def last_gcs_t_us(self) -> int | None:
        """When a ground station or companion computer last sent a HEARTBEAT; None before the first."""
        return self._dispatcher.last_gcs_t_us

    @property
    def last_pilot_t_us(self) -> int | None:
        """When a pilot's sticks were last heard; None before the first."""
        return self._dispatcher.pilot.last_us

    @property
    def sticks(self) -> Sticks | None:
        """A pilot's sticks, None = nobody steers (any more)."""
        return self._dispatcher.pilot.sticks

    @property
    def uploading(self) -> bool:
        """A plan is being transferred to us."""
        return self._dispatcher.missions.uploading

    @property
    def utc_offset_us(self) -> int | None:
        """Unix time minus service time [us] as a ground station told it (SYSTEM_TIME), None before."""
        return self._dispatcher.utility.utc_offset_us


def blank_view() -> VehicleView:
    """What there is to show before the first tick."""
    return VehicleView(
        t_us=0,
        armed=False,
        mode=FlightMode.HOLD,
        intended_mode=FlightMode.HOLD,
        nav=None,
        power=None,
        command=None,
        progress=None,
        target_ned_m=None,
        origin=_NOWHERE,
        home=_NOWHERE,
        prearm_reasons=(),
        failsafes=0,
        cpu_load=0.0,
        under_way=False,
        dropped_rx=0,
    )
