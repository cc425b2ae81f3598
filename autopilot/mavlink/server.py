"""The MAVLink server: bytes in, bytes out, no clock, no socket.

One call of :meth:`MavlinkServer.step` per tick. It composes the microservices and dispatches every message to its
handler.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from autopilot.core import operator_messages as notices
from autopilot.core.clients import EVERYONE, ClientRecord
from autopilot.core.clock import TICK_US
from autopilot.core.geodesy import GeodeticPosition
from autopilot.core.guard import Guard, Work
from autopilot.core.log_directory import LogDirectory
from autopilot.core.messages import Event, MavlinkFrame
from autopilot.core.nondeterminism import NondeterminismSource
from autopilot.core.params import ParamSaving, ParamSet
from autopilot.core.plan import MissionResult, PlanStore
from autopilot.core.samples import ExternalPoseSample, ObstacleTrack
from autopilot.mavlink.api import (
    CameraOrders,
    CommandReply,
    CommandResult,
    EquipmentOrders,
    FlightMode,
    SigningStore,
    VehicleCommands,
    VehicleView,
)
from autopilot.mavlink.bounded_table import LatestUsed, RecentKeys
from autopilot.mavlink.budget import Budget
from autopilot.mavlink.camera_component import CAMERA_COMPID, CameraComponent
from autopilot.mavlink.commands import Call, CommandProtocol, action, call_of, setting
from autopilot.mavlink.context import COMMANDS, COMPID, MISSION_COMPID, NAME, Context, MavlinkPeer, VehicleIdentity
from autopilot.mavlink.dialect import extra, mav, message_ids
from autopilot.mavlink.equipment_commands import EquipmentCommands
from autopilot.mavlink.events import ArmingEvents, Events
from autopilot.mavlink.external_poses import ExternalPoses
from autopilot.mavlink.flight_information import FlightInformation
from autopilot.mavlink.ftp import FileTransfer
from autopilot.mavlink.gimbal import Gimbal
from autopilot.mavlink.high_latency import HighLatency
from autopilot.mavlink.inbox import MAX_INBOXES, Address, Inbox, MessageInbox
from autopilot.mavlink.logs import LogDownload
from autopilot.mavlink.maintenance import Maintenance
from autopilot.mavlink.metadata import ComponentMetadata, make_metadata
from autopilot.mavlink.missions import Missions
from autopilot.mavlink.operators import GRAVE_COMMANDS, REQUEST, STATUS_ID, Operators, Rights, rights
from autopilot.mavlink.output_messages import OutputMessages
from autopilot.mavlink.parameters import Parameters
from autopilot.mavlink.periodic_messages import PeriodicMessages
from autopilot.mavlink.pilot import PilotInputs
from autopilot.mavlink.profiles import profile_by_name
from autopilot.mavlink.progress import ProgressMessages
from autopilot.mavlink.requests import Requests
from autopilot.mavlink.routing import Router
from autopilot.mavlink.sensor_messages import SensorMessages
from autopilot.mavlink.setpoints import SetPoints
from autopilot.mavlink.signing import Signing
from autopilot.mavlink.signing_setup import SigningSetup
from autopilot.mavlink.status import StatusMessages
from autopilot.mavlink.streams import Streams
from autopilot.mavlink.stubs import VehicleFacts
from autopilot.mavlink.telemetry import Builder, NavigationMessages
from autopilot.mavlink.traffic import TrafficReports
from autopilot.mavlink.utility import Utility
from autopilot.mavlink.vehicle_commands import VehicleService
from autopilot.mavlink.wire import Message

_OPERATORS = frozenset((mav.MAV_TYPE_GCS, mav.MAV_TYPE_ONBOARD_CONTROLLER))
_OUR_COMPONENTS = frozenset((0, COMPID, MISSION_COMPID))

_URGENT = message_ids(
    "MISSION_COUNT MISSION_ITEM_INT MISSION_ITEM MISSION_REQUEST_LIST MISSION_REQUEST_INT MISSION_REQUEST"
    " MISSION_ACK PARAM_REQUEST_LIST PARAM_REQUEST_READ PING TIMESYNC FILE_TRANSFER_PROTOCOL"
)
"""Answered between ticks: transfers at the client's rate. The message that ends an upload is not among them."""
_HEAVY = message_ids("COMMAND_LONG COMMAND_INT SET_MODE SET_GPS_GLOBAL_ORIGIN MISSION_CLEAR_ALL PARAM_SET")

