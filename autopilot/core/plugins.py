"""Plugins by name: a shipped one, one of an installed package, or any ``package:Class``.

A user's controller, estimator or plant needs no change of this repository (docs/extend.md). Names are resolved among
the shipped ones, then as ``package:Class``, then among the entry points of installed packages (group
``underwater_autopilot.controllers`` and so on). The class, or any other callable, is called with one context record
and returns the instance, which is checked against its protocol before use.
"""

import hashlib
import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points, packages_distributions, version
from pathlib import Path
from typing import Any

from autopilot.core.errors import AutopilotError, ConfigError, UnknownNameError
from autopilot.core.guard import place_of
from autopilot.core.names import did_you_mean, unknown
from autopilot.core.shipped_parts import SHIPPED_PARTS

GROUP = "underwater_autopilot.{kind}s"
"""Group of entry points: underwater_autopilot.controllers, .estimators, .plants."""

PAGE = "docs/extend.md"
"""Where the protocols are explained."""

_SPEC = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Plugin:
    """A part that has been found and not been made yet."""

    kind: str
    """controller, estimator, plant"""
    name: str
    """By which it was asked for."""
    asked_by: str
    """Option, variable or key that asked for it, for errors."""
    target: str
    """``module:attribute``"""
    call: Callable[..., Any]
    version: str
    """Name and version of the installed distribution that it is of, "" for a shipped one and for loose files."""
    sha256: str
    """Of the file that it stands in, "" for a shipped one."""

    def make(self, given: object, protocol: type) -> Any:
        """The instance, constructed from ``given``. ConfigError if that fails or it does not implement ``protocol``."""
        try:
            inspect.signature(self.call).bind(given)
        except TypeError as error:
            kind = type(given).__name__
            raise self._error(f"is called with one {kind}, which it does not take ({error}); see {PAGE}") from error
        except ValueError:
            pass  # a callable without a signature
        try:
            made = self.call(given)
        except AutopilotError:
            raise
        except Exception as error:
            raise self._error(f"cannot be made: {_one_line(error)}; correct it there") from error
        for name in _members(protocol):
            self._hold_against(made, name, getattr(protocol, name), protocol)
        return made

    def _hold_against(self, made: object, name: str, wanted: object, protocol: type) -> None:
        """ConfigError unless ``made`` has that member with compatible arguments."""
        try:
            found = inspect.getattr_static(made, name)
        except AttributeError as error:
            where = f"{protocol.__module__}.{protocol.__name__}"
            raise self._error(f"has no {name!r}; write it, or inherit from {where} (see {PAGE})") from error
        if not inspect.isfunction(wanted):
            return
        method = getattr(made, name) if callable(found) or isinstance(found, staticmethod | classmethod) else found
        if not callable(method):
            raise self._error(f"has a {name!r} that is no method; make it one (see {PAGE})")
        parameters = list(inspect.signature(wanted).parameters.values())[1:]
        keywords = {p.name: None for p in parameters if p.kind is inspect.Parameter.KEYWORD_ONLY}
        try:
            inspect.signature(method).bind(*(None for _ in range(len(parameters) - len(keywords))), **keywords)
        except TypeError as error:
            signature = ", ".join(f"{p.name}=" if p.name in keywords else p.name for p in parameters)
            raise self._error(f"has a {name}() that must take ({signature}): {error}; see {PAGE}") from error
        except ValueError:
            pass  # as above

    def _error(self, text: str) -> ConfigError:
        return ConfigError(f"{self.asked_by} {self.name!r}: {text}")


def is_plugin_name(kind: str, name: str) -> bool:
    """Whether there may be such a part: a shipped name, one of an installed package, or written as package:Class."""
    return name in SHIPPED_PARTS[kind] or _SPEC.fullmatch(name) is not None or name in _installed(kind)


def find_plugin(kind: str, name: str, asked_by: str | None = None) -> Plugin:
    """Locate the plugin of that name without making it: a shipped one before one of an installed package. ConfigError
    if there is none.
    """
    asked_by, shipped = asked_by or f"--{kind}", SHIPPED_PARTS[kind]
    entry = None if name in shipped else _installed(kind).get(name)
    target = shipped.get(name) or (name if entry is None else entry.value)
    if _SPEC.fullmatch(target) is None:
        names = [*shipped, *sorted(set(_installed(kind)) - set(shipped))]
        raise unknown(asked_by, name, names, more=", or package:Class for your own")
    call = _imported(target, f"{asked_by} {name!r}")
    module = target.partition(":")[0]
    distribution = "" if name in shipped else _distribution(entry, module)
    return Plugin(
        kind=kind,
        name=name,
        asked_by=asked_by,
        target=target,
        call=call,
        version=distribution,
        sha256="" if name in shipped else _digest(module),
    )


def _installed(kind: str) -> dict[str, EntryPoint]:
    """Entry points of installed packages by name."""
    return {entry.name: entry for entry in entry_points(group=GROUP.format(kind=kind))}


def _imported(target: str, who: str) -> Callable[..., Any]:
    """The object of a target. ConfigError if it cannot be imported or called."""
    module_name, _, path = target.partition(":")
    try:
        module = import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is not None and (module_name == error.name or module_name.startswith(f"{error.name}.")):
            remedy = "install its package, or put the folder that holds it on PYTHONPATH"
            raise UnknownNameError(f"{who}: there is no module {error.name!r}; {remedy}") from error
        raise ConfigError(f"{who}: needs the module {error.name!r}, which is not there; install it") from error
    except Exception as error:
        raise ConfigError(f"{who}: cannot be imported: {_one_line(error)}; correct it there") from error
    found: Any = module
    for part in path.split("."):
        if not hasattr(found, part):
            public = [name for name, value in vars(module).items() if isinstance(value, type) and name[:1] != "_"]
            meant = did_you_mean(path, public)
            raise UnknownNameError(f"{who}: {module_name} has no {path!r}; {meant}correct the name after the colon")
        found = getattr(found, part)
    if not callable(found):
        raise ConfigError(f"{who}: is a {type(found).__name__}; name a class, or a function that makes one")
    call: Callable[..., Any] = found
    return call


def _members(protocol: type) -> list[str]:
    """Public members that a protocol asks for, those of its bases first."""
    bases = [base for base in reversed(protocol.__mro__) if getattr(base, "_is_protocol", False)]
    return list(dict.fromkeys(name for base in bases for name in vars(base) if not name.startswith("_")))


def _distribution(entry: EntryPoint | None, module: str) -> str:
    """Name and version of the installed distribution, "" when it is of none."""
    if entry is not None and entry.dist is not None:
        return f"{entry.dist.name} {entry.dist.version}"
    names = packages_distributions().get(module.partition(".")[0], [])
    return f"{names[0]} {version(names[0])}" if names else ""


def _digest(module: str) -> str:
    """SHA-256 of a module's file, "" when it has none."""
    file = getattr(import_module(module), "__file__", None)
    return "" if file is None else hashlib.sha256(Path(file).read_bytes()).hexdigest()


def _one_line(error: Exception) -> str:
    """An exception in one line: kind, text and where it was raised."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text} ({place_of(error)})"
