"""Authority over a vehicle with ArduSub: ours, its pilot's, or nobody's.

We command in its MANUAL mode only: any other mode is the pilot's choice, and nothing here sets a mode. It is armed
together with us, after its own checks, and disarmed by force: the command is repeated until a heartbeat later than its
acknowledgement shows it.
"""

from typing import Any

from autopilot.core.messages import Authority
from autopilot.drivers.ardusub_wire import ARM_DISARM

MANUAL = 19
MODE_NAMES = {
    0: "STABILIZE",
    1: "ACRO",
    2: "ALT_HOLD",
    3: "AUTO",
    4: "GUIDED",
    7: "CIRCLE",
    9: "SURFACE",
    16: "POSHOLD",
    MANUAL: "MANUAL",
    20: "MOTOR_DETECT",
    21: "SURFTRAK",
}
HOLDS_DEPTH = (2, 3, 4, 7, 9, 16, 21)
"""Modes that filter heave by 2 Hz and leave it so: MANUAL does not set the filter."""
SETS_HEAVE = (0, 1)
"""Modes that set it back (to PILOT_THR_FILT), as disarming does."""
ARMED_FLAG = 128
"""MAV_MODE_FLAG_SAFETY_ARMED."""
SPOOL_US = 1_050_000
"""From arming to full thrust: half a second of neutral, then half a second (MOT_SPOOL_TIME) in which heave grows."""
REQUEST_EVERY_US = 1_000_000
GIVE_UP_US = 5_000_000
"""Timeout of arming."""
DISARM_EVERY_US = 250_000
"""A disarming that is waited for is asked for so often,"""
BEAT_EVERY_US = 100_000
"""and the heartbeat that shows it."""
NO_ANSWER_US = 1_000_000
"""A heartbeat so long behind the first request counts without the answer to it, which may have been lost."""
SILENT_US = 3_000_000
"""So long a silent one is asked; later, when it is heard again: what lies in a buffer on the way may come late."""
STALE_BEAT_US = 3_500_000
"""It sends a heartbeat a second: an older one does not say how it is now."""


