"""Configuration of a run: defaults < environment < command line, with the source of each value.

Worlds and vehicles have files of their own (scenario, vehicle, parameters).
"""

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import platformdirs

from autopilot.core.errors import ConfigError
from autopilot.core.names import choice
from autopilot.core.params import ParamSet
from autopilot.core.shipped_parts import SHIPPED_PARTS

ENVIRONMENT_PREFIX = "AUTOPILOT_"
"""AUTOPILOT_STATE_DIR and so on: every setting's name in capitals."""

PROFILES = ("generic", "px4", "ardusub")
SENSORS = ("camera", "pose")
UNTIL = ("complete",)
WIRES = ("serial", "camera", "pwm")
"""As :data:`autopilot.sitl.hil.WIRES`."""
CURRENTS = ("estimate", "map", "none", "uniform")
BASINS = ("closed", "open", "unknown")
_NAMES: dict[str, tuple[str, ...]] = {
    **{kind: tuple(names) for kind, names in SHIPPED_PARTS.items()},
    "sensors": SENSORS,
    "currents": CURRENTS,
    "basin": BASINS,
    "hil": WIRES,
    "until": UNTIL,
    "profile": tuple(PROFILES),
}
"""Setting -> the names that it takes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """One value and its origin (default, environment, command line)."""

    value: Any
    origin: str


@dataclass(slots=True)
class EffectiveSettings:
    table: dict[str, Setting] = field(default_factory=dict)

    def put(self, name: str, value: Any, origin: str) -> None:
        self.table[name] = Setting(value=value, origin=origin)

    def __getitem__(self, name: str) -> Any:
        return self.table[name].value

    def values(self) -> dict[str, Any]:
        return {name: setting.value for name, setting in sorted(self.table.items())}


def default_connections(instance: int) -> tuple[str, ...]:
    """Where a client finds instance N: QGC's port, an API port, a TCP port (PX4's and ArduPilot's conventions)."""
    return (
        "udpout:127.0.0.1:14550",
        f"udpin:127.0.0.1:{14540 + instance}",
        f"tcpin:127.0.0.1:{5760 + 10 * instance}",
    )


MAX_PORT = 65535
ANY_VIEW_PORT = -1
"""``--view`` without a port: the first free one from the view's default on."""


def sitl_defaults(instance: int) -> dict[str, Any]:
    """Settings of `autopilot sitl` before environment and command line."""
    return {
        "scenario": "paper-tank",
        "vehicle": None,
        "speed": 1.0,
        "seed": None,
        "duration": None,
        "plan": None,
        "log": None,
        "connect": default_connections(instance),
        "controller": None,
        "estimator": None,
        "plant": None,
        "sensors": None,
        "hil": (),
        "markers": None,
        "currents": None,
        "basin": None,
        "currents_map": None,
        "currents_start": None,
        "profile": "px4",
        "start": False,
        "keep_plans": False,
        "until": None,
        "view": None,
        "foxglove": None,
        "state_dir": platformdirs.user_state_dir("underwater-autopilot", appauthor=False),
        "log_dir": str(Path(platformdirs.user_data_dir("underwater-autopilot", appauthor=False)) / "logs"),
        "log_quota_mb": 0.0,
        "log_camera_hz": 2.0,
    }


def vehicle_defaults(instance: int) -> dict[str, Any]:
    """Settings of `autopilot run` before its file, environment and command line."""
    shared = (
        *("profile", "state_dir", "log_dir", "log_quota_mb", "log_camera_hz", "plan", "log", "duration"),
        *("controller", "estimator", "view", "foxglove"),
    )
    sitl = sitl_defaults(instance)
    return {
        **{name: sitl[name] for name in shared},
        "connect": (f"udpin:0.0.0.0:{14540 + instance}", f"tcpin:127.0.0.1:{5760 + 10 * instance}"),
        "view_address": "127.0.0.1",
    }


_FROM_TEXT: dict[str, Any] = {
    "speed": float,
    "seed": int,
    "duration": float,
    "log_quota_mb": float,
    "log_camera_hz": float,
    "view": int,
    "foxglove": int,
    "connect": lambda text: tuple(text.split(",")),
    "hil": lambda text: tuple(text.split(",")),
    "start": lambda text: text.lower() in ("1", "true", "yes"),
    "keep_plans": lambda text: text.lower() in ("1", "true", "yes"),
}


def is_part(kind: str, name: str) -> bool:
    """Whether there may be a controller, estimator or plant of that name."""
    from autopilot.core.plugins import is_plugin_name  # not for --help

    return is_plugin_name(kind, name)


def name_to_use(setting: str, name: str) -> str:
    """The end of a message about a name that a setting does not take: which ones it does."""
    return f"{choice(name, _NAMES[setting])}{', or package:Class for your own' if setting in SHIPPED_PARTS else ''}"


