"""The library in C: compiled once, when the package is installed where a C compiler is at hand (``setup.py``).

Running, nothing is compiled or cached. Only the file inside the package is loaded, and that only if it is whole and
made of the C sources beside it (:mod:`autopilot.core.seal`). Nothing needs it: where it is missing, damaged, old or of
another processor, slower ways do the same. The environment variable ``AUTOPILOT_COMPILED=no`` switches it off.
"""

import ctypes
import os
import sysconfig
from functools import lru_cache
from pathlib import Path
from typing import Any

from autopilot.core.seal import flaw

SWITCH = "AUTOPILOT_COMPILED"
OFF = "no"
LIBRARY = Path(__file__).with_name(f"_compiled{sysconfig.get_config_var('EXT_SUFFIX')}")
SOURCES = Path(__file__).resolve().parents[1] / "data" / "native"
AGAIN = "run pip install again with a C compiler at hand"


def missing() -> str | None:
    """Why the library is not used, and what to do about it; None if it is."""
    try:
        load()
    except RuntimeError as error:
        return str(error)
    return None


def library() -> Any | None:
    """The library, None where there is none: for parts that only get slower without it."""
    try:
        return load()
    except RuntimeError:
        return None


def address(array: Any) -> int:
    """Of the memory of a contiguous, writable numpy array: a tenth of the time of ``array.ctypes.data``."""
    return ctypes.addressof(ctypes.c_char.from_buffer(array)) if array.size else 0


def load() -> Any:
    """The library. RuntimeError says why there is none."""
    if os.environ.get(SWITCH, "").strip().lower() == OFF:
        raise RuntimeError(f"switched off by {SWITCH}={OFF}")
    return _load(LIBRARY)


@lru_cache(maxsize=2)
def _load(path: Path) -> Any:
    if not path.exists():
        raise RuntimeError(f"not compiled when it was installed; {AGAIN}")
    try:
        wrong = flaw(path, SOURCES)
        if wrong:
            raise RuntimeError(f"{path.name} {wrong}; {AGAIN}")
        # Calls of microseconds: if each gave the interpreter away the loop would wait for other threads to return it.
        library = ctypes.PyDLL(str(path))
        address, whole = ctypes.c_void_p, ctypes.c_long
        library.workspace_bytes.restype = library.task_bytes.restype = whole
        library.workspace_bytes.argtypes = [whole, whole]
        library.control_step.restype = library.tube_back_offs.restype = None
        library.program_bounds.restype, library.least_room.restype = None, ctypes.c_double
        library.largest_gap.restype, library.largest_gap.argtypes = ctypes.c_double, [*[whole] * 4, address, address]
        library.least_room.argtypes = [whole, whole, address, whole, address, address]
        library.state_ahead.restype = library.inner_thrust.restype = library.rows_at.restype = None
        library.inner_thrust.argtypes = [address, ctypes.c_double]
        library.rows_at.argtypes = [whole, whole, address, address, whole, address, address]
        library.nearest_at.restype, number = ctypes.c_double, ctypes.c_double
        library.nearest_at.argtypes = [whole, whole, *[address] * 3, number, number, whole, number, address]
        library.nearest_on_route.restype = number
        library.nearest_on_route.argtypes = [whole, *[address] * 3, *[number] * 4, ctypes.POINTER(number)]
        library.flow_at.restype = library.fill_currents.restype = None
        library.fill_currents.argtypes = [address]
        library.flow_at.argtypes = [whole, address, whole, whole, address, address, number, address, address]
        library.march.restype = library.steady_thrust.restype = whole
        library.march.argtypes, library.steady_thrust.argtypes = [address] * 2, [address, whole, address, address]
        library.half_planes.restype = ctypes.c_double
        library.half_planes.argtypes = [address, whole, address, whole, address, address, whole, address, address]
        library.motion_doubles.restype = library.look_doubles.restype = whole
        library.motion_step.restype = library.model_look.restype = None
        library.motion_step.argtypes = library.model_look.argtypes = [address]
        library.tube_back_offs.argtypes = [address, whole, whole, whole, address, address, address, address]
        library.plant_bytes.restype, library.plant_bytes.argtypes = whole, [whole]
        for plain in (library.plant_look, library.plant_measure):
            plain.restype, plain.argtypes = None, [address, address]
        for timed in (library.plant_turn, library.plant_step):
            timed.restype, timed.argtypes = None, [address, address, ctypes.c_double]
    except (OSError, AttributeError) as error:
        raise RuntimeError(f"{path.name} cannot be loaded ({error}); {AGAIN}") from error
    return library
