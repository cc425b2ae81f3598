"""Notices of a part of the controller, kept until they are taken."""

from autopilot.core.messages import Severity


class NoticeQueue:
    """Base of parts that notify operator and log."""

    def __init__(self) -> None:
        self._news: list[tuple[Severity, str]] = []

    def take_news(self) -> list[tuple[Severity, str]]:
        """Severity and text of what has come since the last call."""
        news, self._news = self._news, []
        return news