_ALLOWED: dict[str, tuple[Callable[[Any], bool], str]] = {
    "speed": (lambda value: 0.0 <= value < math.inf, "0 or more"),
    "seed": (lambda value: value >= 0, "0 or more"),
    "duration": (lambda value: 0.0 < value < math.inf, "a number of seconds above 0"),
    "view": (lambda value: ANY_VIEW_PORT <= value <= MAX_PORT, f"a port, 0 to {MAX_PORT} (0 = any)"),
    "foxglove": (lambda value: 0 <= value <= MAX_PORT, f"a port, 0 to {MAX_PORT} (0 = any)"),
    "log_quota_mb": (lambda value: 0.0 <= value < math.inf, "0 (no limit) or a number of megabytes"),
    "log_camera_hz": (lambda value: 0.0 <= value <= 100.0, "0 (no pictures) to 100 pictures per second"),
}
"""Valid values of a setting, and their description."""


def _from_environment(name: str, variable: str, text: str) -> Any:
    """A variable's value; ConfigError if the setting cannot have it."""
    try:
        value = _FROM_TEXT.get(name, str)(text)
    except ValueError as error:
        raise ConfigError(f"{variable}={text!r} is not a number; correct or unset it") from error
    return allowed(name, value, f"{variable}={text!r}", "unset it")


def _is_name(setting: str, value: Any) -> bool:
    return value in _NAMES[setting] or (setting in SHIPPED_PARTS and isinstance(value, str) and is_part(setting, value))


def allowed(name: str, value: Any, text: str, undo: str) -> Any:
    """A setting's value; ConfigError, which begins with ``text``, if it cannot have it."""
    for each in value if isinstance(value, tuple) else (value,):
        if name in _NAMES and not _is_name(name, each):
            raise ConfigError(f"{text} is not known; {name_to_use(name, str(each))}, or {undo}")
    is_allowed, use = _ALLOWED.get(name, (lambda _: True, ""))
    if not is_allowed(value):
        raise ConfigError(f"{text} is not valid; use {use}, or {undo}")
    return value


def gather(
    defaults: dict[str, Any],
    given: dict[str, Any],
    environment: dict[str, str] | None = None,
    *,
    file: Mapping[str, Any] | None = None,
    file_name: str = "",
) -> EffectiveSettings:
    """Layer defaults, ``file``, environment and command line (``given``: None or empty = not given)."""
    settings = EffectiveSettings()
    env = dict(os.environ) if environment is None else environment
    for name, value in defaults.items():
        settings.put(name, value, "default")
        if file is not None and name in file:
            text = f"{file_name}: `$.service.{name}` = {file[name]!r}"
            settings.put(name, allowed(name, file[name], text, "remove it"), f"file {file_name}")
        variable = ENVIRONMENT_PREFIX + name.upper()
        if variable in env:
            settings.put(name, _from_environment(name, variable, env[variable]), f"environment {variable}")
        chosen = given.get(name)
        if chosen is not None and not (isinstance(chosen, tuple) and not chosen):
            settings.put(name, chosen, "command line")
    return settings


def flight_settings(folder: Path | str, given: dict[str, Any]) -> EffectiveSettings:
    """Settings of a self-contained simulated flight, in lockstep unless ``given`` overrides it: no environment
    variables, no connections, state files in ``folder``.
    """
    settings = gather(sitl_defaults(0), {"speed": 0.0, "state_dir": str(folder), **given}, {})
    settings.put("connect", (), "flight by itself")
    return settings


def chosen_part(settings: EffectiveSettings, kind: str, in_scenario: str) -> tuple[str, str]:
    """Name of the controller, estimator or plant, and the option, variable or key that set it (for errors)."""
    setting = settings.table[kind]
    if setting.value is None:
        if "scenario" not in settings.table:
            return in_scenario, "the default"
        return in_scenario, f"{settings['scenario']}: `$.plugins.{kind}`"
    by = setting.origin.removeprefix("environment ")
    return setting.value, f"--{kind}" if by == "command line" else by


def parse_overrides(texts: tuple[str, ...]) -> dict[str, float]:
    """``NAME=VALUE`` texts as parameters; ConfigError names a text that is not one."""
    values: dict[str, float] = {}
    for text in texts:
        name, _, raw = text.partition("=")
        try:
            values[name.strip()] = float(raw)
        except ValueError as error:
            raise ConfigError(f"--param {text!r}: write NAME=VALUE with a number") from error
    return values


MAX_SYSTEM_ID = 254
"""MAVLink system ids are 1 to 255; 255 is the ground station's by custom."""


def system_id(params: ParamSet, instance: int) -> int:
    """MAVLink system id of an instance. ConfigError beyond the valid range."""
    sysid = int(params["SYSID_THISMAV"]) + instance
    if sysid > MAX_SYSTEM_ID:
        raise ConfigError(
            f"SYSID_THISMAV {sysid - instance} plus instance {instance} is {sysid}; it may be {MAX_SYSTEM_ID} at most"
        )
    return sysid


def vehicle_uid(instance: int) -> int:
    """Unique id of an instance in AUTOPILOT_VERSION."""
    return instance + 1