_ONCE = message_ids(
    "MISSION_COUNT MISSION_ITEM_INT MISSION_ITEM MISSION_CLEAR_ALL MISSION_ACK MISSION_SET_CURRENT SET_MODE"
    " SET_GPS_GLOBAL_ORIGIN PARAM_SET REQUEST_DATA_STREAM LOG_REQUEST_END LOG_ERASE LOG_REQUEST_LIST"
    " LOG_REQUEST_DATA FILE_TRANSFER_PROTOCOL COMMAND_CANCEL"
)
"""A copy of these that comes late would undo what the client has sent meanwhile (commands have an answer to repeat)."""

VERSION_US = 10_000_000
"""A client that has sent MAVLink 1 only for so long uses that."""

_ZERO = GeodeticPosition(lat_deg=0.0, lon_deg=0.0, alt_m=0.0)

Handler = Callable[[MavlinkPeer, Message], None]


class MavlinkServer:
    """All microservices behind one step function.

    Parameters
    ----------
    sysid
        MAVLink system id of the vehicle.
    profile
        Name of the identity profile (ConfigError for an unknown one).
    params, plans, vehicle
        Parameters, plan store and vehicle that clients read and command.
    version, git, uid
        Version of the distribution, revision in hex digits, 64-bit unique id of this vehicle.
    links
        Indices of the links that are open from the start. Others are added when data arrive from them, or by
        :meth:`add_link`.
    patience
        Factor on the timeouts of transfers: a simulation that runs k times faster than real time passes k, because
        clients live in real time.
    shelf, camera, equipment
        Log directory for clients, camera, payload outputs; None = none.
    rates
        Bytes per second of slow links.
    nondeterminism
        Recorder of results that depend on a signing key.
    facts
        What parameters of other firmwares say of the vehicle.
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
        log_directory: LogDirectory | None = None,
        rates: Mapping[int, float] | None = None,
        camera: CameraOrders | None = None,
        nondeterminism: NondeterminismSource | None = None,
        equipment: EquipmentOrders | None = None,
        facts: VehicleFacts | None = None,
    ) -> None:
        identity = VehicleIdentity(name=NAME, version=version, git=git, uid=uid)
        self._ctx = ctx = Context(
            sysid=sysid,
            profile=profile_by_name(profile),
            identity=identity,
            params=params,
            plans=plans,
            vehicle=vehicle,
            view=blank_view(),
            patience=patience,
            guard=guard or Guard(),
            saving=saving,
            signing=Signing(signing, patience, nondeterminism),
            budgets={link: Budget(rate / patience) for link, rate in (rates or {}).items()},
        )
        self.parameters = Parameters(ctx, facts or VehicleFacts(sysid=sysid))
        metadata = make_metadata(self.parameters.specs, ctx.profile, name=identity.name, version=identity.version)

        def load() -> float:
            """Of the loop, as file transfers see it."""
            return 1.0 if ctx.view.armed else ctx.view.cpu_load

        self._files = FileTransfer(ctx, metadata.files, log_directory, self.parameters.packed_file, load)
        self._logs = LogDownload(ctx, log_directory, load)
        self._operators = Operators(ctx, self.parameters.known_value)
        self.missions = Missions(ctx, self._operators.keeps_out)
        self.utility = Utility(ctx)
        self.pilot = PilotInputs(ctx, equipment, camera)
        self._set_points = SetPoints(ctx)
        self._external = ExternalPoses(ctx, lambda: self.utility.utc_offset_us)
        self._others = TrafficReports(ctx)
        self._status = StatusMessages(ctx)
        self._telemetry = NavigationMessages(ctx)
        self._sensors = SensorMessages(ctx, self._telemetry)
        self._outputs = OutputMessages(ctx, self._telemetry, lambda: self.pilot.gain, equipment)
        gimbal = Gimbal(ctx, equipment)
        self._progress = ProgressMessages(ctx, self.missions)
        self._flight = FlightInformation(ctx)
        self._events = Events(ctx)
        self._arming = ArmingEvents(ctx, self._events)
        builders: dict[int, Builder] = {}
        self._streams = Streams(ctx, builders)
        self._high_latency = HighLatency(ctx, self._streams, self._status, self._telemetry, self._progress)
        builders.update(
            {
                **self._flight.builders(),
                **self._high_latency.builders(),
                **self._status.builders(),
                **self._telemetry.builders(),
                **self._sensors.builders(),
                **self._outputs.builders(),
                **gimbal.builders(),
                **ComponentMetadata(ctx, metadata).builders(),
                mav.MAVLINK_MSG_ID_MISSION_CURRENT: self._progress.mission_current,
                mav.MAVLINK_MSG_ID_SYSTEM_TIME: self.utility.system_time,
                mav.MAVLINK_MSG_ID_TIMESYNC: self.utility.timesync,
                extra.MAVLINK_MSG_ID_CURRENT_EVENT_SEQUENCE: self._events.current_sequence,
                STATUS_ID: self._operators.status,
            }
        )
        self._vehicle = VehicleService(ctx, self._telemetry, self._progress, self._arming.report)
        requests = Requests(ctx, self._streams)
        # A request for control has its own check, also while another station is the owner.
        control = {
            REQUEST: setting(self._operators.request),
            mav.MAV_CMD_CONTROL_HIGH_LATENCY: action(self._high_latency.control),
        }
        carried = {} if equipment is None else EquipmentCommands(equipment).table()
        mount = gimbal.table()
        maintenance = Maintenance(ctx, self.parameters)
        table = {**self._vehicle.table(), **requests.table(), **maintenance.table(), **control, **carried, **mount}
        self._camera: CameraComponent | None = None
        self._to_camera: CommandProtocol | None = None
        """Commands that are addressed to the camera, or that only it can answer."""
        self._ours = _OUR_COMPONENTS
        if camera is not None:
            self._camera = CameraComponent(ctx, camera, lambda: self.utility.utc_offset_us)
            taken = {**self._camera.actions(), **self._camera.requests(), **mount}
            self._to_camera = CommandProtocol(ctx, taken, self._keeps_out, CAMERA_COMPID)
            table = {**self._camera.actions(), **table}
            self._ours = _OUR_COMPONENTS | {CAMERA_COMPID}
        self._commands = CommandProtocol(ctx, table, self._keeps_out)
        self._keys = SigningSetup(ctx, lambda address: self._intake.reach(address))
        self._handlers = self._table()
        self._router = Router(ctx, ours=self._ours.__contains__)
        self._intake = MessageInbox(self._handlers.keys(), _HEAVY, self._handle, ctx.signing.admits, self._note_frame)
        self._valid_us: LatestUsed[Address, int] = LatestUsed(MAX_INBOXES)
        """When each client was last understood."""
        self._new: RecentKeys[Address] = RecentKeys(VERSION_US * patience)
        """Clients that have used MAVLink 2 lately."""
        self._announcements = PeriodicMessages(ctx, self._status, self._telemetry, self._intake)
        self.last_gcs_t_us: int | None = None
        """When a ground station or companion computer last sent a HEARTBEAT; None before the first."""
        self._before_hearing: tuple[Work, ...] = (("message", self._keys.tick), ("plans", self.missions.answer))
        self._before_news = self._works_before_news()
        self._after_news = self._works_after_news()
        files, logs = self._files.tick, self._logs.tick
        self._at_last = self._works_at_last(logs, files), self._works_at_last(files, logs)
        """On even ticks and on odd ones."""
        for link in links:
            self.add_link(link)

    def _works_before_news(self) -> tuple[Work, ...]:
        """Of every tick, in this order."""
        say = self._announcements
        return (
            ("telemetry", say.flood),
            ("telemetry", say.refusals),
            ("telemetry", self._operators.tick),
            ("heartbeat", say.heartbeat),
            ("telemetry", say.greetings),
        )

    def _works_after_news(self) -> tuple[Work, ...]:
        """Work of a tick after the events have been reported."""
        shown = (self._announcements.place, self._sensors.tick, self._outputs.tick, self._flight.tick)
        camera = () if self._camera is None else (self._camera.tick,)
        events = (self._arming.tick, self._events.tick)
        return tuple(("telemetry", work) for work in (*shown, self._high_latency.tick, *camera, *events))

    def _works_at_last(self, *turns: Callable[[], None]) -> tuple[Work, ...]:
        """Work at the end of a tick; ``turns``: round-robin order in using the link budgets."""
        return (
            ("parameters", self.parameters.tick),
            ("plans", self.missions.tick),
            ("telemetry", self._streams.tick),
            *(("files", turn) for turn in turns),
        )

    def _table(self) -> Mapping[int, Handler]:
        missions, parameters, utility = self.missions, self.parameters, self.utility
        return {
            mav.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            mav.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command,
            mav.MAVLINK_MSG_ID_COMMAND_INT: self._on_command,
            extra.MAVLINK_MSG_ID_COMMAND_CANCEL: self._on_cancel,
            mav.MAVLINK_MSG_ID_SET_MODE: self._on_set_mode,
            mav.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN: self._on_set_origin,
            mav.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: lambda peer, msg: parameters.on_request_list(peer),
            mav.MAVLINK_MSG_ID_PARAM_REQUEST_READ: parameters.on_request_read,
            mav.MAVLINK_MSG_ID_PARAM_SET: parameters.on_set,
            mav.MAVLINK_MSG_ID_PARAM_EXT_REQUEST_READ: parameters.on_extended,
            mav.MAVLINK_MSG_ID_PARAM_EXT_REQUEST_LIST: parameters.on_extended,
            mav.MAVLINK_MSG_ID_PARAM_EXT_SET: parameters.on_extended,
            mav.MAVLINK_MSG_ID_MISSION_COUNT: missions.on_count,
            mav.MAVLINK_MSG_ID_MISSION_ITEM_INT: missions.on_item,
            mav.MAVLINK_MSG_ID_MISSION_ITEM: self._on_float_item,
            mav.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: missions.on_clear_all,
            mav.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: missions.on_request_list,
            mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT: missions.on_request,
            mav.MAVLINK_MSG_ID_MISSION_REQUEST: missions.on_request,
            mav.MAVLINK_MSG_ID_MISSION_ACK: missions.on_ack,
            mav.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST: missions.on_partial_list,
            mav.MAVLINK_MSG_ID_MISSION_REQUEST_PARTIAL_LIST: missions.on_partial_list,
            mav.MAVLINK_MSG_ID_MISSION_SET_CURRENT: self._progress.on_set_current,
            mav.MAVLINK_MSG_ID_PING: utility.on_ping,
            mav.MAVLINK_MSG_ID_TIMESYNC: utility.on_timesync,
            extra.MAVLINK_MSG_ID_REQUEST_EVENT: self._events.on_request,
            mav.MAVLINK_MSG_ID_SYSTEM_TIME: utility.on_system_time,
            mav.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: self._files.on_message,
            mav.MAVLINK_MSG_ID_LOG_REQUEST_LIST: self._logs.on_request_list,
            mav.MAVLINK_MSG_ID_LOG_REQUEST_DATA: self._logs.on_request_data,
            mav.MAVLINK_MSG_ID_LOG_REQUEST_END: lambda peer, msg: self._logs.on_request_end(peer),
            mav.MAVLINK_MSG_ID_LOG_ERASE: lambda peer, msg: self._logs.on_erase(peer),
            mav.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE: self._external.on_vision_position_estimate,
            mav.MAVLINK_MSG_ID_ODOMETRY: self._external.on_odometry,
            mav.MAVLINK_MSG_ID_MANUAL_CONTROL: self.pilot.on_manual_control,
            mav.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE: self.pilot.on_override,
            mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._set_points.on_local,
            mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: self._set_points.on_global,
            mav.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET: self._set_points.on_attitude,
            mav.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET: self._set_points.on_actuators,
            mav.MAVLINK_MSG_ID_REQUEST_DATA_STREAM: self._on_request_data_stream,
            mav.MAVLINK_MSG_ID_SETUP_SIGNING: self._keys.on_setup,
            mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._others.on_global_position_int,
            mav.MAVLINK_MSG_ID_ADSB_VEHICLE: self._others.on_adsb_vehicle,
            mav.MAVLINK_MSG_ID_AIS_VESSEL: self._others.on_ais_vessel,
            mav.MAVLINK_MSG_ID_OBSTACLE_DISTANCE: self._others.on_obstacle_distance,
        }

    # Links

    def add_link(self, link: int) -> None:
        """Open a link: heartbeat and telemetry go out on it from now on."""
        self._ctx.add_link(link)

    def remove_link(self, link: int) -> None:
        self._ctx.remove_link(link)
        self._intake.forget_link(link)
        self._streams.forget(link)
        self._high_latency.forget(link)
        self._announcements.forget(link)

    def finish(self) -> None:
        """Call at the end of a run, before its state is written."""
        self._ctx.signing.finish()

    def custom_mode(self, mode: FlightMode) -> int:
        """The profile's custom_mode number of a mode."""
        return self._ctx.profile.custom_modes[mode]

    @property
    def dropped_rx(self) -> int:
        """Stretches of damaged input so far, all links."""
        return self._intake.dropped

    @property
    def busy(self) -> bool:
        """Whether a client waits for more than the next decision: a transfer, messages left over, a fast stream."""
        return (
            self.missions.uploading
            or self._intake.waiting
            or self.parameters.listing
            or self._streams.fast
            or self._files.sending
            or self._events.sending
            or self._logs.sending
        )

    def take_notices(self) -> tuple[Event, ...]:
        """Texts that the server itself has sent to operators since the last call (plans accepted or refused), for the
        log.
        """
        notices, self._ctx.notices = tuple(self._ctx.notices), []
        return notices

    def take_samples(self) -> tuple[ExternalPoseSample, ...]:
        """Poses that clients have sent since the last call (VISION_POSITION_ESTIMATE, ODOMETRY), for the estimator."""
        samples, self._ctx.samples = tuple(self._ctx.samples), []
        return samples

    def take_tracks(self) -> tuple[tuple[ObstacleTrack, ...], tuple[int, ...]]:
        """Obstacles and vehicles reported by clients since the last call, and numbers of those gone."""
        return self._others.take()

    # One tick

    def step(
        self,
        t_us: int,
        rx: Sequence[MavlinkFrame],
        view: VehicleView,
        events: Sequence[Event] = (),
        reached: Sequence[int] = (),
    ) -> tuple[MavlinkFrame, ...]:
        """Handle received bytes, then send heartbeats, notices, retransmissions and telemetry. Never raises on
        received bytes.
        """
        ctx = self._ctx
        ctx.t_us, ctx.view, ctx.tx = t_us, view, []
        if ctx.announce_place:
            ctx.announce_place = False
            self._announcements.place_again()
        run_all, run = ctx.guard.run_all, ctx.guard.run
        for budget in ctx.budgets.values():
            budget.tick(t_us)
        run_all(self._before_hearing)
        for frame in rx:
            self._push(frame)
        run("message", self._commands.tick, None)
        run("message", self._intake.work, None)
        ctx.received = self._intake.received

        def given() -> VehicleView:
            return view

        run_all(self._before_news, given)
        for event in events:
            run("telemetry", partial(ctx.relay, event.severity, event.text), None, partial(repr, event))
        run_all(self._after_news, given)
        run("progress", partial(self._progress.tick, reached), None, given)
        # Round-robin: on a narrow link the first would take the whole budget.
        run_all(self._at_last[t_us // TICK_US % 2], given)
        return tuple(ctx.tx)

    def serve(self, t_us: int, rx: Sequence[MavlinkFrame]) -> tuple[MavlinkFrame, ...]:
        """Receive between two ticks. Plan transfers, parameter reads and time requests are answered at once; anything
        else waits for :meth:`step`, and with it whatever its client sends after it."""
        ctx = self._ctx
        ctx.t_us, ctx.tx = t_us, []
        for budget in ctx.budgets.values():
            budget.tick(t_us)
        ctx.guard.run("plans", self.missions.answer, None)
        for frame in rx:
            inbox = self._push(frame)
            if inbox is not None:
                self._intake.serve(inbox, self._is_urgent)
        return tuple(ctx.tx)

    def beat(self) -> tuple[MavlinkFrame, ...]:
        """A HEARTBEAT of every component for every link while the loop waits, at any moment of a tick: nothing counts
        it, so a run is the same with it or without."""
        ctx = self._ctx
        beats = [(COMPID, self._status.heartbeat())]
        if self._camera is not None:
            beats.append((CAMERA_COMPID, self._camera.heartbeat()))
        return tuple(
            frame
            for link in ctx.links
            if link not in ctx.quiet
            for source, message in beats
            for frame in ctx.frames(link, EVERYONE, message, counted=False, source=source)
        )

    def standing(self, link: int, client: int) -> ClientRecord:
        owner = self._operators.owner
        in_control = owner is not None and (owner.link, owner.client) == (link, client)
        return ClientRecord(self._valid_us.get((link, client)), in_control)

    def _push(self, frame: MavlinkFrame) -> Inbox | None:
        if frame.link < 0:
            return None
        self._ctx.add_link(frame.link)
        return self._intake.push(frame)

    def _is_urgent(self, address: Address, msg: Message) -> bool:
        link, client = address
        peer = MavlinkPeer(link, msg.get_srcSystem(), msg.get_srcComponent(), client)
        return msg.get_msgId() in _URGENT and not self.missions.concludes(peer, msg)

    def _handle(self, address: Address, msg: Message) -> None:
        """Dispatch one message. A fault loses this message only; a command is answered FAILED."""
        sysid = msg.get_srcSystem()
        speaker = msg.get_srcComponent()  # one of our components: an echo, or a second of us
        ours = sysid == self._ctx.sysid and speaker in (COMPID, CAMERA_COMPID) and speaker in self._ours
        if sysid == 0 or ours or not self._for_us(msg):
            return
        link, client = address
        peer = MavlinkPeer(link, sysid, msg.get_srcComponent(), client)
        self._note_version(address, msg)
        self._announcements.greet(peer)
        if self._operators.refused(peer, msg):
            return
        if msg.get_msgId() in _ONCE and self._ctx.is_copy(peer, msg):
            return
        try:
            self._handlers[msg.get_msgId()](peer, msg)
        except Exception as error:  # noqa: BLE001 - a guard: counted, said and kept by it, or raised again
            secret = msg.get_msgId() == mav.MAVLINK_MSG_ID_SETUP_SIGNING
            self._ctx.guard.note("message", error, lambda: (peer, "a signing key" if secret else msg.to_dict()))
            if msg.get_msgId() in COMMANDS:
                failed = mav.MAVLink_command_ack_message(
                    msg.command, CommandResult.FAILED, 0, 0, peer.sysid, peer.compid
                )
                self._ctx.send(peer, failed)

    def _note_version(self, address: Address, msg: Message) -> None:
        """Answer a client in MAVLink 1 while it sends nothing else (a serial line may get another client). It gets one
        MAVLink 2 frame: clients that support both (pymavlink) start with 1 and switch then.
        """
        ctx, (link, client) = self._ctx, address
        known = ctx.old.get(link, frozenset())
        if msg.get_msgbuf()[0] != mav.PROTOCOL_MARKER_V1:
            if client in known:
                ctx.old[link] = known - {client}
            self._new.add(address, ctx.t_us)
        elif client not in known and not self._new.knows(address, ctx.t_us):
            ctx.send(MavlinkPeer(link, 0, 0, client), self._status.heartbeat())
            clients = {number for number in known if (link, number) in self._intake}
            ctx.old[link] = frozenset((*clients, client))

    def _note_frame(self, address: Address, frame: bytes) -> None:
        """A valid frame, to us or to be forwarded."""
        self._valid_us[address] = self._ctx.t_us

        def note() -> None:
            self._high_latency.note_frame(address)
            self._router.note_frame(address, frame)

        self._ctx.guard.run("message", note, None)

    def _keeps_out(self, call: Call) -> str:
        return self._operators.refusal(call.peer, grave=call.command in GRAVE_COMMANDS)

    def rights(self) -> Rights:
        """Who may send what, enforced by this server."""
        tables = [self._commands.table, *([] if self._to_camera is None else [self._to_camera.table])]
        entries = {number: entry for table in tables for number, entry in table.items()}
        return rights(self._handlers, entries)

    def _for_us(self, msg: Message) -> bool:
        """Addressed to us or broadcast. The camera takes commands only."""
        component = getattr(msg, "target_component", 0)
        if getattr(msg, "target_system", 0) not in (0, self._ctx.sysid) or component not in self._ours:
            return False
        return component != CAMERA_COMPID or msg.get_msgId() in COMMANDS

    # Messages that need no service of their own

    def _on_heartbeat(self, peer: MavlinkPeer, msg: Message) -> None:
        if msg.type in _OPERATORS:
            self._operators.note_message(peer)
            self.last_gcs_t_us = self._ctx.t_us

    def _on_command(self, peer: MavlinkPeer, msg: Message) -> None:
        """To the autopilot; to the camera if it is addressed, or for a broadcast request that concerns it."""
        camera, component = self._to_camera, msg.target_component
        if camera is None or self._camera is None or component in (COMPID, MISSION_COMPID):
            self._commands.on_command(peer, msg)
        elif component == CAMERA_COMPID or self._camera.answers(call_of(peer, msg)):
            camera.on_command(peer, msg)
        else:
            self._commands.on_command(peer, msg)

    def _on_set_mode(self, peer: MavlinkPeer, msg: Message) -> None:
        self._explain(peer, self._vehicle.set_mode_message(msg.base_mode, msg.custom_mode))

    def _on_float_item(self, peer: MavlinkPeer, msg: Message) -> None:
        """MISSION_ITEM: ArduPilot's go-to, or an item of a plan."""
        if not self._ctx.profile.guided_in_hold or msg.current != 2:
            self.missions.on_float_item(peer, msg)
            return
        answer = self._vehicle.guided_item(peer, msg)
        result = MissionResult.ACCEPTED if answer.result is CommandResult.ACCEPTED else MissionResult.DENIED
        self._ctx.send(peer, mav.MAVLink_mission_ack_message(peer.sysid, peer.compid, result, msg.mission_type))
        self._explain(peer, answer)

    def _on_cancel(self, peer: MavlinkPeer, msg: Message) -> None:
        """COMMAND_CANCEL: ends the command in progress, whose client gets CANCELLED; else ignored (common.xml)."""
        if self._vehicle.cancel(msg.command):
            ack = mav.MAVLink_command_ack_message(msg.command, CommandResult.CANCELLED, 0, 0, peer.sysid, peer.compid)
            self._ctx.send(peer, ack)

    def _on_set_origin(self, peer: MavlinkPeer, msg: Message) -> None:
        self._explain(peer, self._vehicle.set_origin_message(msg.latitude, msg.longitude, msg.altitude))

    def _on_request_data_stream(self, peer: MavlinkPeer, msg: Message) -> None:
        self._streams.on_request_data_stream(
            peer.link, msg.req_stream_id, msg.req_message_rate, start=msg.start_stop != 0
        )

    def _explain(self, peer: MavlinkPeer, answer: CommandReply) -> None:
        """Messages without acknowledgement: a refusal is sent as text."""
        if answer.result is not CommandResult.ACCEPTED and answer.reason:
            self._ctx.say(notices.REFUSED(reason=answer.reason), peer)


def blank_view() -> VehicleView:
    """Telemetry data before the first tick."""
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
        origin=_ZERO,
        home=_ZERO,
        failsafes=0,
        cpu_load=0.0,
        under_way=False,
        dropped_rx=0,
    )
