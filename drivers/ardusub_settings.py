"""ArduSub's parameters that affect our thrust: read, checked, never written.

Values that break the mixing or a failsafe prevent arming; the texts give the required value and the reason. The pilot
sets them in the ground station.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

NAMES_MISSING_AFTER, AT_MOST = 4, 20
"""A parameter that has not been answered so often does not exist in this version; more often on a link with loss, until
chance is ruled out:"""
CHANCE = 1e-4
"""Of one that exists."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    name: str
    fits: Callable[[float], bool]
    wanted: str
    why: str
    optional: bool = False
    """A version without it is no worse."""


def _is(value: float) -> Callable[[float], bool]:
    return lambda found: abs(found - value) < 0.5


def _without(bit: int) -> Callable[[float], bool]:
    return lambda found: not round(found) >> bit & 1


CHANNELS = range(1, 7)
CHANNEL_OF = {"PITCH": 1, "ROLL": 2, "THROTTLE": 3, "YAW": 4, "FORWARD": 5, "LATERAL": 6}
"""RCMAP_...: which channel each axis is."""
FIRST_MOTOR = 33
"""SERVOn_FUNCTION of motor 1."""
IGNORE_OVERRIDES = 1
"""Bit of RC_OPTIONS."""

STANDING_THRUST = "RC_PROTOCOLS"
"""With a receiver enabled, each of its frames counts as pilot input while an override is younger than RC_OVERRIDE_TIME,
and the last override is applied again: FS_PILOT_TIMEOUT does not begin before that (ArduSub's Sub::read_radio)."""

RULES: tuple[Rule, ...] = (
    Rule(name="MOT_FV_CPLNG_K", fits=lambda k: abs(k) < 1e-3, wanted="0", why="else heave takes from forward"),
    Rule(name="FS_PILOT_INPUT", fits=lambda k: k >= 0.5, wanted="1", why="else thrust goes on without us"),
    Rule(name="FS_PILOT_TIMEOUT", fits=lambda k: 0.1 <= k <= 0.55, wanted="0.4", why="thrust goes on so long"),
    Rule(
        name=STANDING_THRUST,
        fits=_is(0.0),
        wanted="0",
        why="else thrust goes on without us for RC_OVERRIDE_TIME",
        optional=True,
    ),
    Rule(
        name="RC_OVERRIDE_TIME",
        fits=lambda k: 0.1 <= k <= 3.0,
        wanted="3",
        why="0 refuses our thrust, longer ones keep it",
        optional=True,
    ),
    Rule(
        name="RC_OPTIONS",
        fits=_without(IGNORE_OVERRIDES),
        wanted="it without 2",
        why="else our thrust is ignored",
        optional=True,
    ),
    Rule(name="FS_THR_ENABLE", fits=lambda k: k < 1.5, wanted="0", why="2 surfaces when we are silent", optional=True),
    Rule(name="FS_GCS_ENABLE", fits=lambda k: k >= 0.5, wanted="1 or more", why="its own failsafe stays on"),
    Rule(name="MOT_BAT_CURR_MAX", fits=_is(0.0), wanted="0", why="else it scales our thrust", optional=True),
    Rule(name="MOT_PWM_MIN", fits=_is(1100.0), wanted="1100", why="pulses are 1500 +- 400", optional=True),
    Rule(name="MOT_PWM_MAX", fits=_is(1900.0), wanted="1900", why="pulses are 1500 +- 400", optional=True),
    *(Rule(name=f"RC{n}_TRIM", fits=_is(1500.0), wanted="1500", why="its neutral is ours") for n in CHANNELS),
    *(Rule(name=f"RC{n}_MIN", fits=_is(1100.0), wanted="1100", why="its range is ours") for n in CHANNELS),
    *(Rule(name=f"RC{n}_MAX", fits=_is(1900.0), wanted="1900", why="its range is ours") for n in CHANNELS),
    *(Rule(name=f"RC{n}_REVERSED", fits=_is(0.0), wanted="0", why="its sign is ours") for n in CHANNELS),
    *(
        Rule(name=f"RC{n}_OPTION", fits=_is(0.0), wanted="0", why="our thrust would switch it", optional=True)
        for n in CHANNELS
    ),
    *(
        Rule(name=f"RCMAP_{axis}", fits=_is(n), wanted=f"{n}", why="its channels are ours", optional=True)
        for axis, n in CHANNEL_OF.items()
    ),
)

OTHERS = ("FRAME_CONFIG", "ACRO_YAW_P", "BARO1_GND_PRESS", "BARO2_GND_PRESS", "BARO_SPEC_GRAV")
"""Read for what they say."""

