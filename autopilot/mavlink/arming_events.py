"""Reports reasons against arming as MAVLink events, by the health and arming check protocol of libevents.

A report is a summary of the arming checks, the reasons and a summary of the components' health. A new one is sent when
what it says has changed, and on request.
"""

from functools import reduce
from operator import or_

from autopilot.core.arming_reasons import ALL_MODES, COMPONENT_OF, ArmingReason, HealthComponent
from autopilot.core.messages import Failsafe
from autopilot.mavlink.context import MAX_TEXT_CHARS, Context
from autopilot.mavlink.event_metadata import (
    ARMING_CHECK_LAYOUT,
    ARMING_CHECK_SUMMARY,
    ARMING_REASON,
    HEALTH_LAYOUT,
    HEALTH_SUMMARY,
    REASON_LAYOUT,
    TEXT_CODES,
)
from autopilot.mavlink.event_text import spelled
from autopilot.mavlink.events import Events

FIRST_US = 1_500_000
"""First report after the start: until then clients of the run before learn that numbers begin anew."""
NEWS_US = 500_000
"""Least interval of reports: that in which the reasons are found (:mod:`autopilot.command.commander`)."""
SAME_RESULT_US = 2_000_000
"""Least interval of reports that change words and numbers only, which may flicker; PX4's reports keep it too."""
MOST_REASONS = 16
"""Of a report; vehicles with more have larger worries."""
LINES = 3
"""Events that a long reason takes at most."""
ERROR, PROTOCOL = 3, 8
"""Log levels of libevents; events of the second are not shown."""
_CHUNK = 0
"""A report is in one piece."""


class ArmingEvents:
    def __init__(self, ctx: Context, events: Events) -> None:
        self._ctx, self._events = ctx, events
        self._reported: tuple[tuple[ArmingReason, ...], int, bool] | None = None
        """Reasons, failsafes and whether there is a power monitor, as of the last report."""
        self._result: tuple[int, ...] = ()
        """Its bits."""
        self._due_us = round(FIRST_US * ctx.patience)
        self._words_us = 0
        self._asked = False

    def report(self) -> None:
        """Send a report at the next opportunity, though nothing has changed."""
        self._asked = True

    def tick(self) -> None:
        ctx, view = self._ctx, self._ctx.view
        state = view.arming_reasons, view.failsafes, view.power is None
        if ctx.t_us < self._due_us or (state == self._reported and not self._asked):
            return
        result = self._bits()
        if result == self._result and not self._asked:
            words = self._reported is None or view.arming_reasons != self._reported[0]
            if not words or ctx.t_us < self._words_us:
                return
        self._asked, self._reported, self._result = False, state, result
        self._due_us, self._words_us = (ctx.t_us + round(us * ctx.patience) for us in (NEWS_US, SAME_RESULT_US))
        self._send(view.arming_reasons[:MOST_REASONS], *result)

    def _bits(self) -> tuple[int, int, int, int]:
        """Modes that can be armed and run; components with reasons, that are present, with active failsafes."""
        view = self._ctx.view
        modes = reduce(or_, (reason.modes for reason in view.arming_reasons), ALL_MODES & 0)
        failing = {COMPONENT_OF[rule] for rule in Failsafe if view.failsafes >> rule & 1}
        present = set(HealthComponent) - {HealthComponent.NONE}
        if view.power is None:
            present.discard(HealthComponent.BATTERY)
        reasons = {reason.component for reason in view.arming_reasons}
        return int(ALL_MODES & ~modes), _set(reasons), _set(present), _set(failing)

    def _send(self, reasons: tuple[ArmingReason, ...], able: int, wrong: int, present: int, failing: int) -> None:
        emit = self._events.emit
        emit(ARMING_CHECK_SUMMARY, PROTOCOL, ARMING_CHECK_LAYOUT.pack(_CHUNK, wrong, 0, able, able))
        for reason in reasons:
            for text in spelled(self._ctx.numbered(reason.text)[:MAX_TEXT_CHARS], TEXT_CODES, LINES):
                emit(ARMING_REASON, ERROR, REASON_LAYOUT.pack(reason.modes, reason.component, text))
        emit(HEALTH_SUMMARY, PROTOCOL, HEALTH_LAYOUT.pack(_CHUNK, present, failing, 0))


def _set(components: set[HealthComponent]) -> int:
    return sum(1 << component for component in components)
