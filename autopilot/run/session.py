"""A run of the service on a vehicle, simulated or real: the loop with all that it is connected to, until its end."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from autopilot.command.parts import Parts
from autopilot.command.service import Autopilot
from autopilot.core.camera import CameraModel
from autopilot.core.clock import Clock
from autopilot.core.desk import Desk
from autopilot.core.errors import PlanError
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import Below, Inputs, Outputs, Severity
from autopilot.core.param_file import PersistentParams
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.links import open_link, parse_connection
from autopilot.drivers.protocols import Link
from autopilot.estimator.frame_filter import FrameFilter
from autopilot.estimator.vision import MarkerDetector
from autopilot.estimator.vision_lane import VisionWorker
from autopilot.mission.loading import load_plan
from autopilot.mission.plan_files import PlanFile, read_plan
from autopilot.run.allocator import give_back_large_blocks
from autopilot.run.clocks import make_clock
from autopilot.run.compose import end_slow_work
from autopilot.run.kept_plans import KeptPlans
from autopilot.run.outside import Onlooker, Peer, VehicleIo
from autopilot.run.recorder import NullRecorder, RunRecorder
from autopilot.run.runtime import Runtime
from autopilot.run.service_manager import ServiceManager
from autopilot.run.signing_files import SigningFiles
from autopilot.run.state_check import StateCheck
from autopilot.run.stills import StillStore

FASTEST = 20.0
"""How much faster than real time a run without pace may be: clients get that much more of the service's time."""

THREAD_SWITCH_S = 0.0005
"""Python's default of 5 ms would let a busy thread delay a tick by half its length."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Outside:
    """What a service is connected to. ``speed``: 1 on hardware, 0 = as fast as possible."""

    device: VehicleIo
    vision: VisionWorker | None
    links: Sequence[Link]
    peers: Sequence[Peer]
    recorder: RunRecorder | NullRecorder
    speed: float
    below: Callable[[int], Below | None] = lambda _: None
    """Who has the vehicle at a time, where there is a flight controller below."""
    notices: Callable[[], Sequence[tuple[Severity, str]]] = lambda: ()
    """What operators should know of the devices."""
    refusals: Callable[[int], tuple[str, ...]] = lambda _: ()
    """What they have against arming."""
    skips: bool = False
    """The world does not wait for a loop that is late."""
    clock: Clock | None = None
    """The loop's, None = one of that speed."""
    onlooker: Onlooker | None = None
    """Whoever looks on."""
    hold: Callable[[int], bool] = lambda _: False
    """Whether time stands still (a simulation only)."""
    stills: StillStore | None = None
    """Where stills are stored; None without a camera."""
    mishaps: Callable[[Inputs], Inputs] = lambda inputs: inputs
    """What befalls the machine (a simulation only)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Kept:
    """What outlives a run."""

    folder: Path
    """Where."""
    params: PersistentParams
    plans: KeptPlans | None
    """Where the plans are kept, None when they are not."""
    disk: Desk
    """The lane on which they write."""
    signing: SigningFiles | None = None
    """The signing key and its time."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Session:
    """A run that is ready to go."""

    vehicle: Vehicle
    service: Autopilot
    parts: Parts
    device: VehicleIo
    runtime: Runtime
    recorder: RunRecorder | NullRecorder
    kept: Kept
    warnings: tuple[str, ...]
    """What the operator should know of what was kept by earlier runs."""
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
        """What has to be done, the last first; whatever one of them raises, the others are done."""
        end.callback(end_slow_work, self.parts, self.kept.disk)
        if self.kept.plans is not None:
            end.callback(self.kept.plans.finish)
        end.callback(self.kept.params.finish)
        if self.kept.signing is not None:
            end.callback(self.kept.signing.finish)
            end.callback(self.parts.server.finish)
        end.callback(self.recorder.close)

    def _status(self) -> str:
        """One line for who asks the service manager."""
        commander = self.parts.commander
        return f"{self.vehicle.name}: {'armed' if commander.armed else 'disarmed'}, {commander.mode.name}"


