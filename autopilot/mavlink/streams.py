"""Message rates per link: defaults, SET_MESSAGE_INTERVAL, REQUEST_DATA_STREAM."""

from collections.abc import Mapping
from functools import partial
from types import MappingProxyType

from autopilot.core.clock import DECISION_TICKS, TICK_US
from autopilot.mavlink.budget import TELEMETRY
from autopilot.mavlink.context import Context
from autopilot.mavlink.dialect import extra, mav
from autopilot.mavlink.telemetry import Builder
from autopilot.mavlink.wire import Message

_OFF = -1
_S = 1_000_000

DEFAULT_INTERVAL_US: Mapping[int, int] = MappingProxyType(
    {
        mav.MAVLINK_MSG_ID_ATTITUDE: _S // 10,
        mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _S // 10,
        mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _S // 5,
        mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _S // 4,
        mav.MAVLINK_MSG_ID_VFR_HUD: _S // 4,
        mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: _S // 4,
        mav.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: _S // 2,
        mav.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: _S // 2,
        mav.MAVLINK_MSG_ID_ALTITUDE: _S // 2,
        mav.MAVLINK_MSG_ID_SYS_STATUS: _S,
        mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _S,
        mav.MAVLINK_MSG_ID_ESTIMATOR_STATUS: _S,
        mav.MAVLINK_MSG_ID_MISSION_CURRENT: _S,
        mav.MAVLINK_MSG_ID_WIND_COV: _S,
        mav.MAVLINK_MSG_ID_DEBUG_VECT: _S,
        mav.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT: _S,
        mav.MAVLINK_MSG_ID_GPS_RAW_INT: _S,
        mav.MAVLINK_MSG_ID_SCALED_IMU: _S // 2,
        mav.MAVLINK_MSG_ID_RAW_IMU: _S,
        mav.MAVLINK_MSG_ID_HIGHRES_IMU: _S,
        mav.MAVLINK_MSG_ID_SCALED_PRESSURE: _S,
        mav.MAVLINK_MSG_ID_SCALED_PRESSURE2: _S // 2,
        mav.MAVLINK_MSG_ID_DISTANCE_SENSOR: _S // 2,
        mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: _S // 2,
        mav.MAVLINK_MSG_ID_VIBRATION: _S,
        mav.MAVLINK_MSG_ID_FENCE_STATUS: _S,
        mav.MAVLINK_MSG_ID_ODOMETRY: _S,
        mav.MAVLINK_MSG_ID_TRAJECTORY_REPRESENTATION_WAYPOINTS: _S,
        mav.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS: 2 * _S,
        mav.MAVLINK_MSG_ID_SYSTEM_TIME: 2 * _S,
        extra.MAVLINK_MSG_ID_CONTROL_STATUS: _S,
        mav.MAVLINK_MSG_ID_BATTERY_STATUS: 2 * _S,
        mav.MAVLINK_MSG_ID_HOME_POSITION: 2 * _S,
        mav.MAVLINK_MSG_ID_CURRENT_MODE: 2 * _S,
        extra.MAVLINK_MSG_ID_CURRENT_EVENT_SEQUENCE: 2 * _S,
        mav.MAVLINK_MSG_ID_AVAILABLE_MODES_MONITOR: 5 * _S,
        mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS: 5 * _S,
        mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 10 * _S,
        mav.MAVLINK_MSG_ID_TIMESYNC: 10 * _S,
    }
)
"""Default interval by message id. Others are sent on request only."""

