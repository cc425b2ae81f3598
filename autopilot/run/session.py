"""A run of the service on a simulated or real vehicle: the loop and all its connections, from start to end."""

import contextlib
import ctypes
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any, TypedDict, TypeVar

from autopilot.command.service import Autopilot
from autopilot.command.service_parts import ServiceParts
from autopilot.control.protocol import Controller
from autopilot.core import operator_messages as notices
from autopilot.core.background import BackgroundWorker
from autopilot.core.camera import CameraModel
from autopilot.core.daemon_executor import DaemonExecutor
from autopilot.core.errors import PlanError
from autopilot.core.messages import Outputs, Severity
from autopilot.core.param_file import PersistentParams
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.links import open_link, parse_connection
from autopilot.drivers.protocols import Link
from autopilot.estimator.frame_filter import FrameFilter
from autopilot.estimator.vision import MarkerDetector
from autopilot.estimator.vision_worker import VisionWorker
from autopilot.log.directory_reader import LogDirectoryReader
from autopilot.mission.plan_files import read_plan
from autopilot.mission.store import load_plan
from autopilot.run.clocks import LockstepClock, PacedClock, make_clock
from autopilot.run.compose import KnownEnvironment, ServiceSetup, build_service, end_slow_work
from autopilot.run.config import EffectiveSettings, chosen_part
from autopilot.run.kept_plans import KeptPlans
from autopilot.run.outside import Onlooker, Onlookers, VehicleIo
from autopilot.run.recorder import NullRecorder, RunRecorder
from autopilot.run.runtime import Runtime
from autopilot.run.service_manager import ServiceManager
from autopilot.run.session_log import open_recorder
from autopilot.run.signing_files import SigningFiles
from autopilot.run.state_check import StateCheck
from autopilot.run.still_files import StillStore
from autopilot.run.world import World
from autopilot.view.foxglove import FoxgloveServer
from autopilot.view.hub import Hub

FASTEST = 20.0
"""How much faster than real time a run without pace may be: clients get that much more of the service's time."""

THREAD_SWITCH_S = 0.0005
"""Python's default of 5 ms would let a busy thread delay a tick by half its length."""
LARGE_BYTES = 1 << 20
"""Blocks from here on are mappings of their own; a mapping costs some microseconds."""

KEPT_BYTES = 16 << 20
"""Trim threshold of a heap. IPOPT allocates and frees some megabytes hundreds of times in a plan; each time the
system would have to clear their pages again, a sixth of the plan's time."""

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""mallopt's, of glibc's malloc.h."""


def give_back_large_blocks() -> None:
    """For the whole process, from now on. Nothing happens where the C library is another one.

    glibc raises its mmap threshold dynamically: after a block of some megabytes has been freed once, such blocks are
    taken from a heap, one per thread. There long-lived small blocks lie behind freed large ones, and the heaps are
    never returned: a process that holds 40 MB grows to 600 MB. With a fixed threshold a large block is a mapping of its
    own, and is returned when it is freed; so is the top of a heap beyond the trim threshold."""
    library = ctypes.CDLL(None)
    if hasattr(library, "gnu_get_libc_version"):
        library.mallopt(_M_MMAP_THRESHOLD, LARGE_BYTES)
        library.mallopt(_M_TRIM_THRESHOLD, KEPT_BYTES)
        library.malloc_trim(0)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PersistentState:
    """State that is kept from run to run."""

    folder: Path
    """Where."""
    params: PersistentParams
    plans: KeptPlans | None
    """Where the plans are kept, None when they are not."""
    disk: BackgroundWorker
    """The lane on which they write."""
    signing: SigningFiles | None = None
    """The signing key and its time."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Session:
    world: World
    vehicle: Vehicle
    service: Autopilot
    parts: ServiceParts
    device: VehicleIo
    runtime: Runtime
    recorder: RunRecorder | NullRecorder
    kept: PersistentState
    warnings: tuple[str, ...]
    """Messages to the operator about files of earlier runs."""
    duration_s: float | None

    def run(self, stop: Callable[[], bool] = lambda: False) -> float:
        """Run to the end; the result is the wall time it took [s]."""
        begin_s = time.monotonic()
        manager = ServiceManager()

        def stops() -> bool:
            manager.tick(self._status)
            return stop()

        with contextlib.ExitStack() as end:
            end.callback(manager.close)
            self._at_the_end(end)
            end.callback(manager.stopping)
            self.runtime.run(duration_s=self.duration_s, stop=stops)
        return time.monotonic() - begin_s

    def close(self) -> None:
        """End a session that is not run: its device, links, threads and log (:meth:`run` does that itself)."""
        with contextlib.ExitStack() as end:
            self._at_the_end(end)
            end.callback(self.runtime.close)

    def _at_the_end(self, end: contextlib.ExitStack) -> None:
        """Cleanup in reverse order; an exception in one does not skip the others."""
        end.callback(end_slow_work, self.parts, self.kept.disk)
        if self.kept.plans is not None:
            end.callback(self.kept.plans.finish)
        end.callback(self.kept.params.finish)
        if self.kept.signing is not None:
            end.callback(self.kept.signing.finish)
            end.callback(self.parts.server.finish)
        end.callback(self.recorder.close)

    def _status(self) -> str:
        commander = self.parts.commander
        return f"{self.vehicle.name}: {'armed' if commander.armed else 'disarmed'}, {commander.mode.name}"


