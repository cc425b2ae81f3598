"""Autopilot service for small underwater vehicles.

The service is one function, ``Outputs = Autopilot.step(Inputs)`` (:mod:`autopilot.command.service`); everything with
a clock, a socket or a file lives in the runtime around it (:mod:`autopilot.run.runtime`).

For programs and notebooks (docs/python.md): ``from autopilot import Simulation, fly, open_log``.
"""

import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from autopilot.api.simulation import Simulation, fly
    from autopilot.log.reader import open_log

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""How many threads linear algebra takes, read when numpy is first imported."""

# One, unless the user says otherwise: no matrix here has more than some hundred rows, and threads that wait for each
# other by spinning make ticks late when anything else runs on the machine.
for _variable in THREAD_VARIABLES:
    os.environ.setdefault(_variable, "1")

__version__ = "0.1.0"

_FRONT_DOOR = {
    "Simulation": "autopilot.api.simulation",
    "fly": "autopilot.api.simulation",
    "open_log": "autopilot.log.reader",
}
__all__ = ["Simulation", "fly", "open_log"]


def __getattr__(name: str) -> Any:
    """The front door, imported when it is used: commands start quicker without."""
    if name not in _FRONT_DOOR:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_FRONT_DOOR[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_FRONT_DOOR})
