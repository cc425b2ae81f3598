"""Detection of a second sender: ArduSub's servo outputs compared with our commands.

ArduSub applies the last of several senders. A second one shows as outputs that alternate between our command and
another (it sends at 20 to 50 Hz, we at 50 Hz), or that never match while it is the faster one. Reports are counted,
not timed: they arrive at 50 Hz, so that the window is 0.3 s of the vehicle's time whatever the link's latency.
"""

from collections import deque
from collections.abc import Sequence
from itertools import pairwise

from autopilot.drivers.ardusub_mixing import NEUTRAL_US, PLANE_MOTORS

SERVO_WITHIN_US = 450_000
"""Outputs correspond to a command of this time and the link's round trip before the last: 20 ms to act, a late loop."""
PAUSE_US = 300_000
"""After so long without a command of ours its failsafe may have made the outputs neutral."""
SERVO_TOLERANCE_US = 4
SLOW_TOLERANCE_US = 20
"""Of upright motors behind ArduSub's low-pass of heave, which is not followed to the microsecond: 12 us measured."""

WINDOW = 15
"""Window of reports: 0.3 s."""
WINDOW_US = 1_500_000
"""Longest interval of reports (vehicle time): slower than 10 Hz they are not evaluated."""
TURNS = 2
"""Transitions from our outputs to others within the window."""
STANDING = 12
"""Consecutive reports of foreign outputs other than neutral: its own failsafe makes them neutral."""
OVER_AFTER_US = 1_000_000
"""Time after the last foreign output at which it is over."""
WRONG_US = 300_000
"""Neutral outputs instead of ours for so long: our commands do not arrive, or are refused."""
CLOCK_US = 1 << 32
"""SERVO_OUTPUT_RAW.time_usec wraps."""


class OutputWatch:
    """Commands in, reports of the servo rail in; who commands out."""

    def __init__(self) -> None:
        self._meant: deque[tuple[int, tuple[int, ...]]] = deque()
        self._found: tuple[int, ...] = ()
        """The last report."""
        self._wrong: deque[tuple[int, bool]] = deque(maxlen=WINDOW)
        """Of the last reports: time of the vehicle, and whether they show another command than ours."""
        self._clock_us: int | None = None
        self._t_us = 0
        self._last_wrong_us = 0
        self._since_us: int | None = None
        """Since when every report has been wrong."""
        self.rival = False
        """Somebody else commands the thrusters."""
        self.problem = ""
        """What stands at an output instead of what is meant, "" while all is well."""
        self.mismatch_count = 0
        """Reports that differ from the command."""

    def sent(self, t_us: int, servos_us: tuple[int, ...]) -> None:
        if not self._meant or t_us - self._meant[-1][0] > PAUSE_US:
            still = (NEUTRAL_US,) * len(servos_us)
            self._meant += [(t_us, still), (t_us, self._found or still)]  # heave is filtered from there on
        self._meant.append((t_us, servos_us))

    def forget(self) -> None:
        self._meant.clear()
        self.skip()

    def begin(self) -> None:
        self.skip()
        self.rival = False

    def skip(self, found: tuple[int, ...] = ()) -> None:
        """Ignore reports for now, as after a silence, this one too; a detected second sender is kept."""
        self._found = found or self._found
        self._wrong.clear()
        self._since_us, self.problem = None, ""

    def check(
        self,
        t_us: int,
        stamp_us: int,
        found: tuple[int, ...],
        *,
        slow_heave: Sequence[float] | None,
        round_trip_us: int = 0,
    ) -> None:
        """A report of the servo rail; ``stamp_us`` is SERVO_OUTPUT_RAW.time_usec, ``round_trip_us`` the link's.

        ``slow_heave``: signs of heave in the pulses of the upright motors, None where it is not filtered."""
        meant = self._meant
        if not meant:
            self.skip()
            return
        while meant[-1][0] - meant[0][0] > SERVO_WITHIN_US + round_trip_us:
            meant.popleft()
        now_us = self._vehicle_us(stamp_us)
        still = (NEUTRAL_US,) * len(found)
        commands = [servos for _, servos in meant]
        if t_us - meant[-1][0] > PAUSE_US:
            commands.append(still)
        if slow_heave is None:
            wrong = not any(_alike(found, one) for one in reversed(commands))
        else:
            wrong = not _is_slowly_meant(found, commands, slow_heave)
        self._wrong.append((now_us, wrong))
        while now_us - self._wrong[0][0] > WINDOW_US:
            self._wrong.popleft()
        if wrong:
            self.mismatch_count += 1
            self._last_wrong_us = now_us
            self._since_us = now_us if self._since_us is None else self._since_us
        else:
            self._since_us = None
        self._judge(now_us, neutral=found == still)
        self.problem = self._standing(now_us, found)

    def _vehicle_us(self, stamp_us: int) -> int:
        """Its clock without the wrap; one that goes back (a reboot) stands."""
        passed_us = 0 if self._clock_us is None else (stamp_us - self._clock_us) % CLOCK_US
        self._clock_us = stamp_us
        self._t_us += passed_us if passed_us < CLOCK_US // 2 else 0
        return self._t_us

    def _judge(self, now_us: int, *, neutral: bool) -> None:
        wrongs = [wrong for _, wrong in self._wrong]
        turns = sum(later and not earlier for earlier, later in pairwise(wrongs))
        standing = not neutral and len(wrongs) >= STANDING and all(wrongs[-STANDING:])
        if turns >= TURNS or standing:
            self.rival = True
        elif now_us - self._last_wrong_us > OVER_AFTER_US:
            self.rival = False

    def _standing(self, now_us: int, found: tuple[int, ...]) -> str:
        if self.rival or self._since_us is None:
            return ""
        if now_us - self._since_us <= WRONG_US:
            return self.problem
        meant = self._meant[-1][1]
        worst = max(range(len(meant)), key=lambda motor: abs(found[motor] - meant[motor]))
        return f"motor {worst + 1} gets {found[worst]} us instead of {meant[worst]}: check its settings"


def _is_slowly_meant(found: tuple[int, ...], commands: Sequence[tuple[int, ...]], signs: Sequence[float]) -> bool:
    """As for other motors, with filtered heave: it lies between that of a longer window, roll and pitch as meant."""
    heave_us, turns = _heave_apart(found, signs)
    flat = found[:PLANE_MOTORS]
    apart = [(*_heave_apart(meant, signs), meant[:PLANE_MOTORS]) for meant in reversed(commands)]
    heaves_us = [heave_us for heave_us, *_ in apart]
    between = min(heaves_us) - SLOW_TOLERANCE_US <= heave_us <= max(heaves_us) + SLOW_TOLERANCE_US
    return between and any(_alike(flat, plane) and _alike(turns, turning) for _, turning, plane in apart)


def _heave_apart(servos_us: Sequence[int], signs: Sequence[float]) -> tuple[float, list[float]]:
    """Heave in the pulses of the upright motors, and what they have beside it."""
    off_us = [pulse_us - NEUTRAL_US for pulse_us in servos_us[PLANE_MOTORS:]]
    heave_us = sum(sign * off for sign, off in zip(signs, off_us, strict=True)) / len(off_us)
    return heave_us, [off - sign * heave_us for sign, off in zip(signs, off_us, strict=True)]


def _alike(found: Sequence[float], meant: Sequence[float]) -> bool:
    return all(abs(one - other) <= SERVO_TOLERANCE_US for one, other in zip(found, meant, strict=True))
