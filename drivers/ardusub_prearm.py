"""ArduSub's own pre-arm checks and their texts.

SYS_STATUS (MAV_SYS_STATUS_PREARM_CHECK) gives the result, STATUSTEXT the reasons, on request: by itself it repeats
them every half minute. For versions without this bit only the texts are used.
"""

from typing import Any

PREARM_BIT = 0x1000_0000
"""MAV_SYS_STATUS_PREARM_CHECK."""
SYS_STATUS_ID, RUN_CHECKS = 1, 401
"""MAV_CMD_RUN_PREARM_CHECKS."""
PREFIX = "prearm:"
REQUEST_AGAIN_US = 30_000_000
STANDS_US = 40_000_000
"""A text that is not repeated for so long is over."""


class PrearmWatch:
    def __init__(self) -> None:
        self._passes: bool | None = None
        """None: it does not say."""
        self._text = ""
        self._text_us = 0
        self._last_request_us: int | None = None

    def take(self, t_us: int, message: Any) -> None:
        kind = message.get_type()
        if kind == "SYS_STATUS":
            reported = message.onboard_control_sensors_present & message.onboard_control_sensors_enabled & PREARM_BIT
            self._passes = bool(message.onboard_control_sensors_health & PREARM_BIT) if reported else None
        elif kind == "STATUSTEXT" and message.text.lower().startswith(PREFIX):
            self._text, self._text_us = message.text[len(PREFIX) :].strip(), t_us

    def due(self, t_us: int) -> bool:
        if self._last_request_us is not None and t_us - self._last_request_us < REQUEST_AGAIN_US:
            return False
        self._last_request_us = t_us
        return True

    def refusals(self, t_us: int) -> tuple[str, ...]:
        """Why it would not arm; () when it would."""
        fresh = bool(self._text) and t_us - self._text_us < STANDS_US
        if self._passes or not (fresh or self._passes is False):
            return ()
        why = self._text if fresh else "see its ground station"
        return (f"flight controller's own checks fail, {why}: fix that there",)
