"""ArduSub's parameters that our thrust depends on: read, checked, never written.

What is wrong with those that the mixing or a failsafe rests on refuses arming; the texts say which value it takes and
why. The pilot sets it in the ground station.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

NAMES_GONE_AFTER = 4
"""A parameter that has not been answered so often does not exist in this version."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """One parameter and what it has to be."""

    name: str
    fits: Callable[[float], bool]
    wanted: str
    why: str
    optional: bool = False
    """A version without it is no worse."""


def _is(value: float) -> Callable[[float], bool]:
    return lambda found: abs(found - value) < 0.5


CHANNELS = range(1, 7)

RULES: tuple[Rule, ...] = (
    Rule(name="MOT_FV_CPLNG_K", fits=lambda k: abs(k) < 1e-3, wanted="0", why="else heave takes from forward"),
    Rule(name="FS_PILOT_INPUT", fits=lambda k: k >= 0.5, wanted="1", why="else thrust goes on without us"),
    Rule(name="FS_PILOT_TIMEOUT", fits=lambda k: 0.1 <= k <= 0.55, wanted="0.4", why="thrust goes on so long"),
    Rule(name="FS_GCS_ENABLE", fits=lambda k: k >= 0.5, wanted="1 or more", why="its own failsafe stays on"),
    Rule(name="MOT_BAT_CURR_MAX", fits=_is(0.0), wanted="0", why="else it scales our thrust", optional=True),
    Rule(name="MOT_PWM_MIN", fits=_is(1100.0), wanted="1100", why="pulses are 1500 +- 400", optional=True),
    Rule(name="MOT_PWM_MAX", fits=_is(1900.0), wanted="1900", why="pulses are 1500 +- 400", optional=True),
    *(Rule(name=f"RC{n}_TRIM", fits=_is(1500.0), wanted="1500", why="its neutral is ours") for n in CHANNELS),
    *(Rule(name=f"RC{n}_MIN", fits=_is(1100.0), wanted="1100", why="its range is ours") for n in CHANNELS),
    *(Rule(name=f"RC{n}_MAX", fits=_is(1900.0), wanted="1900", why="its range is ours") for n in CHANNELS),
    *(Rule(name=f"RC{n}_REVERSED", fits=_is(0.0), wanted="0", why="its sign is ours") for n in CHANNELS),
)

OTHERS = ("FRAME_CONFIG", "ACRO_YAW_P", "BARO1_GND_PRESS", "BARO2_GND_PRESS", "BARO_SPEC_GRAV")
"""Read for what they say."""

GCS_IDS = ("MAV_GCS_SYSID", "SYSID_MYGCS")
"""Whom it obeys: a version has the one or the other."""


class Settings:
    """What has been read so far."""

    def __init__(self, frame_number: int, motors: int, ours: int) -> None:
        self._frame_number = frame_number
        self._ours = ours
        self.values: dict[str, float] = {}
        directions = [f"MOT_{motor}_DIRECTION" for motor in range(1, motors + 1)]
        self._asked = dict.fromkeys((*(rule.name for rule in RULES), *OTHERS, *GCS_IDS, *directions), 0)
        """Name -> how often it was asked for in vain."""

    @property
    def names(self) -> tuple[str, ...]:
        """All that are wanted."""
        return tuple(self._asked)

    def missing(self) -> list[str]:
        """Those that have not come and still may."""
        return [name for name, asked in self._asked.items() if name not in self.values and asked < NAMES_GONE_AFTER]

    def ask(self, name: str) -> None:
        """Note that it is asked for."""
        self._asked[name] += 1

    def advice(self) -> tuple[tuple[str, str], ...]:
        """What would be better, and how to set it."""
        if self.values.get("FS_PILOT_INPUT", 1.0) < 1.5:
            return ()
        found = "FS_PILOT_INPUT = 2: a pilot who takes over without a joystick is disarmed after FS_PILOT_TIMEOUT"
        return ((found, "set 1"),)

    def forget(self) -> None:
        """Everything is to be read anew, and nothing holds until then."""
        self.values.clear()
        self._asked = dict.fromkeys(self._asked, 0)

    def take(self, name: str, value: float) -> bool:
        """Note a value; whether it is news."""
        if name not in self._asked:
            return False
        news = self.values.get(name) != value
        self.values[name] = value
        return news

    @property
    def complete(self) -> bool:
        """Whether all that exist are there."""
        return not self.missing()

    def problems(self) -> tuple[str, ...]:
        """What has to be set differently before our thrust may act."""
        if not self.complete:
            return (f"flight controller: {len(self.missing())} parameters not read yet, wait",)
        values = self.values
        found = []
        frame = values.get("FRAME_CONFIG")
        if frame is None or round(frame) != self._frame_number:
            told = "is not answered" if frame is None else f"= {frame:g}"
            found.append(f"FRAME_CONFIG {told}: set {self._frame_number}, or the other `frame` in [devices]")
        found += [text for rule in RULES if (text := _verdict(rule, values))]
        ids = [values[name] for name in GCS_IDS if name in values]
        if ids and round(ids[0]) != self._ours:
            found.append(f"it obeys system {ids[0]:g}: set {GCS_IDS[0]} {self._ours}, or `gcs_system` in [devices]")
        return tuple(f"flight controller: {text}" for text in found)


def _verdict(rule: Rule, values: Mapping[str, float]) -> str:
    value = values.get(rule.name)
    if value is None:
        return "" if rule.optional else f"{rule.name} is not answered: check its version"
    return "" if rule.fits(value) else f"{rule.name} = {value:g}: set {rule.wanted}, {rule.why}"
