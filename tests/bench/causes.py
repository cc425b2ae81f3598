"""What is said of what: causes, one at a time, and the first warning that each brings.

Causes that a picture alone shows are flown as a recorded flight over another floor or through another camera
(:mod:`tests.bench.laid_maps`): only the estimator hears them. All others are flights of the whole service with the
pose sensor (:mod:`tests.bench.sensor_faults`). Right is a first text with one of the words of its cause; where nothing
is wrong that anybody could mend, right is silence.
"""

import argparse
import dataclasses
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from autopilot.command.change_watch import DOUBT_TEXTS
from autopilot.command.command_tuning import WATCH
from autopilot.core.camera import CameraModel
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import NavDoubt
from autopilot.core.samples import LaserSample, PoseSample, Sample
from autopilot.estimator.create import create_estimator
from autopilot.sitl.floor import sheets_moved, sheets_of
from tests.bench.alarms import FLIGHTS, Quiet, fly_quietly
from tests.bench.fault_campaign import FAULTS
from tests.bench.laid_maps import SHEET_M, Camera, Recording, plan_with_errors, record
from tests.bench.sensor_faults import FaultFlight, fly_fault

Said = Sequence[tuple[float, str]]
"""Time after the cause began [s], text."""
AT_S, END_S = 10.0, 20.0
SEEN_OFTEN = 40
"""Pictures that show a marker which is to be found wrong."""
LEAST_RIGHT = 0.9
"""Share of the causes that must be named first: 27 of 30."""
HEALTHY_S = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    name: str
    right: tuple[str, ...]
    """Words of which the first text has one; none = nothing must be said."""
    fly: Callable[[int], Said]
    """By seed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CauseRow:
    cause: str
    first: str
    """"" = nothing was said."""
    after_s: float | None
    right: bool
    later: tuple[str, ...]


class Pictures:
    """A recorded flight and what pictures show of the floor in it."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.camera = Camera(recording)
        self.plan = dataclasses.replace(recording.plan, depth_sigma_m=0.0, scale_sigma=0.0)
        self.sheet = sheets_of(self.plan, SHEET_M)
        often = np.zeros(len(self.plan.ids), dtype=int)
        for t_us in self.camera.poses:
            often[self.camera.shown(self.plan, t_us)] += 1
        self.often = np.flatnonzero(often >= SEEN_OFTEN)

    def some(self, seed: int, count: int = 1) -> list[int]:
        """Markers that are seen often, on one sheet."""
        rng = np.random.default_rng((seed, 11))
        sheet = self.sheet[rng.choice(self.often)]
        mine = self.often[self.sheet[self.often] == sheet]
        return [int(j) for j in rng.choice(mine, count, replace=False)]

    def fly(
        self,
        floor: MarkerMap,
        known: MarkerMap,
        seed: int,
        *,
        lens: Mapping[str, Any] | None = None,
        late_us: int = 0,
        stray: Callable[[int], MarkerMap] | None = None,
    ) -> Said:
        """The flight over this floor by an estimator that knows another. ``lens``: keys of the true camera that are not
        the vehicle file's; ``late_us``: pictures are stamped so late; ``stray``: the floor at a time.
        """
        rng = np.random.default_rng((seed, 12))
        recording, camera = self.recording, self.camera
        if lens is not None:
            camera = Camera(recording, dataclasses.replace(CameraModel.of_vehicle(recording.vehicle), **lens))
        estimator = create_estimator("ekf", recording.vehicle, known, floor_depth_m=recording.floor_depth_m)
        said: dict[str, float] = {}
        doubted: dict[NavDoubt, float] = {}
        armed = False
        for t_us, samples, thrust_n in recording.ticks:
            given: list[Sample] = []
            for sample in samples:
                if isinstance(sample, PoseSample):
                    now = floor if stray is None else stray(sample.t_us)
                    made = camera.sighting(now, sample.t_us, rng)
                    if made is not None:
                        given.append(dataclasses.replace(made, t_us=made.t_us + late_us))
                elif not isinstance(sample, LaserSample):
                    given.append(sample)
            nav = estimator.step(t_us, given, thrust_n)
            estimator.take_aids()
            for text in estimator.take_remarks():
                said.setdefault(text, 1e-6 * t_us)
            armed = armed or bool(thrust_n.any())
            for doubt in nav.doubts if nav is not None and armed else ():
                doubted.setdefault(doubt, 1e-6 * t_us)
        # As the service says it: that fixes disagree is said late, and not if anything says why.
        fixes_s = doubted.pop(NavDoubt.FIXES, None)
        if fixes_s is not None:
            late_s = fixes_s + 1e-6 * WATCH.cause_us
            if not any(t_s <= late_s for t_s in doubted.values()):
                doubted[NavDoubt.FIXES] = late_s
        return [*((t_s, text) for text, t_s in said.items()), *((s, DOUBT_TEXTS[d]().text) for d, s in doubted.items())]