STREAM_GROUPS: Mapping[int, tuple[int, ...]] = MappingProxyType(
    {
        mav.MAV_DATA_STREAM_RAW_SENSORS: (
            mav.MAVLINK_MSG_ID_RAW_IMU,
            mav.MAVLINK_MSG_ID_SCALED_IMU,
            mav.MAVLINK_MSG_ID_SCALED_PRESSURE,
            mav.MAVLINK_MSG_ID_SCALED_PRESSURE2,
        ),
        mav.MAV_DATA_STREAM_EXTENDED_STATUS: (
            mav.MAVLINK_MSG_ID_SYS_STATUS,
            mav.MAVLINK_MSG_ID_MISSION_CURRENT,
            mav.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT,
        ),
        mav.MAV_DATA_STREAM_RC_CHANNELS: (mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,),
        mav.MAV_DATA_STREAM_RAW_CONTROLLER: (mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,),
        mav.MAV_DATA_STREAM_POSITION: (
            mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
            mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
            mav.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
        ),
        mav.MAV_DATA_STREAM_EXTRA1: (mav.MAVLINK_MSG_ID_ATTITUDE, mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION),
        mav.MAV_DATA_STREAM_EXTRA2: (mav.MAVLINK_MSG_ID_VFR_HUD, mav.MAVLINK_MSG_ID_ALTITUDE),
        mav.MAV_DATA_STREAM_EXTRA3: (mav.MAVLINK_MSG_ID_BATTERY_STATUS, mav.MAVLINK_MSG_ID_ESTIMATOR_STATUS),
    }
)
"""Messages of each REQUEST_DATA_STREAM group (the grouping ground stations know from ArduPilot)."""

SLOW_US = _S
"""Messages with this default interval or more keep it when a client requests ALL streams at a common rate."""


class LinkStreams:
    def __init__(self, t_us: int) -> None:
        self.interval_us = dict(DEFAULT_INTERVAL_US)
        self.fast = False
        """Whether a message goes more often than decisions are taken."""
        self.due_us: dict[int, int] = {}
        self.next_us = t_us
        self.spread(t_us)

    def spread(self, t_us: int) -> None:
        """Begin now, over the ticks of the first 100 ms, so that not everything falls due in the same tick."""
        self.due_us = {msg_id: t_us + TICK_US * (n % 10) for n, msg_id in enumerate(self.interval_us)}
        self.next_us = t_us

    def set(self, msg_id: int, interval_us: int, t_us: int) -> None:
        """Change one interval; ``_OFF`` stops the stream."""
        if interval_us == _OFF:
            self.interval_us.pop(msg_id, None)
            self.due_us.pop(msg_id, None)
        else:
            self.interval_us[msg_id] = interval_us
            self.due_us[msg_id] = self.next_us = t_us
        self.fast = min(self.interval_us.values(), default=_S) < DECISION_TICKS * TICK_US

    def take_due(self, t_us: int) -> list[int]:
        due = self.due(t_us)
        for msg_id in due:
            self.done(msg_id, t_us)
        self.settle(t_us)
        return due

    def due(self, t_us: int) -> list[int]:
        return [msg_id for msg_id, at_us in self.due_us.items() if at_us <= t_us]

    def done(self, msg_id: int, t_us: int) -> None:
        """Schedule the next time of a message that has been sent."""
        interval_us = self.interval_us[msg_id]
        at_us = self.due_us[msg_id] + interval_us
        self.due_us[msg_id] = at_us if at_us > t_us else t_us + interval_us

    def settle(self, t_us: int) -> None:
        """Set the time of the next check."""
        self.next_us = min(self.due_us.values(), default=t_us + _S)


