"""Trust in the camera: its fixes must move as dead reckoning does, and must not reset the filter twice.

A rejected camera is still monitored. It is used again when its fixes have moved with the vehicle for a while, which a
frozen image does not.
"""

from autopilot.core.messages import NavDoubt
from autopilot.estimator.estimator_tuning import FIX_MOTION
from autopilot.estimator.fix_motion import FixMotion, FixResidual, FixRun
from autopilot.estimator.history import Node
from autopilot.estimator.measure_pose import PoseFix
from autopilot.estimator.monitor import MonitorFinding
from autopilot.estimator.startup import agree

DENYING = 6
"""Fixes in a row, agreeing among themselves, that do not move as dead reckoning does: the camera is wrong."""
AGAIN_US = 3_000_000
"""A second reset within so long: the camera is wrong."""
BACK_US, BACK_COUNT = 1_000_000, 4
"""Fixes must have moved with the vehicle for so long, and be so many, before they are trusted again;"""
PATIENT_US = 3_000_000
"""when nothing moves they must have been inside the gate for so long."""
PROBATION_US = 3_000_000
"""So long after that nothing more is forgiven, and the estimate is not called good: pictures that are a little late
move nearly as the vehicle does."""


class FixTrust(MonitorFinding):
    def __init__(self) -> None:
        super().__init__()
        self._run = FixMotion()
        self._last: PoseFix | None = None
        self._reset_us: int | None = None
        self._back_us: int | None = None

    def doubts(self, t_us: int, newest: Node) -> tuple[NavDoubt, ...]:
        return (NavDoubt.CAMERA,) if self.doubtful(t_us) else ()

    def counts(self) -> dict[str, int]:
        return {"doubt.camera": self.count}

    def doubtful(self, t_us: int) -> bool:
        """Whether they are not, or have not been a moment ago."""
        return not self.trusted or (self._back_us is not None and t_us - self._back_us <= PROBATION_US)

    def can_isolate(self, t_us: int) -> bool:
        """Whether its fixes could isolate the faulty sensor at that time."""
        return self.since_us is None or t_us < self.since_us

    def restart(self) -> None:
        """Dead reckoning begins anew: a fix has been used, or the past has been computed again."""
        self._run.clear()
        self._last = None

    def see(self, fix: PoseFix, seen: FixResidual) -> None:
        """A fix that was not used. A jump begins another run."""
        if self._last is not None and not agree(fix, self._last):
            self._run.clear()
        self._last = fix
        self._run.add(seen)

    def denied(self, count: int) -> bool:
        """Whether dead reckoning denies the motion of the last fixes, as many as these or as there are.

        Fixes that deny the gyro alone are not denied."""
        run = self._newest(count)
        return run is not None and run.apart > 1.0 and not run.denies_gyro

    def _newest(self, count: int) -> FixRun | None:
        return self._run.last(count=max(FIX_MOTION.least, min(count, len(self._run))))

    def reinstate(self, back_us: int | None = None) -> None:
        """It has been right again for a while at ``back_us``; None: it may be as doubtful as it was."""
        self.since_us = None
        self._back_us = self._back_us if back_us is None else back_us
        self.restart()

    def note_reset(self, t_us: int) -> None:
        self._reset_us = t_us
        self.restart()

    def may_reset(self, t_us: int, count: int) -> bool:
        """Whether its fixes, so many that agree, may move the filter: not when they have done so, or were suspect,
        a moment ago, unless it is the gyro that they deny."""
        again = self._reset_us is not None and t_us - self._reset_us <= AGAIN_US
        if not again and not self.doubtful(t_us):
            return True
        run = self._newest(count)
        return run is not None and run.denies_gyro

    def recovered(self, *, lost: bool) -> FixRun | None:
        """The run of fixes that shows that it is right again, None = there is none. ``lost``: nothing is left of the
        position that they could deny."""
        run = self._run.last(span_us=BACK_US)
        if run is None or run.count < BACK_COUNT or not (run.follows or run.denies_gyro):
            return None
        if run.moves > FIX_MOTION.sure:
            return run
        whole = self._run.last(span_us=PATIENT_US)
        if whole is None or not whole.follows or abs(whole.moves) > FIX_MOTION.sure:
            return None
        # Nothing moves: a picture that stands still would have to show the very place by chance.
        return run if whole.inside or lost else None
