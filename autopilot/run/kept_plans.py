"""Stored plans, origin, home and mission progress, restored at the next start.

Stored plans are checked like an upload; a failed check (damage, another version, a fence that the parameters
forbid) leaves the vehicle without any plan, because a mission must not be flown without its fence. The vehicle
always starts disarmed and in hold. File format: :mod:`autopilot.run.plans_format`.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from autopilot.core import operator_messages as notices
from autopilot.core.background import BackgroundWorker
from autopilot.core.clock import TICK_US
from autopilot.core.disk import cause_of
from autopilot.core.errors import ConfigError, PlanError
from autopilot.core.frames import FloatArray
from autopilot.core.geodesy import Origin
from autopilot.core.latest_value_writer import LatestValueWriter
from autopilot.core.nondeterminism import NondeterminismRecorder, NondeterminismSource
from autopilot.core.notice_queue import NoticeQueue
from autopilot.core.plan import PlanKind
from autopilot.core.state_file import Loss, StateFile
from autopilot.mavlink.missions import CLEAR_ORDER
from autopilot.mission.plan_model import PlanFile
from autopilot.mission.sequencer import Position
from autopilot.mission.store import Plans, load_plan
from autopilot.run.plans_format import Content, PlansSnapshot, decode, encode, place_of, plan_item

PLANS_KEPT = "plans kept"
"""Key of the recorded result: whether the plans in force are on disk."""

_NOT_LOADED = "stored mission, fence and rally points not loaded"


class Restored(Protocol):
    """Notified of restored plans, and source of the mission progress: the commander."""

    @property
    def mission_position(self) -> Position | None:
        """Mission progress, None when there is nothing to resume."""
        ...

    def restore_home(self, pos_ned_m: FloatArray) -> str:
        """Restore home (3,). Returns the reason if it is rejected, else ""."""
        ...

    def stand_at(self, position: Position) -> None:
        """Restore the mission progress. PlanError if there is no such item."""
        ...


class KeptPlans(NoticeQueue):
    """Stores the plans of one service through a background worker."""

    def __init__(
        self,
        path: Path,
        plans: Plans,
        vehicle: Restored,
        worker: BackgroundWorker | None = None,
        nondeterminism: NondeterminismSource | None = None,
    ) -> None:
        """``desk``: worker for disk access, by default synchronous; ``witness``: recorder of results that are
        still pending.
        """
        super().__init__()
        seen: NondeterminismSource = NondeterminismRecorder() if nondeterminism is None else nondeterminism
        self._file = StateFile(path)
        self._plans = plans
        self._vehicle = vehicle
        self._worker = worker or BackgroundWorker()
        self._watchdog: LatestValueWriter[PlansSnapshot] = LatestValueWriter(
            self._worker, lambda now: self._file.write(encode(now))
        )
        self._configured = plans.origin
        self._revision = plans.revision
        self._home: FloatArray = plans.home_ned_m
        self._origin = plans.origin
        self._position = vehicle.mission_position
        self.failure: str | None = None
        """Why the last change is not on disk; None while all is well."""
        self.unsaved = ""
        """The same for the operator, "" while all is well."""
        self.losses: tuple[Loss, ...] = ()
        """Stored data that :meth:`load` could not restore."""
        plans.watchdog = lambda: seen.observe(PLANS_KEPT, True, self._settled)

    def load(self) -> tuple[str, ...]:
        """Restore the stored plans before the loop runs. Returns a message to the operator."""
        self._file.clean()
        content, problems = self._file.read(decode)
        loss_text = ""
        if problems:
            loss_text = "stored plans damaged, the copy before is in force"
        elif self._file.lost:
            loss_text = "stored plans were damaged or refused in an earlier run"
        home_ned_m = self._plans.home_ned_m
        self._note()
        if content is not None:
            try:
                problems += self._take(content)
                self._note()
            except (PlanError, ConfigError) as error:
                self._take_none(home_ned_m)
                problems.append(f"stored plans are not loaded{self._set_aside()}, upload them again: {error}")
                loss_text = _NOT_LOADED
        elif problems:
            problems.append("there is no plan on board, upload it again")
            loss_text = _NOT_LOADED
        self.losses = (Loss(loss_text, lambda tick: self._worker.run(self._file.accept)),) if loss_text else ()
        return tuple(problems)

    def skip(self) -> None:
        """Other plans have been loaded: store these from now on."""
        self._file.clean()
        self._revision = -1

    def tick(self, t_us: int) -> None:
        """Store changes since the last tick; cheap without any."""
        tick, plans = t_us // TICK_US, self._plans
        position = self._vehicle.mission_position
        same_places = plans.home_ned_m is self._home and plans.origin is self._origin
        if plans.revision != self._revision or not same_places or position != self._position:
            self._note()
            self._watchdog.put(tick, self._snapshot())
        kept = self._watchdog.poll(tick)
        if kept is None:
            return
        before, error = self.failure, kept.error
        self._note_failure(error)
        if error is not None and before is None:
            self._notices.append(notices.PLANS_NOT_SAVED(cause=cause_of(error)))

    def finish(self) -> None:
        self._note_failure(self._watchdog.finish())

    def _note_failure(self, error: Exception | None) -> None:
        self.failure = None if error is None else f"plans are not saved: {self._file.path}: {error}"
        self.unsaved = "" if error is None else f"plans not saved ({cause_of(error)})"

    def _settled(self) -> bool:
        """Whether the plans in force are on disk, or the disk has rejected them."""
        return self._plans.revision == self._revision and not self._watchdog.busy

    def _take_none(self, home_ned_m: FloatArray) -> None:
        """Reset to no plans, which is stored from the first tick on."""
        plans = self._plans
        for kind in CLEAR_ORDER:
            plans.replace(kind, ())
        plans.set_origin(self._configured)
        self._vehicle.restore_home(home_ned_m)
        self._revision = -1

    def _set_aside(self) -> str:
        """Keep the file that is not in force, so that nothing overwrites it; the words for it."""
        try:
            return f" (they are in {self._file.set_aside().name} now)"
        except OSError as error:
            return f" (they stay in {self._file.path.name}: {cause_of(error)})"

    def _note(self) -> None:
        plans = self._plans
        self._revision, self._home, self._origin = plans.revision, plans.home_ned_m, plans.origin
        self._position = self._vehicle.mission_position

    def _snapshot(self) -> PlansSnapshot:
        plans = self._plans
        return PlansSnapshot(
            configured_origin=self._configured,
            origin=plans.origin,
            home_ned_m=plans.home_ned_m,
            items={kind: plans.items(kind) for kind in PlanKind},
            position=self._position,
        )

    def _take(self, content: Content) -> list[str]:
        """PlanError or ConfigError when a plan cannot be in force."""
        plans, problems = self._plans, []
        same_place = content.configured_origin == place_of(self._configured)
        if same_place:
            origin = content.origin
            plans.set_origin(Origin(lat_deg=origin.lat_deg, lon_deg=origin.lon_deg, alt_m=origin.alt_m))
        else:
            problems.append(
                "stored plans were made at another origin: home is set anew, no region of interest is faced"
            )
        mission, fence, rally = (
            tuple(plan_item(item) for item in items) for items in (content.mission, content.fence, content.rally)
        )
        problem = load_plan(plans, PlanFile(mission=mission, fence=fence, rally=rally), str(self._file.path))
        if problem:
            problems.append(f"stored plans cannot be flown: {problem}")
        if same_place and all(math.isfinite(value) for value in content.home_ned_m):
            refusal = self._vehicle.restore_home(np.array(content.home_ned_m))
            problems += [f"stored home is not taken, set it anew: {refusal}"] if refusal else []
        position = content.position
        if position is not None and mission:
            self._vehicle.stand_at(position if same_place else replace(position, facing_ned_m=None))
        return problems