def _moved(floor: MarkerMap, markers: Sequence[int], north_m: float, east_m: float) -> MarkerMap:
    corners = floor.corners_ned_m.copy()
    corners[list(markers), :, :2] += (north_m, east_m)
    return dataclasses.replace(floor, corners_ned_m=corners)


def _sheet_off(p: Pictures, seed: int, shift_m: tuple[float, float], turn_rad: float) -> Said:
    sheet = int(p.sheet[p.some(seed)[0]])
    count = int(p.sheet.max()) + 1
    shift, turn = np.zeros((count, 3)), np.zeros(count)
    shift[sheet, :2], turn[sheet] = shift_m, turn_rad
    return p.fly(sheets_moved(p.plan, p.sheet, shift, turn), plan_with_errors(p.plan, (0.002, 0.006)), seed)


def _swapped(p: Pictures, seed: int) -> Said:
    pair = p.some(seed, 2)
    ids = p.plan.ids.copy()
    ids[pair] = ids[pair[::-1]]
    return p.fly(dataclasses.replace(p.plan, ids=ids), p.plan, seed)


def _unknown(p: Pictures, seed: int) -> Said:
    """A marker of the floor bears the id of another that lies elsewhere: the map has nothing of it here."""
    here, ids = p.some(seed)[0], p.plan.ids.copy()
    away = np.linalg.norm(p.plan.centers_ned_m - p.plan.centers_ned_m[here], axis=1)
    ids[here] = ids[int(away.argmax())]
    return p.fly(dataclasses.replace(p.plan, ids=ids), p.plan, seed)


def _carried(p: Pictures, seed: int) -> Said:
    """Another vehicle carries a marker through the pictures."""
    one = p.some(seed)[0]

    def at(t_us: int) -> MarkerMap:
        t_s = 1e-6 * t_us
        return _moved(p.plan, [one], 0.3 * math.sin(0.9 * t_s), 0.3 * math.cos(1.1 * t_s))

    return p.fly(p.plan, p.plan, seed, stray=at)


def picture_causes(p: Pictures) -> list[Cause]:
    """Those that only a picture shows."""
    plan, laid = p.plan, plan_with_errors(p.plan, (0.002, 0.006))
    model = CameraModel.of_vehicle(p.recording.vehicle)
    fx, fy = model.focal_px
    bent = tuple(0.7 * k for k in model.distortion)
    turn = model.r_frd_from_cam @ _about_x(0.079)

    def moved(off_m: float, known: MarkerMap) -> Callable[[int], Said]:
        return lambda seed: p.fly(_moved(plan, p.some(seed), 0.8 * off_m, 0.6 * off_m), known, seed)

    def lens(**keys: Any) -> Callable[[int], Said]:
        return lambda seed: p.fly(plan, plan, seed, lens=keys)

    marker = ("lies",)
    return [
        Cause(name="marker 30 mm off, exact map", right=marker, fly=moved(0.03, plan)),
        Cause(name="marker 15 mm off, exact map", right=marker, fly=moved(0.015, plan)),
        Cause(name="marker 30 mm off, hand-laid sheets", right=marker, fly=moved(0.03, laid)),
        Cause(name="ids swapped", right=("are swapped", "lies where the map has"), fly=partial(_swapped, p)),
        Cause(name="an id twice", right=marker, fly=partial(_unknown, p)),
        Cause(name="sheet turned 5 deg", right=("Sheet ",), fly=lambda s: _sheet_off(p, s, (0.0, 0.0), 0.087)),
        Cause(name="sheet 25 mm off", right=("Sheet ",), fly=lambda s: _sheet_off(p, s, (0.02, 0.015), 0.0)),
        Cause(name="marker carried by another vehicle", right=(), fly=partial(_carried, p)),
        Cause(name="focal length 3 % long", right=("Focal length",), fly=lens(focal_px=(1.03 * fx, 1.03 * fy))),
        Cause(name="distortion 30 % less", right=("distortion", "Focal length"), fly=lens(distortion=bent)),
        Cause(name="camera tilted 4.5 deg", right=("tilt differ",), fly=lens(r_frd_from_cam=turn)),
        Cause(
            name="pictures stamped 40 ms late", right=("stamps",), fly=lambda s: p.fly(plan, plan, s, late_us=40_000)
        ),
        Cause(name="nothing, exact map", right=(), fly=lambda s: p.fly(plan, plan, s)),
    ]