SomeSession = TypeVar("SomeSession", bound=Session)


class SessionOptions(TypedDict, total=False):
    log: bool
    links: Sequence[Link] | None
    """The connections of the settings if they are already open (:mod:`autopilot.run.boot_links`)."""
    on_tick: Callable[[Outputs], None]
    view: Hub | None
    """Live view, which may intervene in a simulation."""
    foxglove: FoxgloveServer | None
    """Server that publishes the logged messages."""
    now_s: float | None
    """Unix time at which signatures begin, None = the machine's."""
    beside: Onlooker | None
    """Observer in place of ``view`` and ``foxglove``."""
    around: Callable[[Controller], Controller] | None
    """Puts something round the controller."""


def open_session(
    kind: type[SomeSession],
    world: World,
    *,
    instance: int,
    log: bool = True,
    links: Sequence[Link] | None = None,
    on_tick: Callable[[Outputs], None] = lambda _: None,
    view: Hub | None = None,
    foxglove: FoxgloveServer | None = None,
    now_s: float | None = None,
    beside: Onlooker | None = None,
    around: Callable[[Controller], Controller] | None = None,
) -> SomeSession:
    """Open all parts of a run.

    Parameters
    ----------
    kind
        Class of the session.
    world
        Vehicle or simulation with its environment.
    instance
        Number of the vehicle on this machine, from 0.
    log, links, on_tick, view, foxglove, now_s, beside, around
        See :class:`SessionOptions`.

    Raises
    ------
    ConfigError, PlanError, DriverError, LogError
        The message names the problem; nothing is left running.
    """
    settings, known, disk = world.settings, world.known, world.disk
    signing = SigningFiles(world.folder, disk, now_s=now_s)
    setup = _service_setup(world, instance, signing)
    service, parts = build_service(setup, around=around)
    plans = None
    if world.keeps_plans:
        plans = KeptPlans(world.folder / "plans.json", parts.plans, parts.commander, disk, parts.nondeterminism)
    warnings = (*world.warnings, *signing.warnings, *_take_plans(parts, world, plans))
    world.open_device(parts)
    with _opened(world.device, settings["connect"], links) as open_links:
        recorder = open_recorder(world, setup, parts) if log else NullRecorder()
    clock = make_clock(world.speed)
    kept = PersistentState(folder=world.folder, params=world.persistent, plans=plans, disk=disk, signing=signing)
    state = _state_check(parts, kept)
    news: list[tuple[Severity, str]] = [notices.START_WARNING(text=text) for text in warnings]

    def each_tick(outputs: Outputs) -> None:
        if plans is not None:
            plans.tick(outputs.t_us)
        on_tick(outputs)

    def start_notices() -> Sequence[tuple[Severity, str]]:
        kept_news = () if plans is None else plans.take_notices()
        texts = (*news, *state.take_notices(), *recorder.take_notices(), *kept_news, *world.notices())
        news.clear()
        return texts

    sys.setswitchinterval(THREAD_SWITCH_S)
    give_back_large_blocks()
    runtime = Runtime(
        service,
        world.device,
        _marker_vision(known, paced=world.speed > 0.0),
        open_links,
        recorder,
        clock,
        peers=world.peers,
        on_tick=each_tick,
        paced=world.speed > 0.0,
        notices=start_notices,
        below=world.below,
        refusals=lambda t_us: world.refusals(t_us) + state.refusals(t_us),
        skips=world.skips,
        onlooker=beside or _onlooker(world, parts, clock, view, foxglove),
        hold=world.hold,
        stills=StillStore(recorder, disk, Path(settings["log_dir"])) if known.pictures else None,
        answers=parts.nondeterminism.take,
        mishaps=world.mishaps,
    )
    for worker in (*parts.workers, disk):
        worker.idle = runtime.attend
    return kind(
        world=world,
        vehicle=known.vehicle,
        service=service,
        parts=parts,
        device=world.device,
        runtime=runtime,
        recorder=recorder,
        kept=kept,
        warnings=warnings,
        duration_s=world.duration_s,
    )


