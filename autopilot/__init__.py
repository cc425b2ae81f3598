"""Autopilot service for small underwater vehicles.

The service is one function, ``Outputs = Autopilot.step(Inputs)`` (:mod:`autopilot.service`); everything with a clock,
a socket or a file lives in the runtime around it (:mod:`autopilot.runtime`).
"""

__version__ = "0.1.0"
