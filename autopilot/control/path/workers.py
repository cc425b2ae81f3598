"""Background workers of the controller, and the reports of their exceptions."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

from autopilot.core import operator_messages as notices
from autopilot.core.background import BackgroundWorker
from autopilot.core.notice_queue import NoticeQueue


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BackgroundWorkers:
    """One worker per kind of task, so that a route never waits for a trajectory. Without executors (the default) the
    caller does the work when its result is due.
    """

    routes: BackgroundWorker = field(default_factory=BackgroundWorker)
    trajectories: BackgroundWorker = field(default_factory=BackgroundWorker)
    certificates: BackgroundWorker = field(default_factory=BackgroundWorker)

    @classmethod
    def beside(cls, *, blocking: bool) -> "BackgroundWorkers":
        """A thread each. ``patient``: the loop waits for answers that are due."""
        routes, trajectories, certificates = (
            BackgroundWorker(ThreadPoolExecutor(1, thread_name_prefix=name), blocking=blocking)
            for name in ("routes", "trajectories", "certificates")
        )
        return cls(routes=routes, trajectories=trajectories, certificates=certificates)

    @property
    def executors(self) -> tuple[BackgroundWorker, ...]:
        return self.routes, self.trajectories, self.certificates

    @property
    def names(self) -> tuple[str, ...]:
        return "routes", "trajectories", "certificates"


class TaskFailures(NoticeQueue):
    """Reports of tasks that raised: one notice to the operator until one succeeds, full traceback in the log."""

    def __init__(self, work: str, text: notices.Row) -> None:
        """``work``: name of the task for the log; ``text``: text for the operator."""
        super().__init__()
        self._work, self._text = work, text
        self._notified = False
        self._logged = False

    def failed(self, error: Exception, *, notify: bool = True) -> None:
        """Record a failure; the operator is notified if it affects the vehicle's behaviour (``notify``)."""
        if not self._logged:
            self._logged = True
            self._notices.append(notices.WORK_FAILED(work=self._work, kind=type(error).__name__, error=error))
        if notify and not self._notified:
            self._notified = True
            self._notices.append(self._text())

    def succeeded(self) -> None:
        """The next one is news again."""
        self._notified = self._logged = False
