"""Pilot inputs: MANUAL_CONTROL and RC_CHANNELS_OVERRIDE. https://mavlink.io/en/services/manual_control.html

One pilot at a time: the first sender owns the sticks until its messages time out. Then the sticks are released, and
the mode decides how to respond.
"""

import math
from dataclasses import dataclass

from autopilot.core import operator_messages as notices
from autopilot.mavlink.api import CameraOrders, CommandReply, EquipmentOrders, Sticks
from autopilot.mavlink.context import Context, MavlinkPeer
from autopilot.mavlink.flight_modes import MODE_BUTTONS
from autopilot.mavlink.wire import Message

STALE_US = 500_000
"""Timeout after which sticks count as released: ground stations send 5 to 50 messages a second."""

INVALID = 0x7FFF
"""An axis that is not there."""

DEADZONE = 0.03
"""Deadband: sticks do not centre exactly."""

CENTRED = 0.08
CENTRED_US = 200_000
"""Time for which the vertical stick has to rest near its neutral before it is used: a client of the other
convention rests at an end of the range."""

GAIN_STEP = 0.1
LEAST_GAIN, MOST_GAIN = 0.1, 1.0

NEUTRAL_US, SPAN_US = 1500, 400
LEAST_US, MOST_US = 800, 2200
"""Of RC channels; other numbers mean "not this channel"."""

TO_ARM, ARM, DISARM = 2, 3, 4
GAIN_UP, GAIN_DOWN = 42, 43
TILT_CENTER, TILT_UP, TILT_DOWN = 21, 22, 23
PHOTO, LIGHTS, BRIGHTER, DARKER = 24, 31, 32, 33
RELAY_ON, RELAY_OFF, RELAY_OVER = 51, 52, 53
"""Values of BTNn_FUNCTION; those that ArduSub has too are the same there, as are those of the modes."""
LIGHT_STEP = 0.125
"""Share by which a button makes lights brighter or darker."""
TILT_STEP_RAD = math.radians(5.0)
"""Step of a button that tilts the camera."""


@dataclass(slots=True)
class _PilotRecord:
    peer: MavlinkPeer
    last_us: int
    sticks: Sticks
    buttons: int = 0
    reported: bool = False
    """That his vertical stick is not used."""
    spoken: bool = False
    """The pilot has sent a negative value on a vertical stick specified as 0 to 1000."""
    centred_us: int | None = None
    """Since when the vertical stick has been at its neutral."""
    lifts: bool = False
    """It is used."""


