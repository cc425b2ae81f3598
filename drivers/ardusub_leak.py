"""State of ArduSub's leak probe: it warns at intervals while the probe is wet, and sends nothing while it is dry."""

from autopilot.core.samples import LeakSample

REPEAT_US = 20_000_000
"""Between its warnings; the first comes as late as this after its start (failsafe_leak_check of ArduSub)."""
DRY_US = REPEAT_US + 1_000_000
"""Heard for so long without a warning, it is dry: before, the state is unknown."""
HOLD_US = 2 * REPEAT_US + 5_000_000
"""Heard for so long without another warning, it is dry again: one repetition may be lost."""
EVERY_US = 1_000_000
LEAK_TEXT = "leak detected"


class LeakWatch:
    """Outlives the connection: what was wet is wet when the link is opened again."""

    def __init__(self) -> None:
        self._since_us: int | None = None
        """Since when it has been heard without a gap in which all of its warnings could have been lost."""
        self._heard_us = 0
        self._warned_us: int | None = None
        self._reported_us = -EVERY_US

    def hear(self, t_us: int, text: str = "") -> None:
        """Any message of it; ``text`` of a STATUSTEXT."""
        if self._since_us is None or t_us - self._heard_us > REPEAT_US:
            self._since_us = t_us
        self._heard_us = t_us
        if LEAK_TEXT in text.lower():
            self._warned_us, self._reported_us = t_us, t_us - EVERY_US

    def samples(self, t_us: int, *, silent: bool) -> list[LeakSample]:
        """Its state once per second, a warning at once; none while it is unknown. A flight controller that is
        ``silent`` says neither that its probe is dry nor that it is no longer wet."""
        if self._since_us is None or t_us - self._reported_us < EVERY_US:
            return []
        warned_us = self._warned_us
        quiet_us = self._heard_us - (self._since_us if warned_us is None else max(self._since_us, warned_us))
        wet = warned_us is not None and quiet_us < HOLD_US
        if not wet and (silent or quiet_us < DRY_US):
            return []
        self._reported_us = t_us
        return [LeakSample(t_us=t_us, wet=wet)]