def _service_setup(world: World, instance: int, signing: SigningFiles) -> ServiceSetup:
    """Setup of the service for that vehicle and site."""
    settings, known, speed = world.settings, world.known, world.speed
    controller, controller_by = chosen_part(settings, "controller", known.controller)
    estimator, estimator_by = chosen_part(settings, "estimator", known.estimator)
    given: dict[str, Any] = {field.name: getattr(known, field.name) for field in fields(known)}
    return ServiceSetup(
        **{**given, "estimator": estimator, "controller": controller},
        params=world.params,
        estimator_asked_by=estimator_by,
        controller_asked_by=controller_by,
        profile=settings["profile"],
        instance=instance,
        links=len(settings["connect"]) + len(world.peers),
        patience=FASTEST if speed == 0.0 else max(1.0, speed),
        waits_for_plans=speed == 0.0,
        saving=world.persistent,
        signing=signing,
        log_directory=open_log_directory(settings, blocking=speed == 0.0),
        rates=link_rates(settings["connect"]),
    )


def _onlooker(
    world: World,
    parts: ServiceParts,
    clock: PacedClock | LockstepClock,
    view: Hub | None,
    foxglove: FoxgloveServer | None,
) -> Onlooker | None:
    """The loop's ends of the live view and of other viewers, None without any."""
    known, watched = world.known, world.watched(parts)
    found: list[Onlooker] = []
    if view is not None:
        found.append(
            view.attach(
                watched, known.vehicle, world.controls(clock), simulated=world.simulated, pictures=known.pictures
            )
        )
    if foxglove is not None:
        found.append(foxglove.attach(watched.describe, watched.revision, world.truth))
    return Onlookers(*found) if found else None


def _state_check(parts: ServiceParts, kept: PersistentState) -> StateCheck:
    """Check for missing or unwritable state files."""
    keepers = tuple(watchdog for watchdog in (kept.params, kept.plans, kept.signing) if watchdog is not None)
    losses = [loss for watchdog in keepers for loss in watchdog.losses]
    unsaved = [partial(getattr, watchdog, "unsaved") for watchdog in keepers]
    return StateCheck(parts.params, kept.folder, kept.disk, losses, unsaved)


LINE_SHARE = 0.9
"""Of a serial line's rate that is used."""


def link_rates(connections: Sequence[str]) -> dict[int, float]:
    """Bytes per second of those that are serial lines: ten bits a byte, and a tenth left, so that a queue shrinks."""
    found = enumerate(map(parse_connection, connections))
    return {number: LINE_SHARE * line.number / 10.0 for number, line in found if line.kind == "serial"}


def _take_plans(parts: ServiceParts, world: World, kept: KeptPlans | None) -> tuple[str, ...]:
    """Load the initial plan: from a file, else the stored one. Returns a message to the operator. PlanError if the
    file is invalid, or cannot be flown though it is to be flown at once.
    """
    plan = world.plan
    if plan is None:
        return () if kept is None else kept.load()
    finished, warnings = world.finish_plan(read_plan(plan))
    problem = load_plan(parts.plans, finished, str(plan))
    if problem and world.flown_at_once:
        raise PlanError(f"{plan}: cannot be flown: {problem}; mend the plan, or start without --start")
    if problem:
        print(f"warning: {plan}: {problem}; the vehicle will not arm until it is fixed", file=sys.stderr)
    if kept is not None:
        kept.skip()
    return warnings


@contextlib.contextmanager
def _opened(device: VehicleIo, connections: Sequence[str], links: Sequence[Link] | None) -> Iterator[Sequence[Link]]:
    """The ``connections`` as links, or those ``links`` that are open already; an error in here closes them and the
    device."""
    found: list[Link] = [] if links is None else list(links)
    try:
        if links is None:
            found.extend(open_link(connection) for connection in connections)
        yield found
    except BaseException:
        device.close()
        for link in found:
            link.close()
        raise


def _marker_vision(known: KnownEnvironment, *, paced: bool) -> VisionWorker | None:
    """Detection beside the loop, None when there are no pictures."""
    if known.markers is None:
        return None
    camera = known.vehicle.eye
    detector = MarkerDetector(CameraModel.of(camera, known.vehicle.laser), known.markers, quick=True)
    frame_filter = FrameFilter(camera.width_px, camera.height_px)
    return VisionWorker(detector, delay_s=0.5 * camera.latency_s, frame_filter=frame_filter, paced=paced)


def open_log_directory(settings: EffectiveSettings, *, blocking: bool) -> LogDirectoryReader:
    """Log directory of a run. ``patient``: in lockstep the loop waits for the disk."""
    single = None if settings["log"] is None else Path(settings["log"])
    return LogDirectoryReader(
        Path(settings["log_dir"]), BackgroundWorker(DaemonExecutor("files"), blocking=blocking), single
    )
