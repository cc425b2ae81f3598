"""Plans, origin, home and where the mission stands, on disk: a vehicle that comes up again has what it had.

The file is a line of JSON that names format, version and checksum, and a line of JSON with the content. What is read is
checked like an upload; what fails (damage, another version, a fence that the parameters of today forbid) leaves the
vehicle without any plan, because a mission is not to be flown without its fence. It always comes up disarmed and holds.
"""

import contextlib
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from autopilot.command.parts import Parts
from autopilot.core.clock import TICK_US
from autopilot.core.desk import Desk
from autopilot.core.disk import cause_of
from autopilot.core.errors import ConfigError, PlanError
from autopilot.core.frames import FloatArray
from autopilot.core.geodesy import Origin
from autopilot.core.keeper import Keeper
from autopilot.core.messages import Severity
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.core.state_file import StateFile
from autopilot.run.compose import load_plan
from mission.plan_files import PlanFile
from mission.sequencer import Position

FORMAT = "underwater-autopilot plans"
VERSION = 1
"""Of the content; one that differs is not read."""

_CLEAR_ORDER = (PlanKind.MISSION, PlanKind.FENCE, PlanKind.RALLY)

_Number = float | str
"""JSON has no NaN and no infinity: they stand as text."""


class _Head(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The first line."""

    format: str
    version: int
    crc32: int
    """Of the second line without its end."""


class _Item(msgspec.Struct, frozen=True, array_like=True):
    """A :class:`PlanItem`."""

    seq: int
    frame: int
    command: int
    params: tuple[_Number, _Number, _Number, _Number]
    x: int
    y: int
    z: _Number
    autocontinue: int


class _Place(msgspec.Struct, frozen=True, array_like=True):
    """An :class:`Origin`."""

    lat_deg: float
    lon_deg: float
    alt_m: float


class _Content(msgspec.Struct, frozen=True, kw_only=True):
    """The second line."""

    configured_origin: _Place
    """What the service came up with."""
    origin: _Place
    """In force when it was written."""
    home_ned_m: tuple[float, float, float]
    mission: tuple[_Item, ...]
    fence: tuple[_Item, ...]
    rally: tuple[_Item, ...]
    position: Position | None


def _text(value: float) -> _Number:
    return value if math.isfinite(value) else repr(value)


def _item(item: PlanItem) -> _Item:
    params = (_text(item.param1), _text(item.param2), _text(item.param3), _text(item.param4))
    return _Item(item.seq, item.frame, item.command, params, item.x, item.y, _text(item.z), item.autocontinue)


def _plan_item(item: _Item) -> PlanItem:
    param1, param2, param3, param4 = (float(value) for value in item.params)
    return PlanItem(
        seq=item.seq,
        frame=item.frame,
        command=item.command,
        param1=param1,
        param2=param2,
        param3=param3,
        param4=param4,
        x=item.x,
        y=item.y,
        z=float(item.z),
        autocontinue=item.autocontinue,
    )


def _place(origin: Origin) -> _Place:
    return _Place(origin.lat_deg, origin.lon_deg, origin.alt_m)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Snapshot:
    """What is to be written; nothing in it changes any more."""

    configured_origin: Origin
    origin: Origin
    home_ned_m: FloatArray
    items: Mapping[PlanKind, tuple[PlanItem, ...]]
    position: Position | None


def _encode(now: _Snapshot) -> bytes:
    north, east, down = now.home_ned_m.tolist()
    mission, fence, rally = (tuple(_item(item) for item in now.items[kind]) for kind in PlanKind)
    content = _Content(
        configured_origin=_place(now.configured_origin),
        origin=_place(now.origin),
        home_ned_m=(north, east, down),
        mission=mission,
        fence=fence,
        rally=rally,
        position=now.position,
    )
    body = msgspec.json.encode(content)
    return msgspec.json.encode(_Head(format=FORMAT, version=VERSION, crc32=zlib.crc32(body))) + b"\n" + body + b"\n"


def _decode(data: bytes) -> _Content:
    """ValueError, with the reason, for what is not such a file."""
    first, _, body = data.removesuffix(b"\n").partition(b"\n")
    try:
        head = msgspec.json.decode(first, type=_Head)
        if head.format != FORMAT:
            raise ValueError(f"is not a file of plans but {head.format!r}")
        if head.version != VERSION:
            raise ValueError(f"is of version {head.version}, this service reads {VERSION}")
        if head.crc32 != zlib.crc32(body):
            raise ValueError("is damaged (checksum)")
        return msgspec.json.decode(body, type=_Content)
    except msgspec.MsgspecError as error:
        raise ValueError(f"is damaged ({error})") from error


class KeptPlans:
    """Keeps the plans of one service. The writing goes over a desk."""

    def __init__(self, path: Path, parts: Parts, desk: Desk | None = None) -> None:
        """``desk``: the lane of the disk, by default the caller's own time."""
        self._file = StateFile(path)
        self._parts = parts
        self._keeper: Keeper[_Snapshot] = Keeper(desk or Desk(), lambda now: self._file.write(_encode(now)))
        self._configured = parts.plans.origin
        self._revision = parts.plans.revision
        self._home: FloatArray = parts.plans.home_ned_m
        self._origin = parts.plans.origin
        self._position = parts.commander.mission_position
        self._notices: list[tuple[Severity, str]] = []
        self.failure: str | None = None
        """Why the last change is not on disk; None while all is well."""

    def load(self) -> tuple[str, ...]:
        """Take what was kept, before the loop runs. The result is what an operator should know."""
        try:
            self._file.clean()
            content, problems = self._file.read(_decode)
        except OSError as error:
            return (f"{self._file.path}: cannot be read ({error.strerror}); there is no plan on board",)
        home_ned_m = self._parts.plans.home_ned_m
        self._note()
        if content is not None:
            try:
                problems += self._take(content)
                self._note()
            except (PlanError, ConfigError) as error:
                self._take_none(home_ned_m)
                problems.append(f"stored plans are not loaded{self._set_aside()}, upload them again: {error}")
        elif problems:
            problems.append("there is no plan on board, upload it again")
        return tuple(problems)

    def skip(self) -> None:
        """Other plans have been loaded: they are what is kept from now on."""
        with contextlib.suppress(OSError):  # the first write finds out, and says so
            self._file.clean()
        self._revision = -1

    def tick(self, t_us: int) -> None:
        """Have written what changed since the last tick; cheap when nothing did."""
        tick, plans = t_us // TICK_US, self._parts.plans
        position = self._parts.commander.mission_position
        same_places = plans.home_ned_m is self._home and plans.origin is self._origin
        if plans.revision != self._revision or not same_places or position != self._position:
            self._note()
            self._keeper.put(tick, self._snapshot())
        kept = self._keeper.poll(tick)
        if kept is None:
            return
        before, error = self.failure, kept.error
        self.failure = None if error is None else f"plans are not saved: {self._file.path}: {error}"
        if error is not None and before is None:
            self._notices.append((Severity.WARNING, f"Plans not saved: {cause_of(error)}"))

    def take_notices(self) -> Sequence[tuple[Severity, str]]:
        """What the operator should know since the last call."""
        if not self._notices:
            return ()
        notices, self._notices = self._notices, []
        return notices

    def finish(self) -> None:
        """Write what is not yet on disk."""
        error = self._keeper.finish()
        self.failure = None if error is None else f"plans are not saved: {self._file.path}: {error}"

    def _take_none(self, home_ned_m: FloatArray) -> None:
        """Back to what a service without stored plans has; that is what is kept from the first tick on."""
        plans = self._parts.plans
        for kind in _CLEAR_ORDER:
            plans.replace(kind, ())
        plans.set_origin(self._configured)
        self._parts.commander.restore_home(home_ned_m)
        self._revision = -1

    def _set_aside(self) -> str:
        """Keep the file that is not in force, so that nothing overwrites it; the words for it."""
        try:
            return f" (they are in {self._file.set_aside().name} now)"
        except OSError as error:
            return f" (they stay in {self._file.path.name}: {cause_of(error)})"

    def _note(self) -> None:
        plans = self._parts.plans
        self._revision, self._home, self._origin = plans.revision, plans.home_ned_m, plans.origin
        self._position = self._parts.commander.mission_position

    def _snapshot(self) -> _Snapshot:
        plans = self._parts.plans
        return _Snapshot(
            configured_origin=self._configured,
            origin=plans.origin,
            home_ned_m=plans.home_ned_m,
            items={kind: plans.items(kind) for kind in PlanKind},
            position=self._position,
        )

    def _take(self, content: _Content) -> list[str]:
        """PlanError or ConfigError when a plan cannot be in force."""
        plans, problems = self._parts.plans, []
        same_place = content.configured_origin == _place(self._configured)
        if same_place:
            origin = content.origin
            plans.set_origin(Origin(lat_deg=origin.lat_deg, lon_deg=origin.lon_deg, alt_m=origin.alt_m))
        else:
            problems.append("stored plans were made at another origin: home is set anew")
        mission, fence, rally = (
            tuple(_plan_item(item) for item in items) for items in (content.mission, content.fence, content.rally)
        )
        problem = load_plan(plans, PlanFile(mission=mission, fence=fence, rally=rally), str(self._file.path))
        if problem:
            problems.append(f"stored plans cannot be flown: {problem}")
        if same_place and all(math.isfinite(value) for value in content.home_ned_m):
            refusal = self._parts.commander.restore_home(np.array(content.home_ned_m))
            problems += [f"stored home is not taken, set it anew: {refusal}"] if refusal else []
        if content.position is not None and mission:
            self._parts.commander.stand_at(content.position)
        return problems
