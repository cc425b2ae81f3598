"""Measurement of how long ArduSub keeps the last thrust after all messages stop.

With the propellers off: armed after its own checks in MANUAL, a small thrust ahead, then no messages at all (no
channels, no heartbeat), as after a power failure of the companion. The servo outputs give the result. Time is an
argument.
"""

from enum import Enum
from typing import Any

from autopilot.drivers.ardusub_authority import ARMED_FLAG, MANUAL, SPOOL_US
from autopilot.drivers.ardusub_mixing import NEUTRAL
from autopilot.drivers.ardusub_wire import ENOUGH, HEARTBEAT_US, REST_SENDS, SEND_EVERY_US, SERVO_HZ, SERVO_ID, Wire

FORWARD, PUSH_US = 4, 80
"""Channel of the thrust ahead, and how far off neutral it is held [us]: a fifth of its range."""
SHOWN_US, STILL_US = 20, 4
"""Off neutral by so much a motor turns; by less it stands."""
REQUEST_EVERY_US = 1_000_000
CONTACT_US, ARM_US, PUSH_FOR_US = 10_000_000, 8_000_000, 1_000_000
"""Timeout of each step; thrust is held for the last."""
SILENT_US = 10_000_000
"""Silence that is long enough."""
END_US = 3_000_000
"""Timeout of disarming."""


class SilenceStep(Enum):
    CONTACT = "contact"
    ARM = "arm"
    PUSH = "push"
    SILENCE = "silence"
    END = "end"
    DONE = "done"


class SilenceTest:
    """One measurement over an open link; complete when :attr:`neutral_s` or :attr:`problem` is set."""

    def __init__(self, wire: Wire, motors: int) -> None:
        self._wire = wire
        self._motors = motors
        self._step = SilenceStep.CONTACT
        self._since_us: int | None = None
        self._beat_us = self._last_request_us = self._sent_us = -(1 << 62)
        self._mode: int | None = None
        self._armed = False
        self._servos_us: tuple[int, ...] = ()
        self._reports = 0
        """Of the servo rail, since they were asked for last."""
        self._refusal = ""
        self._rest = 0
        self.neutral_s: float | None = None
        """From the last command to neutral outputs; None = not within :data:`SILENT_US`, or :attr:`problem`."""
        self.problem = ""
        """Why nothing was measured."""

    @property
    def done(self) -> bool:
        """Whether it is over: neutral, and disarmed if it can be."""
        return self._step is SilenceStep.DONE

    def tick(self, t_us: int) -> None:
        if self._since_us is None:
            self._since_us = t_us
        self._servos_us = ()
        for message in self._wire.receive(t_us):
            self._receive(message)
        passed_us = t_us - self._since_us
        steps = {
            SilenceStep.CONTACT: self._contact,
            SilenceStep.ARM: self._arm,
            SilenceStep.PUSH: self._push,
            SilenceStep.SILENCE: self._silence,
            SilenceStep.END: self._end,
        }
        if self._step in steps:
            steps[self._step](t_us, passed_us)

    def abort(self) -> None:
        """Whatever it is doing: neutral, and disarmed if it was armed by this."""
        if self._step in (SilenceStep.ARM, SilenceStep.PUSH, SilenceStep.SILENCE, SilenceStep.END):
            for _ in range(REST_SENDS):
                self._wire.override(NEUTRAL)
            self._wire.arm(armed=False)

    def _receive(self, message: Any) -> None:
        match message.get_type():
            case "HEARTBEAT":
                self._mode, self._armed = int(message.custom_mode), bool(message.base_mode & ARMED_FLAG)
            case "SERVO_OUTPUT_RAW":
                self._reports += 1
                self._servos_us = tuple(getattr(message, f"servo{n}_raw") for n in range(1, self._motors + 1))
            case "STATUSTEXT" if message.severity <= 4:
                self._refusal = message.text.strip()
            case _:
                return

    def _go(self, t_us: int, step: SilenceStep) -> None:
        self._step, self._since_us = step, t_us
        self._last_request_us = t_us - REQUEST_EVERY_US

    def _give_up(self, t_us: int, problem: str) -> None:
        self.problem, self._rest = problem, REST_SENDS
        self._go(t_us, SilenceStep.END)

    def _due(self, t_us: int) -> bool:
        if t_us - self._last_request_us < REQUEST_EVERY_US:
            return False
        self._last_request_us = t_us
        return True

    def _beat(self, t_us: int) -> None:
        if t_us - self._beat_us >= HEARTBEAT_US:
            self._beat_us = t_us
            self._wire.heartbeat()

    def _contact(self, t_us: int, passed_us: int) -> None:
        self._beat(t_us)
        if self._due(t_us):
            self._reports = 0
            self._wire.interval(SERVO_ID, SERVO_HZ)
        if self._mode is not None and self._armed:
            self.problem = "it is armed already: disarm it"  # by another source, which keeps it armed
            self._step = SilenceStep.DONE
        elif self._mode is not None and self._mode != MANUAL:
            self._give_up(t_us, "it is not in MANUAL: switch it")
        elif self._mode is not None and self._reports >= ENOUGH * SERVO_HZ:
            self._go(t_us, SilenceStep.ARM)
        elif passed_us > CONTACT_US:
            silent = self._mode is None
            self._give_up(
                t_us, f"it {'is silent' if silent else 'reports its outputs too slowly'}: check cable and link"
            )

    def _arm(self, t_us: int, passed_us: int) -> None:
        self._beat(t_us)
        if self._armed:
            self._go(t_us, SilenceStep.PUSH)
        elif passed_us > ARM_US:
            self._give_up(t_us, f"it does not arm: {self._refusal or 'no answer'}")
        elif self._due(t_us):
            self._wire.arm(armed=True)

    def _push(self, t_us: int, passed_us: int) -> None:
        self._beat(t_us)
        turning = bool(self._servos_us) and max(abs(us - 1500) for us in self._servos_us) > SHOWN_US
        if turning and passed_us > SPOOL_US + PUSH_FOR_US:
            self._go(t_us, SilenceStep.SILENCE)
            return
        if passed_us > 2 * (SPOOL_US + PUSH_FOR_US):
            self._give_up(t_us, "no thrust comes out: check its mode, its arming and gcs_system")
        elif t_us - self._sent_us >= SEND_EVERY_US:
            self._sent_us = t_us
            channels = list(NEUTRAL)
            channels[FORWARD] += PUSH_US
            self._wire.override(tuple(channels))

    def _silence(self, t_us: int, passed_us: int) -> None:
        still = bool(self._servos_us) and max(abs(us - 1500) for us in self._servos_us) <= STILL_US
        if still:
            self.neutral_s = 1e-6 * (t_us - self._sent_us)
        if still or passed_us > SILENT_US:
            self._rest = REST_SENDS
            self._go(t_us, SilenceStep.END)

    def _end(self, t_us: int, passed_us: int) -> None:
        if self._rest and t_us - self._sent_us >= SEND_EVERY_US:
            self._sent_us, self._rest = t_us, self._rest - 1
            self._wire.override(NEUTRAL)
        if self._armed and self._due(t_us):
            self._wire.arm(armed=False)
        if not self._rest and (not self._armed or passed_us > END_US):
            self._step = SilenceStep.DONE
