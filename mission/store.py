"""The three plans in force: mission, fence, rally. Replaced as a whole or not at all.

A plan that is invalid by itself is refused. Plans that conflict with each other are stored, and
:attr:`Plans.problem` forbids flying until it is fixed. The check runs in a background worker: the plans in force
stay until it is done, and a change of the parameters repeats it. Without a worker everything is checked
synchronously.
"""

import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from operator import itemgetter

import numpy as np

from autopilot.core.background import BackgroundTask, BackgroundWorker, Cancel
from autopilot.core.errors import PlanError
from autopilot.core.frames import FloatArray
from autopilot.core.geodesy import MAX_RANGE_M, GeodeticPosition, Origin, far_text, geodetic_from_ned, ned_from_geodetic
from autopilot.core.geometry import Fence
from autopilot.core.origin_params import params_origin
from autopilot.core.params import ParamSet
from autopilot.core.plan import MissionResult, PlanChange, PlanItem, PlanKind, PlanProblem, PlanRejection, PlanStore
from autopilot.mission.extent import extent_of
from autopilot.mission.fence import FenceShape, build_fence
from autopilot.mission.item_types import parse_step
from autopilot.mission.items import Order, Step
from autopilot.mission.plan_check import (
    EMPTY,
    PLAN_PARAMETERS,
    CurrentCheck,
    PlanCheckInputs,
    Plans3,
    PlanVerdict,
    judge,
)
from autopilot.mission.plan_model import PlanFile
from autopilot.mission.validation import check_item, order_problem

__all__ = ["Change", "CurrentCheck", "Plans", "load_plan", "plan_checksum"]

CHECK_TICKS = 5
"""Ticks after which the result of a check is taken: 50 ms, which a plan of fifty polygons needs."""
MAX_ATTEMPTS = 10
"""Number of checks after which a change is refused whose parameters keep changing."""

Guard = Callable[[Sequence[PlanKind], PlanVerdict], PlanRejection | None]
"""Why plans of these kinds must not be taken now, None if they may."""

_ITEM = struct.Struct("<HBH4f2ifB")
"""Fields that identify an item, in the precision of the wire (MISSION_ITEM_INT)."""


def plan_checksum(items: tuple[PlanItem, ...]) -> int:
    """CRC-32 of a plan's content, 0 when it is empty; the same after a restart."""
    crc = 0
    for i in items:
        packed = _ITEM.pack(
            i.seq, i.frame, i.command, i.param1, i.param2, i.param3, i.param4, i.x, i.y, i.z, i.autocontinue
        )
        crc = zlib.crc32(packed, crc)
    return crc if not items else max(1, crc)


class Change(PlanChange):
    """Plans that are to replace those of the same kind."""

    def __init__(self, plans: Mapping[PlanKind, tuple[PlanItem, ...]]) -> None:
        self.plans = dict(plans)
        self.attempts = 0
        self._done = False
        self._rejection: PlanRejection | None = None

    @property
    def done(self) -> bool:
        return self._done

    @property
    def rejection(self) -> PlanRejection | None:
        """Why it was refused; None when it was taken, or is not done."""
        return self._rejection

    def end(self, rejection: PlanRejection | None) -> None:
        """Taken (None) or refused; the first word counts."""
        if not self._done:
            self._done, self._rejection = True, rejection

    def cancel(self) -> None:
        """Cancel the change: the plans in force stay, unless it was done before."""
        text = "another change came before this one was checked; send it again"
        self.end(PlanRejection(seq=None, result=MissionResult.OPERATION_CANCELLED, reason=text))


_limits: Callable[[Mapping[str, float]], tuple[float, ...]] = itemgetter(*PLAN_PARAMETERS)