class Streams:
    def __init__(self, ctx: Context, builders: Mapping[int, Builder]) -> None:
        self._ctx = ctx
        self._builders = builders
        self._links: dict[int, LinkStreams] = {}
        self._before: dict[int, tuple[int, LinkStreams]] = {}
        """Of links that get one message only for a while: its id, and the streams of afterwards."""

    def of(self, link: int) -> LinkStreams:
        streams = self._links.get(link)
        if streams is None:
            streams = self._links[link] = LinkStreams(self._ctx.t_us)
        return streams

    def only(self, link: int, msg_id: int, interval_us: int) -> None:
        """Nothing but this on a link, until :meth:`all_again`."""
        self._before[link] = msg_id, self.of(link)
        self._links[link] = streams = LinkStreams(self._ctx.t_us)
        streams.interval_us, streams.due_us = {}, {}
        streams.set(msg_id, interval_us, self._ctx.t_us)

    def all_again(self, link: int) -> None:
        """Undo :meth:`only`; every message is sent once within the next 0.1 s."""
        before = self._before.pop(link, None)
        if before is not None:
            _, streams = before
            streams.spread(self._ctx.t_us)
            self._links[link] = streams

    def _requested(self, link: int, msg_id: int) -> LinkStreams:
        """What requests for a message are about: where another one goes alone, the streams of afterwards."""
        only, streams = self._before.get(link, (msg_id, self.of(link)))
        return self.of(link) if msg_id == only else streams

    @property
    def fast(self) -> bool:
        """Whether a link is to be served on every tick."""
        return any(streams.fast for streams in self._links.values())

    def knows(self, msg_id: int) -> bool:
        """Whether a message can be streamed or requested."""
        return msg_id in self._builders

    def build(self, msg_id: int) -> tuple[Message, ...]:
        """The message now (or several of that kind), () without data."""
        made = self._builders[msg_id]()
        if made is None:
            return ()
        return made if isinstance(made, tuple) else (made,)

    def interval_us(self, link: int, msg_id: int) -> int:
        """As in MESSAGE_INTERVAL: microseconds, -1 = off, 0 = not available."""
        if not self.knows(msg_id):
            return 0
        return self._requested(link, msg_id).interval_us.get(msg_id, _OFF)

    def set_interval(self, link: int, msg_id: int, interval_us: float) -> bool:
        """As in SET_MESSAGE_INTERVAL: -1 = off, 0 = default rate. False when the message cannot be streamed so."""
        if not self.knows(msg_id) or msg_id == mav.MAVLINK_MSG_ID_HEARTBEAT:
            return False
        if interval_us == 0.0:
            interval = DEFAULT_INTERVAL_US.get(msg_id, _OFF)
        elif interval_us == _OFF:
            interval = _OFF
        elif 0.0 < interval_us < 2.0**31:
            interval = max(int(interval_us), TICK_US)
        else:
            return False
        self._requested(link, msg_id).set(msg_id, interval, self._ctx.t_us)
        return True

    def on_request_data_stream(self, link: int, stream: int, rate_hz: int, start: bool) -> None:
        """REQUEST_DATA_STREAM: a group's rate. ALL leaves slow status messages at their own rate."""
        everything = stream == mav.MAV_DATA_STREAM_ALL
        group = tuple(DEFAULT_INTERVAL_US) if everything else STREAM_GROUPS.get(stream, ())
        for msg_id in group:
            if not start:
                interval = float(_OFF)
            elif rate_hz == 0 or (everything and DEFAULT_INTERVAL_US[msg_id] >= SLOW_US):
                interval = 0.0
            else:
                interval = float(_S // min(rate_hz, 100))
            if interval == 0.0 and self.interval_us(link, msg_id) == DEFAULT_INTERVAL_US[msg_id]:
                continue
            self.set_interval(link, msg_id, interval)

    def tick(self) -> None:
        """Send messages that are due; one due on several links is built once."""
        t_us = self._ctx.t_us
        built: dict[int, tuple[Message, ...]] = {}
        for link in self._ctx.links:
            streams = self.of(link)
            if streams.next_us > t_us:
                continue
            if link in self._ctx.budgets:
                self._tick_slow(link, streams, built)
                continue
            for msg_id in streams.take_due(t_us):
                self._ctx.guard.run("telemetry", partial(self._send, link, msg_id, built), None, lambda: self._ctx.view)

    def _tick_slow(self, link: int, streams: LinkStreams, built: dict[int, tuple[Message, ...]]) -> None:
        """Send as many due messages as the link can carry, the most overdue first; the rest stays due."""
        ctx, t_us = self._ctx, self._ctx.t_us
        for msg_id in sorted(streams.due(t_us), key=lambda due: streams.due_us[due]):
            if not ctx.has_capacity(link, TELEMETRY):
                break
            streams.done(msg_id, t_us)
            ctx.guard.run("telemetry", partial(self._send, link, msg_id, built), None, lambda: ctx.view)
        streams.settle(t_us)

    def _send(self, link: int, msg_id: int, built: dict[int, tuple[Message, ...]]) -> None:
        if msg_id not in built:
            built[msg_id] = ()
            built[msg_id] = self.build(msg_id)
        for message in built[msg_id]:
            self._ctx.send(link, message)

    def forget(self, link: int) -> None:
        self._links.pop(link, None)
        self._before.pop(link, None)