class PilotInputs:
    def __init__(
        self, ctx: Context, equipment: EquipmentOrders | None = None, camera: CameraOrders | None = None
    ) -> None:
        self._ctx, self._equipment, self._camera = ctx, equipment, camera
        self._record: _PilotRecord | None = None
        self._gain: float | None = None
        self.last_us: int | None = None
        """Time of the pilot's last message, None before the first."""

    @property
    def sticks(self) -> Sticks | None:
        """Stick positions times gain; None = no pilot."""
        record = self._record
        if record is None or self._ctx.t_us > record.last_us + self._stale_us:
            return None
        return record.sticks

    @property
    def gain(self) -> float:
        """Share of full sticks that a pilot gets: the parameter's, until buttons have changed it."""
        return self._ctx.params["PILOT_GAIN"] if self._gain is None else self._gain

    @property
    def _stale_us(self) -> float:
        return STALE_US * self._ctx.patience

    def on_manual_control(self, peer: MavlinkPeer, msg: Message) -> None:
        """MANUAL_CONTROL: x ahead, y and r to starboard, z up; s, t and aux are for axes that are not here."""
        if msg.target not in (0, self._ctx.sysid):
            return
        record = self._of(peer)
        if record is None:
            return
        up = self._up(record, msg.z)
        self._take(record, ahead=_axis(msg.x), starboard=_axis(msg.y), up=up, turn=_axis(msg.r))
        extensions = getattr(msg, "enabled_extensions", 0)
        if extensions & 3 and (msg.s if extensions & 1 else 0) | (msg.t if extensions & 2 else 0):
            self._ctx.say(notices.STICKS_UNUSED(), peer)
        self._press(record, msg.buttons | getattr(msg, "buttons2", 0) << 16)

    def on_override(self, peer: MavlinkPeer, msg: Message) -> None:
        """RC_CHANNELS_OVERRIDE, channels as ArduSub has them: 3 up, 4 yaw, 5 ahead, 6 to starboard; no gain. 0 on all
        of them releases the sticks (common.xml).
        """
        channels = (msg.chan5_raw, msg.chan6_raw, msg.chan3_raw, msg.chan4_raw)
        if not any(LEAST_US <= us <= MOST_US for us in channels):
            if self._record is not None and self._record.peer == peer and not any(channels):
                self._record = None
            return
        record = self._of(peer)
        if record is None:
            return
        ahead, starboard, up, turn = (_channel(us) for us in channels)
        record.sticks = Sticks(ahead=ahead, starboard=starboard, up=up, turn=turn)

    def _of(self, peer: MavlinkPeer) -> _PilotRecord | None:
        """The pilot's record, if this client is the pilot."""
        now_us, record = self._ctx.t_us, self._record
        if record is None or (record.peer != peer and now_us > record.last_us + self._stale_us):
            record = self._record = _PilotRecord(peer=peer, last_us=now_us, sticks=Sticks())
        if record.peer != peer:
            client = f"{record.peer.sysid}/{record.peer.compid}"
            self._ctx.say(notices.STICKS_OF_ANOTHER(client=client), peer)
            return None
        if now_us > record.last_us + self._stale_us:
            record.centred_us, record.lifts = None, False
        record.last_us = self.last_us = now_us
        return record

    def _take(self, record: _PilotRecord, *, ahead: float, starboard: float, up: float, turn: float) -> None:
        gain = self.gain
        record.sticks = Sticks(ahead=gain * ahead, starboard=gain * starboard, up=gain * up, turn=gain * turn)

    def _up(self, record: _PilotRecord, z: int) -> float:
        """The vertical stick, by one of the two conventions: 0 to 1000 with 500 neutral, or -1000 to 1000."""
        if z == INVALID:
            return 0.0
        centred = bool(self._ctx.params["PILOT_Z"])
        if z < 0 and not centred and not record.spoken:
            record.spoken, record.lifts, record.centred_us = True, False, None
            self._ctx.say(notices.STICK_BELOW_ZERO(), record.peer)
        value = _axis(z) if centred or record.spoken else _axis(2 * z - 1000)
        if record.lifts:
            return value
        if abs(value) > CENTRED:
            record.centred_us = None
            if not record.reported:
                record.reported = True
                neutral = 0 if centred or record.spoken else 500
                self._ctx.say(notices.STICK_NOT_CENTRED(neutral=neutral), record.peer)
        elif record.centred_us is None:
            record.centred_us = self._ctx.t_us
        record.lifts = record.centred_us is not None and self._ctx.t_us - record.centred_us >= CENTRED_US
        return 0.0

    # Buttons

    def _press(self, record: _PilotRecord, buttons: int) -> None:
        """Buttons pressed since the last message."""
        pressed, record.buttons = buttons & ~record.buttons, buttons
        for n in range(16):
            if pressed >> n & 1:
                self._act(record.peer, int(self._ctx.params[f"BTN{n}_FUNCTION"]), n)

    def _act(self, peer: MavlinkPeer, function: int, button: int) -> None:
        vehicle, armed = self._ctx.vehicle, self._ctx.view.armed
        if function == ARM or (function == TO_ARM and not armed):
            answer = vehicle.arm(False)
        elif function in (DISARM, TO_ARM):
            answer = vehicle.disarm(False)
        elif function in MODE_BUTTONS:
            answer = vehicle.set_mode(MODE_BUTTONS[function])
        elif function in (GAIN_UP, GAIN_DOWN):
            step = GAIN_STEP if function == GAIN_UP else -GAIN_STEP
            self._gain = min(max(round(self.gain + step, 3), LEAST_GAIN), MOST_GAIN)
            self._ctx.say(notices.PILOT_GAIN(percent=100.0 * self._gain), peer)
            return
        elif (found := self._carried(function)) is not None:
            answer = found
        else:
            if function:
                self._ctx.say(notices.BUTTON_UNKNOWN(button=button, function=function), peer)
            return
        if answer.reason:
            self._ctx.say(notices.REFUSED(reason=answer.reason), peer)

    def _carried(self, function: int) -> CommandReply | None:
        """Button function on lights, tilt, relay and camera; None for other functions."""
        camera, equipment = self._camera, self._equipment
        if function == PHOTO and camera is not None:
            return camera.shoot(1, 0.0)
        if equipment is None:
            return None
        if function in (LIGHTS, BRIGHTER, DARKER):
            return equipment.lights({BRIGHTER: LIGHT_STEP, DARKER: -LIGHT_STEP}.get(function))
        if function in (TILT_CENTER, TILT_UP, TILT_DOWN):
            return equipment.tilt_by({TILT_UP: TILT_STEP_RAD, TILT_DOWN: -TILT_STEP_RAD}.get(function))
        if function in (RELAY_ON, RELAY_OFF):
            return equipment.set_relay(0, on=function == RELAY_ON)
        return equipment.toggle_relay(0) if function == RELAY_OVER else None


def _axis(value: int) -> float:
    """-1000 to 1000 as -1 to 1; no axis and the middle are 0."""
    if value == INVALID:
        return 0.0
    deflection = min(max(value / 1000.0, -1.0), 1.0)
    return 0.0 if abs(deflection) < DEADZONE else deflection


def _channel(us: int) -> float:
    """PWM pulse as -1 to 1; an invalid pulse is 0."""
    return _axis(round(1000 * (us - NEUTRAL_US) / SPAN_US)) if LEAST_US <= us <= MOST_US else 0.0


__all__ = ["PilotInputs"]