def loop_round(
    service: Autopilot,
    parts: Parts,
    outside: Outside,
    kept: Kept,
    warnings: Sequence[str],
    on_tick: Callable[[Outputs], None],
) -> Runtime:
    """The loop round a service, ready to run. ``warnings`` are told to operators on the first tick."""
    sys.setswitchinterval(THREAD_SWITCH_S)
    give_back_large_blocks()
    plans, recorder = kept.plans, outside.recorder
    state = _state_check(parts, kept)
    news: list[tuple[Severity, str]] = [(Severity.WARNING, text) for text in warnings]

    def each_tick(outputs: Outputs) -> None:
        if plans is not None:
            plans.tick(outputs.t_us)
        on_tick(outputs)

    def notices() -> Sequence[tuple[Severity, str]]:
        kept_news = () if plans is None else plans.take_notices()
        told = (*news, *state.take_notices(), *recorder.take_notices(), *kept_news, *outside.notices())
        news.clear()
        return told

    runtime = Runtime(
        service,
        outside.device,
        outside.vision,
        outside.links,
        recorder,
        outside.clock or make_clock(outside.speed),
        peers=outside.peers,
        on_tick=each_tick,
        paced=outside.speed > 0.0,
        notices=notices,
        below=outside.below,
        refusals=lambda t_us: outside.refusals(t_us) + state.refusals(t_us),
        skips=outside.skips,
        onlooker=outside.onlooker,
        hold=outside.hold,
        stills=outside.stills,
        answers=parts.witness.take,
        mishaps=outside.mishaps,
    )
    for desk in (*parts.desks, kept.disk):
        desk.idle = runtime.attend
    return runtime


def _state_check(parts: Parts, kept: Kept) -> StateCheck:
    """What is missing of what was kept, or cannot be kept."""
    keepers = tuple(keeper for keeper in (kept.params, kept.plans, kept.signing) if keeper is not None)
    losses = [loss for keeper in keepers for loss in keeper.losses]
    unsaved = [partial(getattr, keeper, "unsaved") for keeper in keepers]
    return StateCheck(parts.params, kept.folder, kept.disk, losses, unsaved)


LINE_SHARE = 0.9
"""Of a serial line's rate that is used."""


def link_rates(connections: Sequence[str]) -> dict[int, float]:
    """Bytes per second of those that are serial lines: ten bits a byte, and a tenth left, so that a queue shrinks."""
    found = enumerate(map(parse_connection, connections))
    return {number: LINE_SHARE * line.number / 10.0 for number, line in found if line.kind == "serial"}


def take_plans(
    parts: Parts,
    plan: Path | None,
    kept: KeptPlans | None,
    *,
    flown_at_once: bool,
    finish: Callable[[PlanFile], tuple[PlanFile, tuple[str, ...]]] = lambda plan: (plan, ()),
) -> tuple[str, ...]:
    """The plan to have on board: of a file, else what was kept. The result is what an operator should know.

    ``finish``: what becomes of the file's plan before it is taken, and a word about that. PlanError if the file is no
    plan, or cannot be flown though it is to be ``flown_at_once``.
    """
    if plan is None:
        return () if kept is None else kept.load()
    finished, warnings = finish(read_plan(plan))
    problem = load_plan(parts.plans, finished, str(plan))
    if problem and flown_at_once:
        raise PlanError(f"{plan}: cannot be flown: {problem}; mend the plan, or start without --start")
    if problem:
        print(f"warning: {plan}: {problem}; the vehicle will not arm before that is mended", file=sys.stderr)
    if kept is not None:
        kept.skip()
    return warnings


@contextlib.contextmanager
def opened(device: VehicleIo, connections: Sequence[str], links: Sequence[Link] | None) -> Iterator[Sequence[Link]]:
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


def marker_vision(vehicle: Vehicle, markers: MarkerMap | None, *, paced: bool) -> VisionWorker | None:
    """Detection beside the loop, None when there are no pictures."""
    if markers is None:
        return None
    camera = vehicle.eye
    detector = MarkerDetector(CameraModel.of(camera, vehicle.laser), markers)
    frame_filter = FrameFilter(camera.width_px, camera.height_px)
    return VisionWorker(detector, delay_s=0.5 * camera.latency_s, frame_filter=frame_filter, paced=paced)
