"""Autopilot service for small underwater vehicles.

The service is one function, ``Outputs = Autopilot.step(Inputs)`` (:mod:`autopilot.command.service`); everything with
a clock, a socket or a file lives in the runtime around it (:mod:`autopilot.run.runtime`).
"""

import os

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""How many threads linear algebra takes, read when numpy is first imported."""

# One, unless the user says otherwise: no matrix here has more than some hundred rows, and threads that wait for each
# other by spinning make ticks late when anything else runs on the machine.
for _variable in THREAD_VARIABLES:
    os.environ.setdefault(_variable, "1")

__version__ = "0.1.0"