class Plans(PlanStore):
    """Implements :class:`PlanStore`; also gives the plans in local metres. ``params`` is read live. :meth:`tick`
    has to be called once per tick when there is a background worker (``desk``).
    """

    def __init__(
        self,
        params: Mapping[str, float],
        radius_m: float,
        origin: Origin | None = None,
        current_check: CurrentCheck | None = None,
        worker: BackgroundWorker | None = None,
        goal_margin_m: Callable[[], float] | None = None,
    ) -> None:
        self._params = params
        self._live = params.live if isinstance(params, ParamSet) else params
        self._current_check = current_check
        self._radius_m = radius_m
        self._goal_margin_m = goal_margin_m or (lambda: params["MPC_MARGIN"])
        self.origin = origin or params_origin(params)
        """The local origin; its altitude is the water surface."""
        self.home_ned_m: FloatArray = np.zeros(3)
        """(3,) home, the origin until it is set."""
        self._home: GeodeticPosition | None = None
        self._plans: Plans3 = EMPTY
        self._sums: dict[PlanKind, tuple[tuple[PlanItem, ...], int]] = {}
        """Plans whose checksum is known."""
        self._worker = worker
        self._now = 0
        self._task: BackgroundTask[PlanVerdict] | None = None
        self._submitted: PlanCheckInputs | None = None
        self._change: Change | None = None
        self._wanted: PlanCheckInputs | None = None
        self._verdict = PlanVerdict(question=self._question())
        self.guard: Guard = lambda kinds, verdict: None
        """Called before plans proposed by :meth:`propose` are accepted."""
        self.order_check: Callable[[Order], str] = lambda order: ""
        """Why the vehicle has nothing that could carry out an order, "" when it has."""
        self.revision = 0
        """Grows by one whenever a plan or the origin changes."""
        self.watchdog: Callable[[], bool] | None = None
        """Callback: whether the plans in force are stored (or cannot be)."""

    @property
    def kept(self) -> bool:
        """Whether the plans in force are where they are kept, or known not to get there; always where none are."""
        return self.watchdog is None or self.watchdog()

    @property
    def home(self) -> GeodeticPosition:
        """Home in geodetic coordinates; the same object until home or origin change."""
        if self._home is None:
            lat, lon, alt = geodetic_from_ned(self.origin, self.home_ned_m)
            self._home = GeodeticPosition(lat_deg=lat, lon_deg=lon, alt_m=alt)
        return self._home

    def set_home(self, pos_ned_m: FloatArray) -> str:
        """Set home (3,). Returns the reason of a refusal."""
        away_m = float(np.hypot(pos_ned_m[0], pos_ned_m[1]))
        if not (away_m <= MAX_RANGE_M and np.isfinite(pos_ned_m).all()):
            return far_text(away_m)
        self.home_ned_m = np.array(pos_ned_m, dtype=np.float64)
        self._home = None
        return ""

    def items(self, kind: PlanKind) -> tuple[PlanItem, ...]:
        return self._plans[kind]

    def size_text(self) -> str:
        """Size of a mission that is far, for texts; "" for others."""
        return extent_of(self.steps(), self.home_ned_m).text

    def checksum(self, kind: PlanKind) -> int:
        """Opaque id of a plan (MAVLink mission protocol), 0 = empty."""
        items = self._plans[kind]
        known = self._sums.get(kind)
        if known is None or known[0] is not items:
            known = self._sums[kind] = items, plan_checksum(items)
        return known[1]

    @property
    def verdict(self) -> PlanVerdict:
        """Latest verdict on the plans in force: the same object until there is a new one."""
        if self._worker is None and not self._is_current():
            self._take(judge(self._question(), Cancel()))
        return self._verdict

    @property
    def problem(self) -> str:
        """Reason why the plans in force must not be flown, "" if they may; while :attr:`checking`, of the last
        check."""
        return self.verdict.problem

    @property
    def checking(self) -> bool:
        """Whether parameters or origin have changed and the plans are being checked against them."""
        return self._worker is not None and not self._is_current()

    @property
    def placed(self) -> bool:
        """Whether fence and mission in local metres are those of the origin in force."""
        return self.verdict.question.origin == self.origin

    def steps(self) -> tuple[Step, ...]:
        """The mission in local metres, one step per item; the same object until mission or origin change."""
        return self.verdict.steps

    def shapes(self) -> tuple[FenceShape, ...]:
        """Local frame [m]."""
        return self.verdict.shapes

    def fence(self) -> Fence:
        """Workspace in local metres with the depth band of the parameters; open water without a fence."""
        return build_fence(self.shapes(), self._params)

    def warnings(self) -> tuple[str, ...]:
        """Narrow gaps of the fence (FENCE_GAP_CHK 1), and warnings about the current there."""
        return self.verdict.warnings

    def check_item(self, kind: PlanKind, item: PlanItem) -> PlanRejection | None:
        """The cheap check of one item as it arrives."""
        rejection = check_item(kind, item, self.origin)
        if rejection is not None or kind is not PlanKind.MISSION:
            return rejection
        return order_problem(parse_step(item, self.origin), self.order_check)

    def propose(self, plans: Mapping[PlanKind, tuple[PlanItem, ...]]) -> Change:
        """Have plans checked and take all of them, or refuse and keep those in force. Replaces an open change."""
        if self._change is not None:
            self._change.cancel()
        change = self._change = Change(plans)
        if self._worker is None:
            self._decide(change, judge(self._question(change), Cancel()))
        else:
            self._submit_check()
        return change

    def replace(self, kind: PlanKind, items: tuple[PlanItem, ...]) -> PlanRejection | None:
        """Replace a plan at once, or refuse an invalid one: before the loop runs, and for studies."""
        self._drop()
        verdict = judge(self._question(Change({kind: items})), Cancel())
        refusal = verdict.refusal((kind,))
        if refusal is None:
            self._take(verdict)
        return refusal

    def set_origin(self, origin: Origin) -> PlanRejection | None:
        """Move the local origin. Refused when an item in force would not fit it. Home stays the same local point."""
        for kind in PlanKind:
            for item in self._plans[kind]:
                rejection = check_item(kind, item, origin)
                if rejection is not None:
                    return rejection
        self.origin = origin
        self._home = None
        return None

    def local_ned_m(self, lat_deg: float, lon_deg: float, alt_m: float) -> FloatArray:
        """A geodetic position in local metres (3,)."""
        return ned_from_geodetic(self.origin, lat_deg, lon_deg, alt_m)

    # Beside the loop

    def tick(self) -> None:
        """Once per tick: take a verdict that is ready, start a check after a change."""
        self._now += 1
        if self._worker is None:
            return
        if self._change is not None and self._change.done:
            self._drop()
        if self._task is not None:
            answer = self._task.poll(self._now)
            if answer is not None:
                self._task = None
                if answer.error is None:
                    self._take_verdict(answer.get())
                else:
                    self._take_verdict(_failed(self._submitted or self._question(self._change), answer.error))
        wanted = self._question(self._change)
        needed = self._change is not None or not wanted.same(self._verdict.question)
        if not needed or (self._task is not None and self._submitted is not None and wanted.same(self._submitted)):
            return
        if self._change is not None and self._change.attempts >= MAX_ATTEMPTS:
            text = "parameters or origin change faster than plans are checked; try again"
            self._change.end(PlanRejection(seq=None, result=MissionResult.ERROR, reason=text))
            self._drop()
        else:
            self._submit_check()

    def _submit_check(self) -> None:
        """Start a check of the intended plans, in place of a pending one."""
        assert self._worker is not None
        if self._task is not None:
            self._task.cancel()
        if self._change is not None:
            self._change.attempts += 1
        self._submitted = self._question(self._change)
        self._task = self._worker.submit(self._now + CHECK_TICKS, judge, self._submitted)

    def _take_verdict(self, verdict: PlanVerdict) -> None:
        """An answer: to the open change, or about the plans in force."""
        change = self._change
        if not verdict.question.same(self._question(change)):
            return
        if change is None:
            self._take(verdict)
        else:
            self._decide(change, verdict)

    def _decide(self, change: Change, verdict: PlanVerdict) -> None:
        """Accept a change, or refuse one that is invalid by itself or not permitted now."""
        self._change = None
        try:
            rejection = verdict.refusal(tuple(change.plans)) or self.guard(tuple(change.plans), verdict)
            if rejection is None:
                self._take(verdict)
        except Exception as error:
            # Callers that wait for the result must not wait for ever.
            text = f"the decision failed ({type(error).__name__}): send the plan again, and report this with the log"
            change.end(PlanRejection(seq=None, result=MissionResult.ERROR, reason=text))
            raise
        change.end(rejection)

    def _take(self, verdict: PlanVerdict) -> None:
        before, now = self._verdict.question, verdict.question
        moved = now.origin != before.origin
        changed = [kind for kind in PlanKind if now.plans[kind] is not before.plans[kind]]
        if moved or changed:
            self.revision += 1
        if not moved and PlanKind.MISSION not in changed:
            verdict = replace(verdict, steps=self._verdict.steps)
        if not moved and PlanKind.FENCE not in changed:
            verdict = replace(verdict, shapes=self._verdict.shapes)
        self._verdict, self._plans = verdict, now.plans
        self._wanted = now  # the question of the next ticks, if nothing else changes

    def close(self) -> None:
        """The end of a run: no answer is wanted any more."""
        self._drop()

    def _drop(self) -> None:
        if self._task is not None:
            self._task.cancel()
        if self._change is not None:
            self._change.cancel()
        self._task = self._submitted = self._change = None

    def _is_current(self) -> bool:
        return self._verdict.question.same(self._question())

    def _question(self, change: Change | None = None) -> PlanCheckInputs:
        """Inputs of the check; without a change the same object as before."""
        limits, goal_margin_m = _limits(self._live), self._goal_margin_m()
        known = self._wanted
        same_plans = known is not None and known.plans is self._plans and known.origin is self.origin
        same_limits = known is not None and known.limits == limits and known.goal_margin_m == goal_margin_m
        if change is None and known is not None and same_plans and same_limits:
            return known
        wanted = PlanCheckInputs(
            plans=self._plans if change is None else {**self._plans, **change.plans},
            origin=self.origin,
            limits=limits,
            radius_m=self._radius_m,
            goal_margin_m=goal_margin_m,
            current_check=self._current_check,
        )
        if change is None:
            self._wanted = wanted
        return wanted


def _failed(question: PlanCheckInputs, error: Exception) -> PlanVerdict:
    """Verdict after a fault of the check: flying is forbidden, and the plans checked are not accepted."""
    text = f"the plan check failed ({type(error).__name__}): send the plan again, and report this with the log"
    own = tuple(PlanProblem(kind=kind, seq=0, result=MissionResult.ERROR, reason=text) for kind in PlanKind)
    return PlanVerdict(question=question, own=own)


def load_plan(plans: Plans, plan: PlanFile, origin: str) -> str:
    """Take fence, mission and rally of a plan file, before the loop runs. The result is why they cannot be flown yet,
    "" if they can. PlanError with the reason when a plan is wrong by itself."""
    for kind, items in ((PlanKind.FENCE, plan.fence), (PlanKind.MISSION, plan.mission), (PlanKind.RALLY, plan.rally)):
        if items:
            rejection = plans.replace(kind, items)
            if rejection is not None:
                raise PlanError(f"{origin}: {kind.name.lower()}: {rejection.reason}")
    return plans.problem