def _about_x(angle_rad: float) -> np.ndarray:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _flown(flight: FaultFlight, seed: int) -> Said:
    result = fly_fault(dataclasses.replace(flight, seed=seed))
    return list(zip(result.said_s, result.texts, strict=True))


def _fault(name: str, table: Mapping[str, Any], *right: str, **more: Any) -> Cause:
    flight = FaultFlight(**{"faults": (table,), "at_s": AT_S, "duration_s": END_S, **more})
    return Cause(name=name, right=right, fly=partial(_flown, flight))


def _world(name: str, changes: Mapping[str, Any], *right: str, scenario: str = "paper-tank") -> Cause:
    """A world that is so from the beginning."""
    flight = FaultFlight(at_s=0.1, duration_s=END_S, changes=changes, scenario=scenario)
    return Cause(name=name, right=right, fly=partial(_flown, flight))


_JUMP = ("Poses wrong", "Poses disagree", "poses rejected")
_LATE = {"vehicle": {"command_latency_s": 0.5}}
SERVICE_CAUSES = (
    *(
        _fault(name, FAULTS[name], "Accelerometer wrong")
        for name in ("accelerometer +1 m/s2 forward", "accelerometer z stuck", "wrong tilt 0.3 rad")
    ),
    *(_fault(name, FAULTS[name], "Gyro wrong") for name in ("gyro -0.3 rad/s", "gyro +3 rad/s", "gyro z stuck")),
    _fault("AHRS heading off by 0.1 rad", FAULTS["wrong heading 0.1 rad"]),
    _fault("AHRS frozen", {"kind": "ahrs_freeze"}, "AHRS silent", lasts_s=5.0),
    _fault("lens 0.9", FAULTS["lens 0.9"], "Laser and", at_s=0.1),
    _fault("mounting turned 0.1 rad", FAULTS["mounting turned 0.1 rad"], *_JUMP),
    _fault("markers moved by 0.3 m", FAULTS["markers moved by 0.3 m"], *_JUMP),
    _world("floor told 0.1 m deeper", {"markers": {"told_deeper_m": 0.1}}, "Laser and"),
    _fault("picture frozen", {"kind": "camera_near_frozen"}, *_JUMP),
    _fault("pictures 1 s late", {"kind": "camera_delayed", "delay_s": 1.0}, *_JUMP, "stamps"),
    _fault("pictures of another place", {"kind": "camera_elsewhere", "offset_m": [0.4, 0.4, 0.0]}, *_JUMP),
    _fault("no pictures", {"kind": "camera_blackout"}, "Dead reckoning", lasts_s=5.0),
    _fault("thruster lost", {"kind": "thruster_loss", "thruster": "port"}, "Thruster port"),
    _fault(
        "thruster half lost",
        {"kind": "thruster_loss", "thruster": "port", "loss": 0.5},
        "Thruster port",
        duration_s=40.0,
    ),
    _world("commands 0.5 s late", _LATE, "ommand latency"),
    _world("drag 1.3", {"vehicle": {"mismatch": {"drag": 1.3, "linear_drag": 1.3}}}),
    _world("current 0.2 m/s", {"current": {"kind": "uniform", "velocity_m_s": [0.17, 0.1, 0.0]}}),
    _world("buoyancy 1.05", {"vehicle": {"mismatch": {"buoyancy": 1.05}}}, "buoyant", "ighter", "trim"),
    _fault("held by a snag", {"kind": "snag"}, "stuck", duration_s=45.0),
    _fault("hit from the side", {"kind": "shove", "force_ned_n": [0.0, 150.0, 0.0]}, "collision", lasts_s=0.15),
    _fault("leak", {"kind": "leak"}, "water in the hull"),
    _fault("battery nearly empty", {"kind": "battery_sag", "remaining": 0.08}, "battery"),
    _fault("clock set", {"kind": "clock_jump", "jump_s": 30.0}, "lock jumped"),
    _fault("depth sensor frozen", {"kind": "sensor_frozen", "sensor": "depth"}, "depth sensor", scenario="pool"),
    _world("depth 0.3 m off", {"sensors": {"depth": {"bias_m": 0.3}}}, scenario="pool"),
    _world("altimeter multiples", {"sensors": {"altimeter": {"multiple_probability": 0.3}}}),
    _world("DVL off by 0.1 m/s", {"sensors": {"dvl": {"bias_m_s": 0.1}}}, "elocity log", scenario="pool"),
    _fault(
        "DVL silent",
        {"kind": "sensor_silence", "sensor": "dvl"},
        "elocity log",
        lasts_s=9.0,
        scenario="pool",
        changes={"sensors": {"dvl": {}}},
    ),
)


