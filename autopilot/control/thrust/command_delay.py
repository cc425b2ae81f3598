"""Command latency in use: the estimated delay, and the part of past commands that acts now."""

import math
from collections import deque
from dataclasses import replace

import numpy as np

from autopilot.control.thrust.actuation_delay import ActuationDelay
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavState
from autopilot.core.params import ParamSet
from autopilot.core.response import Response
from autopilot.core.vehicle import Vehicle

LONGEST_DOUBT_S = 2.5
"""Without thrust for so long a delay has shown itself; if not, something else is wrong with the thrusters."""


SETTLE_S = 4.0
"""The position estimator needs so long to forget the current that it saw in thrust that had not acted yet."""


class CommandDelay:
    """Estimates the command latency while armed (LAT_DETECT) and holds the pulses that have not acted yet."""

    def __init__(self, vehicle: Vehicle, params: ParamSet) -> None:
        self._params = params
        self._delay = ActuationDelay(vehicle.to_model(), Response.of(vehicle.thrusters))
        self._kept_us = round(float(self._delay.delays_s[-1]) * 1e6) + 1
        self._sent: deque[tuple[int, FloatArray]] = deque()
        self._suspect_since_us: int | None = None
        self._looked = False
        self._found_us: int | None = None
        self.delay_s = 0.0
        """Command latency [s]; 0 until it is certain."""
        self.doubtful = False
        """Thrust has shown no effect yet though it should have, and it is not known how late it will: no more of it."""

    @property
    def prompt(self) -> bool:
        """Whether the estimated latency is zero."""
        return self.delay_s == 0.0 and not self.doubtful

    def send(self, t_us: int, pulse_n: FloatArray) -> FloatArray:
        """(n,) thrust that acts now [N]. ``pulse_n`` (n,): thrust of healthy thrusters for the pulses since the last
        call.
        """
        self._sent.append((t_us, pulse_n))
        while self._sent[0][0] < t_us - self._kept_us:
            self._sent.popleft()
        since_us = t_us - round((self._delay.shortest_s if self.doubtful else self.delay_s) * 1e6)
        for sent_us, sent_n in reversed(self._sent):
            if sent_us <= since_us:
                return sent_n
        return np.zeros_like(pulse_n)

    def step(self, t_us: int, nav: NavState | None, *, armed: bool) -> None:
        """Learn from the estimate of now, after :meth:`send`. Disarmed, everything is forgotten."""
        if not armed or not int(self._params["LAT_DETECT"]):
            self.delay_s, self.doubtful, self._suspect_since_us, self._found_us = 0.0, False, None, None
            if self._looked:
                self._delay.reset()
            self._looked = False
            return
        self._looked = True
        self._delay.step(t_us, nav, self._sent[-1][1])
        self.delay_s = self._delay.delay_s
        self._found_us = (t_us if self._found_us is None else self._found_us) if self.delay_s else None
        self._suspect_since_us = (self._suspect_since_us or t_us) if self._delay.doubtful else None
        self.doubtful = self._suspect_since_us is not None and t_us - self._suspect_since_us < LONGEST_DOUBT_S * 1e6

    def nav_for_control(self, t_us: int, nav: NavState) -> NavState:
        """The estimate for the controller: just after a delay has been found with the current of before."""
        if self._found_us is None or t_us - self._found_us > SETTLE_S * 1e6:
            return nav
        current = self._delay.current_ned_m_s
        c, s = math.cos(nav.rpy_rad[2]), math.sin(nav.rpy_rad[2])
        flow = np.array([c * current[0] + s * current[1], c * current[1] - s * current[0], current[2]])
        return replace(nav, current_ned_m_s=current, vel_water_frd_m_s=nav.vel_frd_m_s - flow)
