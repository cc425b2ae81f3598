"""Where plans are asked for: an answer is taken a counted number of control steps after its request.

So a run does not depend on how fast the machine plans. Without an executor the plan is made at the moment it is due.
With one it is made beside the loop; ``patient`` then says whether the loop waits for an answer that is due (simulation
in lockstep) or goes on and takes it when it comes (a vehicle in real time; late answers are counted).
"""

from collections.abc import Callable
from concurrent.futures import Executor, Future

from autopilot.control.energy.search import Plan, Request

ANSWER_STEPS = 3
"""A plan is taken so many control steps after it was asked for: 0.15 s at 20 Hz."""


class PlanningDesk:
    """One request at a time; a new one replaces the one that is open."""

    def __init__(
        self,
        plan: Callable[[Request], Plan],
        executor: Executor | None = None,
        *,
        patient: bool = True,
    ) -> None:
        self._plan, self._executor, self._patient = plan, executor, patient
        self.late = 0
        """Answers that were not there when they were due."""
        self.clear()

    def clear(self) -> None:
        """Forget the open request."""
        self._due = 0
        self._request: Request | None = None
        self._future: Future[Plan] | None = None
        self._counted = False

    @property
    def open(self) -> Request | None:
        """The request that has not been answered yet."""
        return self._request

    def submit(self, step: int, request: Request) -> None:
        """Ask for a plan in control step number ``step``."""
        self.clear()
        self._request, self._due = request, step + ANSWER_STEPS
        if self._executor is not None:
            self._future = self._executor.submit(self._plan, request)

    def poll(self, step: int) -> tuple[Request, Plan] | None:
        """The answer, once, when it is due."""
        request, future = self._request, self._future
        if request is None or step < self._due:
            return None
        if future is not None and not self._patient and not future.done():
            self.late += 0 if self._counted else 1
            self._counted = True
            return None
        plan = self._plan(request) if future is None else future.result()
        self.clear()
        return request, plan
