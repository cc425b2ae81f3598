"""The C library: compiled once, when the package is installed or its wheel is built (``setup.py``).

Nothing is compiled or cached at run time. Only the file inside the package is loaded, and only if it is complete and
built from the C sources beside it (:mod:`autopilot.core.seal`). The controller needs it; estimator, simulation and the
QP solver have a slower alternative. The environment variable ``AUTOPILOT_COMPILED=no`` selects those, for comparison.
"""

import ctypes
import os
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.seal import flaw

SWITCH = "AUTOPILOT_COMPILED"
OFF = "no"
LIBRARY = Path(__file__).with_name("_compiled.pyd" if os.name == "nt" else "_compiled.so")
SOURCES = Path(__file__).resolve().parents[1] / "data" / "native"
AGAIN = "run pip install again with a C compiler at hand"

_ADDRESS, _WHOLE, _REAL = ctypes.c_void_p, ctypes.c_long, ctypes.c_double
SIGNATURES: dict[str, tuple[Any, ...]] = {
    "workspace_bytes": (_WHOLE, _WHOLE, _WHOLE),
    "control_step": (None, _ADDRESS),
    "half_planes": (_REAL, _ADDRESS, _WHOLE, _ADDRESS, _WHOLE, _ADDRESS, _ADDRESS, _WHOLE, _ADDRESS, _ADDRESS),
    "tube_back_offs": (None, _ADDRESS, _WHOLE, _WHOLE, _WHOLE, _ADDRESS, _ADDRESS, _ADDRESS, _ADDRESS),
    "steady_thrust": (_WHOLE, _ADDRESS, _WHOLE, _ADDRESS, _ADDRESS),
    "nearest_on_route": (_REAL, _WHOLE, _ADDRESS, _ADDRESS, _ADDRESS, _REAL, _REAL, _REAL, _REAL, _ADDRESS),
    "rollout": (_WHOLE, _ADDRESS, _ADDRESS),
    "program_bounds": (None, _ADDRESS),
    "least_room": (_REAL, _WHOLE, _WHOLE, _ADDRESS, _WHOLE, _ADDRESS, _ADDRESS),
    "largest_gap": (_REAL, _WHOLE, _WHOLE, _WHOLE, _WHOLE, _ADDRESS, _ADDRESS),
    "state_ahead": (None, _ADDRESS),
    "inner_thrust": (None, _ADDRESS, _REAL),
    "rows_at": (None, _WHOLE, _WHOLE, _ADDRESS, _ADDRESS, _WHOLE, _ADDRESS, _ADDRESS),
    "nearest_at": (_REAL, _WHOLE, _WHOLE, *[_ADDRESS] * 3, _REAL, _REAL, _WHOLE, _REAL, _ADDRESS),
    "flow_at": (None, _WHOLE, _ADDRESS, _WHOLE, _WHOLE, _ADDRESS, _ADDRESS, _REAL, _ADDRESS, _ADDRESS),
    "fill_currents": (None, _ADDRESS),
    "motion_step": (None, _ADDRESS),
    "model_look": (None, _ADDRESS),
    "spread_step": (None, *[_ADDRESS] * 4),
    "kalman_update": (_WHOLE, _ADDRESS),
    "unbend": (None, _ADDRESS, _WHOLE, _WHOLE, _ADDRESS, _ADDRESS),
    "corner_fit": (_WHOLE, _ADDRESS, _ADDRESS, _WHOLE, _WHOLE, _ADDRESS, _ADDRESS),
    "nearest_markers": (None, _ADDRESS, _WHOLE, _ADDRESS),
    "plant_look": (None, _ADDRESS, _ADDRESS),
    "plant_turn": (None, _ADDRESS, _ADDRESS, _REAL),
    "plant_step": (None, _ADDRESS, _ADDRESS, _REAL),
    "plant_measure": (None, _ADDRESS, _ADDRESS),
}
"""Result and arguments of every exported function, in the order of the C prototype."""


class Mirror(ctypes.Structure):
    """A struct of the C sources as Python lays it out: same name (a leading underscore aside), same fields in the same
    order. :func:`load` compares both; a part asks for the library with the mirrors that it uses."""