def judged(cause: Cause, said: Said) -> CauseRow:
    ordered = sorted(said, key=lambda each: each[0])
    after_s, first = ordered[0] if ordered else (None, "")
    right = any(word in first for word in cause.right) if cause.right else not first
    return CauseRow(
        cause=cause.name, first=first, after_s=after_s, right=right, later=tuple(text for _, text in ordered[1:])
    )


def bench_causes(seed: int, *, short: bool, only: str = "") -> Iterator[CauseRow]:
    """All causes; ``short``: every fourth; ``only``: with one of these in their name."""
    causes = (*picture_causes(Pictures(record(seed))), *SERVICE_CAUSES)
    chosen = [cause for cause in causes if any(word in cause.name for word in only.split(","))]
    for cause in chosen[:: 4 if short else 1]:
        yield judged(cause, cause.fly(seed))


def bench_healthy(seed: int, *, short: bool) -> Iterator[Quiet]:
    """Texts where nothing is wrong."""
    for scenario, vehicle in FLIGHTS[:: 8 if short else 1]:
        yield fly_quietly(scenario, vehicle, seed, HEALTHY_S)


def main() -> int:
    """Print both tables; 1 if too few causes are named first, or anything is said in a healthy flight."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="causes with one of these (a,b) in their name, no healthy flights")
    args = parser.parse_args()
    rows = []
    for row in bench_causes(args.seed, short=args.short, only=args.only):
        rows.append(row)
        after = "" if row.after_s is None else f"{row.after_s:5.1f} s"
        print(f"{row.cause:38s} {'right' if row.right else 'WRONG':5s} {after:7s} {row.first}", flush=True)
        print(*(f"{'':53s}then {text}\n" for text in row.later), sep="", end="", flush=True)
    right = sum(row.right for row in rows)
    print(f"right cause first: {right} of {len(rows)}")
    loud = 0
    for quiet in () if args.only else bench_healthy(args.seed, short=args.short):
        loud += len(quiet.alarms)
        print(f"{quiet.scenario} {quiet.vehicle}: {'; '.join(quiet.alarms) or 'quiet'}", flush=True)
    print(f"false texts in healthy flights: {loud}")
    return 0 if right >= LEAST_RIGHT * len(rows) and not loud else 1


if __name__ == "__main__":
    sys.exit(main())