GCS_IDS = ("MAV_GCS_SYSID", "SYSID_MYGCS")
"""Whom it obeys: a version has the one or the other."""
LAST_GCS_ID = "MAV_GCS_SYSID_HI"
"""It obeys all ids from the first to this; a smaller one counts for nothing."""


def motor_rules(motors: int) -> tuple[Rule, ...]:
    """Required functions of the first outputs: motor n at output n."""
    return tuple(
        Rule(
            name=f"SERVO{n}_FUNCTION",
            fits=_is(FIRST_MOTOR + n - 1),
            wanted=f"{FIRST_MOTOR + n - 1}",
            why=f"motor {n} is there",
            optional=True,
        )
        for n in range(1, motors + 1)
    )


class ArduSubSettings:
    """Parameters read so far."""

    def __init__(self, frame_number: int, motors: int, ours: int, more: Sequence[str] = ()) -> None:
        """``more``: names of others to be read."""
        self._frame_number = frame_number
        self._ours = ours
        self._rules = (*RULES, *motor_rules(motors))
        self.values: dict[str, float] = {}
        directions = [f"MOT_{motor}_DIRECTION" for motor in range(1, motors + 1)]
        rules = (rule.name for rule in self._rules)
        self._requests = dict.fromkeys((*rules, *OTHERS, *GCS_IDS, LAST_GCS_ID, *directions, *more), 0)
        """Name -> how often it was asked for in vain."""
        self._problems: tuple[str, ...] | None = None
        """None: something has changed since they were last looked for."""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._requests)

    def missing(self) -> list[str]:
        tries = self._tries
        return [name for name, count in self._requests.items() if name not in self.values and count < tries]

    @property
    def _tries(self) -> int:
        """How often to ask, by what has been asked for in vain of what was answered in the end."""
        asked = sum(self._requests[name] for name in self.values)
        lost = 1.0 - len(self.values) / max(asked, 1)
        wanted = math.ceil(math.log(CHANCE) / math.log(lost)) if 0.0 < lost < 1.0 else 0
        return min(max(NAMES_MISSING_AFTER, wanted), AT_MOST)

    def note_request(self, name: str) -> None:
        self._requests[name] += 1
        self._problems = None

    def advice(self) -> tuple[tuple[str, str], ...]:
        """Recommended changes and how to make them."""
        if self.values.get("FS_PILOT_INPUT", 1.0) < 1.5:
            return ()
        found = "FS_PILOT_INPUT = 2: a pilot who takes over without a joystick is disarmed after FS_PILOT_TIMEOUT"
        return ((found, "set 1"),)

    def forget(self) -> None:
        """Everything is to be read anew, and nothing holds until then."""
        self.values.clear()
        self._requests = dict.fromkeys(self._requests, 0)
        self._problems = None

    def take(self, name: str, value: float) -> bool:
        """Note a value; whether it is news."""
        if name not in self._requests:
            return False
        news = self.values.get(name) != value
        self.values[name] = value
        self._problems = None
        return news

    @property
    def complete(self) -> bool:
        """Whether all that exist are there."""
        return not self.missing()

    def problems(self) -> tuple[str, ...]:
        """Settings that prevent the use of our thrust."""
        if self._problems is None:
            self._problems = self._found_problems()
        return self._problems

    def _found_problems(self) -> tuple[str, ...]:
        if not self.complete:
            return (f"flight controller: {len(self.missing())} parameters not read yet, wait",)
        values = self.values
        found = []
        frame = values.get("FRAME_CONFIG")
        if frame is None or round(frame) != self._frame_number:
            state = "is not answered" if frame is None else f"= {frame:g}"
            found.append(f"FRAME_CONFIG {state}: set {self._frame_number}, or the other `frame` in [devices]")
        found += [text for rule in self._rules if (text := _verdict(rule, values))]
        ids = [values[name] for name in GCS_IDS if name in values]
        if ids and round(ids[0]) != self._ours:
            found.append(f"it obeys system {ids[0]:g}: set {GCS_IDS[0]} {self._ours}, or `gcs_system` in [devices]")
        elif ids and values.get(LAST_GCS_ID, 0.0) > ids[0]:
            last = values[LAST_GCS_ID]
            found.append(f"it obeys systems {ids[0]:g} to {last:g}: set {LAST_GCS_ID} 0, one sender is enough")
        return tuple(f"flight controller: {text}" for text in found)


def _verdict(rule: Rule, values: Mapping[str, float]) -> str:
    value = values.get(rule.name)
    if value is None:
        return "" if rule.optional else f"{rule.name} is not answered: check its version"
    return "" if rule.fits(value) else f"{rule.name} = {value:g}: set {rule.wanted}, {rule.why}"
