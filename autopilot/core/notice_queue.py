"""Queue of notices to operator and log."""

from autopilot.core.messages import Severity


class NoticeQueue:
    """Base of parts that notify operators: they append severity and text to ``_notices``."""

    def __init__(self) -> None:
        self._notices: list[tuple[Severity, str]] = []

    def take_notices(self) -> list[tuple[Severity, str]]:
        """Severity and text of the notices since the last call."""
        taken, self._notices = self._notices, []
        return taken
