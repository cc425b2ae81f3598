"""FLIGHT_INFORMATION: start time of the flight."""

from collections.abc import Mapping

from autopilot.mavlink.context import Context
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.telemetry import Builder
from autopilot.mavlink.wire import Message


class FlightInformation:
    """From arming to disarming; the times stay until the next arming."""

    def __init__(self, ctx: Context) -> None:
        self._ctx = ctx
        self._armed = False
        self._number = 0
        """Of the flight since the start, 0 = none so far."""
        self._armed_us = self._began_us = self._ended_us = 0

    def builders(self) -> Mapping[int, Builder]:
        return {mav.MAVLINK_MSG_ID_FLIGHT_INFORMATION: self.flight_information}

    def tick(self) -> None:
        """Note when the vehicle is armed, sent somewhere and disarmed."""
        view, t_us = self._ctx.view, self._ctx.t_us
        if view.armed and not self._armed:
            self._number += 1
            self._armed_us, self._began_us, self._ended_us = t_us, 0, 0
        elif self._armed and not view.armed:
            self._ended_us = t_us
        if view.armed and view.under_way and not self._began_us:
            self._began_us = t_us
        self._armed = view.armed

    def flight_information(self) -> Message | None:
        """FLIGHT_INFORMATION. All times are since the start of the service (common.xml: the UTC in the fields' names
        is a misnomer); 0 = not yet.
        """
        return mav.MAVLink_flight_information_message(
            self._ctx.boot_ms,
            self._armed_us,
            self._began_us,
            self._number,
            (self._ended_us // 1000) & 0xFFFF_FFFF,
        )