class AuthorityWatch:
    def __init__(self) -> None:
        self.mode: int | None = None
        """None before the first heartbeat."""
        self.known = False
        """Whether it is still so: not after a silence, until the next heartbeat."""
        self.armed = False
        """Below."""
        self.wanted = False
        """By us."""
        self.found_armed = False
        """It has been armed since its first heartbeat."""
        self.handed_back = False
        """It was left armed on purpose, since we last wanted it."""
        self._first = True
        """No heartbeat has come yet."""
        self._beat_us = -STALE_BEAT_US
        """When the newest came."""
        self._stop_us: int | None = None
        """Since when a disarming is waited for, None = it is not."""
        self._answered = False
        """That it takes the disarming."""
        self._last_heartbeat_request_us = -BEAT_EVERY_US
        self.slow_heave = False
        """What its depth hold leaves behind: MANUAL's heave goes through a low-pass of 2 Hz until disarming."""
        self._armed_us = 0
        self._wanted_us = 0
        self._last_request_us = -REQUEST_EVERY_US
        self._had = False
        """Whether it has been armed since we wanted it."""
        self._stopped = ""
        self._refusal = ""

    @property
    def authority(self) -> Authority:
        if self._stopped:
            return Authority.STOPPED
        return Authority.PILOT if self.pilots else Authority.OURS

    @property
    def pilots(self) -> bool:
        """Whether it is in a mode of its pilot's choice."""
        return self.mode is not None and self.mode != MANUAL

    @property
    def text(self) -> str:
        """Its mode, or why it has stopped."""
        if self.authority is Authority.STOPPED:
            return self._stopped
        return "" if self.mode is None else mode_name(self.mode)

    def acts(self, t_us: int) -> bool:
        """Whether thrust acts as commanded now."""
        ours = self.known and self.authority is Authority.OURS
        return ours and self.wanted and self.armed and t_us - self._armed_us > SPOOL_US

    @property
    def accepts_commands(self) -> bool:
        """Whether commands are to be sent: not before the authority is known."""
        return self.wanted and self.known and self.authority is Authority.OURS

    def lose_sight(self) -> None:
        """The authority is unknown until the next heartbeat."""
        self.known = False

    def want(self, t_us: int, *, armed: bool) -> None:
        if armed != self.wanted:
            self.wanted = armed
            self._wanted_us, self._last_request_us = t_us, t_us - REQUEST_EVERY_US
            self._stopped = self._refusal = ""
            if armed:
                self._had = self.armed
                self.handed_back = self.found_armed = False
                self._stop_us = None

    def hand_back(self) -> None:
        """It keeps the vehicle, armed as it is: its own failsafes and its pilot decide."""
        self.wanted = self._had = False
        self.handed_back = self.armed

    def stop(self, t_us: int) -> None:
        """Disarm it, whoever armed it and whatever its mode; sent on every tick until :meth:`is_armed` is False."""
        if self._stop_us is None:
            self._stop_us, self._answered = t_us, False
            self._last_request_us = t_us - DISARM_EVERY_US
            self._last_heartbeat_request_us = t_us - BEAT_EVERY_US

    def is_armed(self, t_us: int) -> bool | None:
        """By its heartbeat; None = unknown, or a disarming that is not confirmed yet."""
        if not self.known or t_us - self._beat_us > STALE_BEAT_US:
            return None
        return True if self.armed else None if self._stop_us is not None else False

    @property
    def ours_to_stop(self) -> bool:
        """Whether our shutdown disarms it: not if its pilot has armed it or has the authority."""
        return not self.pilots and not self.handed_back and (self.wanted or self._had or self.found_armed)

    def beat_due(self, t_us: int) -> bool:
        """Whether it is to be asked for a heartbeat now."""
        if (
            self._stop_us is None
            or t_us - self._last_heartbeat_request_us < BEAT_EVERY_US
            or self._is_silent(t_us, self._stop_us)
        ):
            return False
        self._last_heartbeat_request_us = t_us
        return True

    def _is_silent(self, t_us: int, since_us: int) -> bool:
        return not self.known and t_us - since_us > SILENT_US

    def due(self, t_us: int) -> bool | None:
        """Whether it is to be asked now to arm (True) or disarm (False)."""
        if self._stop_us is not None:
            if t_us - self._last_request_us < DISARM_EVERY_US or self._is_silent(t_us, self._stop_us):
                return None
            self._last_request_us = t_us
            return False
        if not self.known or self.mode != MANUAL or self._stopped or self.armed == self.wanted:
            return None
        if not self.wanted and not self._had:  # armed by another source: not disarmed by us
            return None
        if self.wanted and t_us - self._wanted_us > GIVE_UP_US:
            self._stopped = f"does not arm: {self._refusal or 'no answer'}"
            return None
        if t_us - self._last_request_us < REQUEST_EVERY_US:
            return None
        self._last_request_us = t_us
        return self.wanted

    def take(self, t_us: int, message: Any) -> None:
        match message.get_type():
            case "HEARTBEAT":
                self.mode, self.known, self._beat_us = int(message.custom_mode), True, t_us
                armed = bool(message.base_mode & ARMED_FLAG)
                self.found_armed = armed and (self.found_armed or (self._first and not self.wanted))
                self._first = False
                self._set_armed(t_us, armed, "")
                self._confirm(t_us)
                self.slow_heave |= self.armed and self.mode in HOLDS_DEPTH
                self.slow_heave &= self.armed and self.mode not in SETS_HEAVE
            case "STATUSTEXT":
                text = message.text.strip()
                lower = text.lower()
                if lower.startswith("disarming motors"):
                    self._set_armed(t_us, False, "")
                elif lower.startswith("arming motors"):
                    self._set_armed(t_us, True, "")
                elif lower.startswith(("prearm:", "arm:", "arming")) and message.severity <= 4:
                    self._refusal = text
            case "COMMAND_ACK" if message.command == ARM_DISARM and message.result == 0:
                self._answered = True
            case "COMMAND_ACK" if message.command == ARM_DISARM:
                self._refusal = self._refusal or f"refused (result {message.result})"
            case _:
                return

    def _confirm(self, t_us: int) -> None:
        """Confirmation by a heartbeat after the acknowledgement of the disarming, or long after the request."""
        if self._stop_us is None or self.armed:
            return
        if self._answered or t_us - self._stop_us >= NO_ANSWER_US:
            self._stop_us = None

    def _set_armed(self, t_us: int, armed: bool, why: str) -> None:
        if armed and not self.armed:
            self._armed_us = t_us
        lost = self.armed and not armed
        self.armed = armed
        if lost and self.wanted:  # in whatever mode; who arms it again is its pilot
            self._stopped = why or "disarmed by pilot or failsafe"
            self._had = False
        self._had |= armed and self.wanted and not self._stopped
        if not armed and not self.wanted:
            self._had = self.handed_back = False


def mode_name(number: int) -> str:
    return MODE_NAMES.get(number, f"mode {number}")