class _FieldStruct(ctypes.Structure):
    """The ``FieldLayout`` of common.h."""

    _fields_ = (("name", ctypes.c_char_p), ("offset", ctypes.c_long), ("size", ctypes.c_long))


class _Layout(ctypes.Structure):
    """The ``StructLayout`` of common.h."""

    _fields_ = (("size", ctypes.c_long), ("count", ctypes.c_long), ("fields", _FieldStruct * 32))


def missing() -> str | None:
    """Reason why the library is not in use and the remedy; None if it is."""
    if switched_off():
        return f"switched off by {SWITCH}={OFF}"
    try:
        load()
    except ConfigError as error:
        return str(error)
    return None


def switched_off() -> bool:
    """Whether slower ways are to be taken where there are any."""
    return os.environ.get(SWITCH, "").strip().lower() == OFF


def library(*mirrors: type[Mirror]) -> Any | None:
    """The library, None if it is disabled or missing: for parts with a slower alternative."""
    try:
        return None if switched_off() else load(*mirrors)
    except ConfigError:
        return None


def address(array: Any) -> int:
    """Memory address of a contiguous, writable numpy array: in a tenth of the time of ``array.ctypes.data``."""
    return ctypes.addressof(ctypes.c_char.from_buffer(array)) if array.size else 0


def fitting(name: str, array: FloatArray, *shape: int) -> int:
    """The address of an array that the library reads or writes at this shape; the caller keeps the array.

    ValueError if it has another shape, or is not contiguous and of float64: the library would reach past its end.
    """
    if array.shape != shape or array.dtype != np.float64 or not array.flags.c_contiguous:
        wrong = f"{name} is {array.dtype} {array.shape}{'' if array.flags.c_contiguous else ', not contiguous'}"
        raise ValueError(f"{wrong}; give contiguous float64 {shape}")
    return array.ctypes.data


def load(*mirrors: type[Mirror]) -> Any:
    """The library, its structs those of ``mirrors``. ConfigError with reason and remedy if there is none."""
    library = _load(LIBRARY)
    for mirror in mirrors:
        wrong = _mismatch(library, mirror)
        if wrong:
            raise ConfigError(f"the compiled library is of another version: {wrong}; {AGAIN}")
    return library


def layout_of(library: Any, name: str) -> tuple[int, tuple[tuple[str, int, int], ...]]:
    """Size [bytes] of a struct of the library, and name, offset and size of its fields. ValueError if it is unknown."""
    layout = _Layout.in_dll(library, f"layout_{name}")
    fields = layout.fields[: layout.count]
    return layout.size, tuple((field.name.decode(), field.offset, field.size) for field in fields)


@lru_cache(maxsize=64)
def _mismatch(library: Any, mirror: type[Mirror]) -> str:
    """Difference between a struct of the library and its ctypes mirror, "" if there is none."""
    name = mirror.__name__.lstrip("_")
    try:
        size, fields = layout_of(library, name)
    except ValueError:
        return f"it has no struct {name}"
    ours = [(field[0], getattr(mirror, field[0]).offset, getattr(mirror, field[0]).size) for field in mirror._fields_]
    for mine, theirs in zip(ours, fields, strict=False):
        if mine != theirs:
            return f"{name}.{mine[0]} at {mine[1]} of {mine[2]} bytes, there {theirs[0]} at {theirs[1]} of {theirs[2]}"
    if len(ours) != len(fields) or ctypes.sizeof(mirror) != size:
        return f"{name} has {len(ours)} fields in {ctypes.sizeof(mirror)} bytes, there {len(fields)} in {size}"
    return ""


@lru_cache(maxsize=2)
def _load(path: Path) -> Any:
    if not path.exists():
        raise ConfigError(f"the compiled library {path.name} is missing; {AGAIN}")
    try:
        wrong = flaw(path, SOURCES)
        if wrong:
            raise ConfigError(f"{path.name} {wrong}; {AGAIN}")
        # Calls of microseconds: if each gave the interpreter away the loop would wait for other threads to return it.
        library = ctypes.PyDLL(str(path))
        for name, (result, *arguments) in SIGNATURES.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
    except (OSError, AttributeError) as error:
        raise ConfigError(f"{path.name} cannot be loaded ({error}); {AGAIN}") from error
    return library
