"""Thruster lag and latency: present thrust, and prediction of the state to the time at which a new command acts.

A thruster with first-order lag T and thrust F that is commanded G delivers the same momentum as one that keeps F for T
and then steps to G. The plan therefore starts T ahead, at the state predicted with the present thrust, and needs no
thrust states. With a known command latency the prediction also covers the commands that have not acted yet.
"""

import ctypes
import math
from collections import deque
from collections.abc import Callable, Iterable
from functools import partial
from typing import TypeAlias

import numpy as np

from autopilot.control.nmpc.model_code import BUOYANCY, coefficients
from autopilot.core import compiled
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.model4 import NX, YAW, Model4
from autopilot.core.response import Response

Sent: TypeAlias = tuple[float, float, FloatArray]
"""From when until when [s] a command (n,) was sent."""

KEPT_S = 3.0
"""Length of the command history: the longest delay plus the lag."""

UNDER_WAY_S = 0.05
"""Interval of the prediction through commands that are under way."""

STEPS = 2
"""Runge-Kutta steps of an interval."""

LEARN_S = 3.0
"""Predictions learn within this time how far they have been off."""


class _Ahead(compiled.Mirror):
    """ctypes layout of the struct in follow.c."""

    _fields_ = (
        ("thrusters", ctypes.c_long),
        ("steps", ctypes.c_long),
        ("dt_s", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ("coefficients", "allocation", "x", "thrust", "current", "after")),
    )


class ThrusterLag:
    """Follows the acting thrust and predicts the state one lag ahead, with a delay that and the lag."""

    def __init__(self, model: Model4, response: Response) -> None:
        self._response = response
        # Different time constants: together about the response with their mean.
        self._lag_s = lag_s = response.mean_s
        self._x, self._u, self._c, self._out = np.zeros(NX), np.zeros(model.thrusters), np.zeros(3), np.zeros(NX)
        self._coefficients, self._allocation = np.array(coefficients(model)), np.array(model.allocation)
        self._through_lag, self._through_pending = self._integration(lag_s), self._integration(UNDER_WAY_S)
        self._sent: deque[Sent] = deque()
        self.acting_n = np.zeros(model.thrusters)
        """(n,) thrust that acts now."""
        self.reset()

    def reset(self) -> None:
        """Zero thrust, no pending commands, no latency."""
        self.acting_n[:] = 0.0
        self._sent.clear()
        self._now_s = self.delay_s = 0.0
        """Command latency [s]; set by :meth:`act_late`."""
        self.jumped()

    def jumped(self) -> None:
        """The state or the prediction model has jumped: discard predictions that would be compared with it."""
        self._predicted: deque[tuple[float, FloatArray]] = deque()
        self._off = np.zeros(NX)
        self._compared_s = self._now_s

    def trim(self, buoyancy_excess_n: float) -> None:
        """Predictions count on that excess buoyancy [N] from now on."""
        self._coefficients[BUOYANCY] = buoyancy_excess_n

    def act_late(self, delay_s: float) -> None:
        """Commands reach the thrusters ``delay_s`` late, and have done so from the first."""
        if delay_s == self.delay_s:
            return
        self.delay_s = delay_s
        self.jumped()
        self.acting_n[:] = 0.0
        self._pass(self.acting_n, self._sent, self._now_s - KEPT_S, self._now_s - delay_s)

    def follow(self, command_n: FloatArray, elapsed_s: float) -> None:
        """``command_n`` (n,) has been commanded for the last ``elapsed_s``."""
        elapsed_s = max(elapsed_s, 0.0)
        before_s, self._now_s = self._now_s, self._now_s + elapsed_s
        self._sent.append((before_s, self._now_s, command_n.copy()))
        while self._sent[0][1] < self._now_s - KEPT_S:
            self._sent.popleft()
        if self.delay_s:
            self._pass(self.acting_n, self._sent, before_s - self.delay_s, self._now_s - self.delay_s)
        else:
            self._respond(self.acting_n, command_n, elapsed_s)

    def ahead(self, x: FloatArray, current_ned_m_s: FloatArray) -> FloatArray:
        """State (8,) one lag, after a delay, from the state ``x`` (8,) of now."""
        self._x[:], self._c[:] = x, current_ned_m_s
        if self.delay_s:
            return self._ahead_of_all(x)
        self._u[:] = self.acting_n
        self._through_lag()
        return self._out.copy()

    def _ahead_of_all(self, x: FloatArray) -> FloatArray:
        """Prediction over all pending commands, plus the mean prediction error.

        Over a second an error of buoyancy, drag or thrust is significant, and a plan that starts at the wrong state
        never corrects it. Predictions are therefore compared with later states (output disturbance model of MPC).
        """
        acting, begin_s = self.acting_n.copy(), self._now_s - self.delay_s
        pending = [sent for sent in self._sent if sent[1] > begin_s]
        for i in range(1, round(self.delay_s / UNDER_WAY_S) + 1):
            before = acting.copy()
            end_s = min(begin_s + i * UNDER_WAY_S, self._now_s)
            self._pass(acting, pending, begin_s + (i - 1) * UNDER_WAY_S, end_s)
            self._u[:] = 0.5 * (before + acting)
            self._through_pending()
            self._x[:] = self._out
        self._u[:] = acting
        self._through_lag()
        self._compare(x)
        self._predicted.append((self._now_s + self.delay_s + self._lag_s, self._out.copy()))
        return self._out + self._off

    def _compare(self, x: FloatArray) -> None:
        due: FloatArray | None = None
        while self._predicted and self._predicted[0][0] <= self._now_s:
            due = self._predicted.popleft()[1]
        if due is not None:
            off = x - due
            off[YAW] = wrap_pi(float(off[YAW]))
            self._off += (1.0 - math.exp(-(self._now_s - self._compared_s) / LEARN_S)) * (off - self._off)
        self._compared_s = self._now_s

    def _pass(self, acting: FloatArray, sent: Iterable[Sent], begin_s: float, end_s: float) -> None:
        """Advance ``acting`` (n,) by the commands sent between two times."""
        for sent_s, until_s, command in sent:
            if sent_s >= end_s:
                break
            if until_s > begin_s:
                self._respond(acting, command, min(until_s, end_s) - max(sent_s, begin_s))

    def _respond(self, acting: FloatArray, command_n: FloatArray, elapsed_s: float) -> None:
        acting += self._response.fraction(elapsed_s) * (command_n - acting)

    def _integration(self, dt_s: float) -> Callable[[], None]:
        """Takes ``_x`` over ``dt_s`` to ``_out`` with ``_u`` and ``_c``."""
        arrays = {"coefficients": self._coefficients, "allocation": self._allocation, "x": self._x}
        arrays |= {"thrust": self._u, "current": self._c, "after": self._out}
        addresses = {name: array.ctypes.data for name, array in arrays.items()}
        struct = _Ahead(thrusters=len(self._u), steps=STEPS, dt_s=dt_s, **addresses)
        return partial(compiled.load(_Ahead).state_ahead, ctypes.byref(struct))
