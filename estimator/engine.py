"""The estimator around a filter core: takes samples in, keeps history, gates, watches over the sensors, reports.

The filter lives on the time axis of the AHRS: every good AHRS sample makes a node. Measurements go to the node at or
before their time of validity, and the nodes after it are computed again. What is told to the vehicle is the newest node
carried on to now.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import AhrsSample, AidStatus, LaserSample, MarkerSighting, NavState, PoseSample, Sample
from autopilot.core.vehicle import Vehicle
from estimator.aiding import Aid
from estimator.core import FilterCore
from estimator.history import History, Node
from estimator.inertial import AhrsDoor, Inertial, Mode, level, made_up, step_between
from estimator.intake import AidingSample, Intake
from estimator.markers_pose import MarkerSolver
from estimator.measure_heading import heading_of
from estimator.measure_laser import LaserRange, range_from_sample
from estimator.measure_model import added_share, expected_acceleration, model_aid_of
from estimator.measure_pose import PoseFix, fix_from_sample
from estimator.measurement import Measurement, Moment
from estimator.options import DEFAULT_OPTIONS, EstimatorOptions
from estimator.output import judge_health, nav_state
from estimator.relocation import Relocation
from estimator.startup import StartUp
from estimator.states import YAW, initial_state
from estimator.thrust import ThrustLag
from estimator.tilt import TiltTrim

HEADING_EVERY = 20
"""AHRS samples per heading measurement: 5 Hz, its errors are slow."""
MODEL_EVERY = 5
"""AHRS samples per look at the vehicle model: 20 Hz."""
AHRS_WAIT_US = 60_000
"""After so long without AHRS data the filter goes on without."""
IDLE_THRUST_N = 0.3
IDLE_SPEED_M_S = 0.03
"""Below both the vehicle may be moored, held or aground: the model has nothing to say."""
BLIND_STEP_US = 20_000
BLIND_STEPS_MAX = 500
"""At most so many steps without AHRS data per tick; they get longer when the gap is longer."""
BLIND_TILT_DECAY = 0.99
"""Per blind step: roll and pitch fade to level within 2 s."""
COAST_AFTER_US = 300_000
"""Time without vision after which the current is held."""
LOST_AFTER = 3
"""Sightings in a row that do not fit the predicted pose before the whole floor is searched."""
RELOCATED_VARIANCE = 1e-3
"""Added to the variance of the fix that a reset goes to (m^2, rad^2): it has been carried on to now."""


class Engine:
    """:class:`estimator.protocol.Estimator` on a filter core."""

    def __init__(
        self,
        core: FilterCore,
        vehicle: Vehicle,
        markers: MarkerMap | None,
        floor_depth_m: float | None,
        options: EstimatorOptions = DEFAULT_OPTIONS,
    ) -> None:
        self._core = core
        self._options = options
        self._model = vehicle.model4.to_model()
        self._follow = added_share(vehicle)
        self._laser_mount_frd_m = vehicle.laser.position_frd_m
        self._floor_depth_m = floor_depth_m
        self._solver = None if markers is None else MarkerSolver(CameraModel.of(vehicle.camera, vehicle.laser), markers)
        self._door = AhrsDoor()
        self._thrust = ThrustLag(vehicle.drive.time_constant_s, vehicle.drive.limit_n)
        self._markers, self._laser = Aid("markers"), Aid("laser")
        self._heading, self._aid_model = Aid("heading"), Aid("model")
        self._intake = Intake({PoseSample: self._markers, MarkerSighting: self._markers, LaserSample: self._laser})
        self._startup = StartUp()
        self._trim = TiltTrim()
        self._relocation = Relocation()
        self._history: History | None = None
        self._recent: deque[Inertial] = deque(maxlen=128)
        self._statuses: list[AidStatus] = []
        self._now_us = -1
        self._last: NavState | None = None
        self._samples_since = 0
        self._unfit_in_row = 0
        self._counts = {"resets": 0, "clock.backwards": 0, "ahrs.blind_steps": 0}

    def step(self, t_us: int, samples: Sequence[Sample], thrust_n: FloatArray) -> NavState | None:
        """See :class:`estimator.protocol.Estimator`."""
        if t_us <= self._now_us:
            self._counts["clock.backwards"] += 1
            return self._last
        self._now_us = t_us
        self._thrust.advance(t_us, thrust_n)
        self._take_in(samples)
        if self._history is not None:
            self._go_blind(self._history)
        elif self._recent:
            self._try_start(self._recent[-1].t_us)
        if self._history is None:
            return None
        self._fuse_due(self._history)
        newest = self._history.newest
        health = judge_health(newest, self._core, self._fix_age_us(t_us), self._options)
        self._last = nav_state(self._core, newest, t_us, health, self._counts["resets"])
        return self._last

    def take_aids(self) -> tuple[AidStatus, ...]:
        """See :class:`estimator.protocol.Estimator`."""
        result = tuple(self._statuses)
        self._statuses.clear()
        return result

    def counters(self) -> Mapping[str, int]:
        """See :class:`estimator.protocol.Estimator`."""
        result = dict(self._counts)
        result.update({f"ahrs.{verdict.value}": count for verdict, count in self._door.counts.items()})
        result["thrust.malformed"] = self._thrust.malformed
        for aid in (self._markers, self._laser, self._heading, self._aid_model):
            result.update(aid.named_counts())
        return result

    # Samples in.

    def _take_in(self, samples: Sequence[Sample]) -> None:
        ahrs = [s for s in samples if isinstance(s, AhrsSample)]
        if len(ahrs) > 1:
            ahrs.sort(key=lambda s: s.t_us)
        for sample in ahrs:
            newest_us = self._recent[-1].t_us if self._recent else -1
            if self._door.let_in(sample, self._now_us, newest_us):
                inertial = level(sample, self._trim.at(sample))
                self._recent.append(inertial)
                if self._history is not None:
                    self._advance(self._history, inertial)
        for other in samples:
            if isinstance(other, PoseSample | MarkerSighting | LaserSample):
                self._intake.admit(other, self._now_us)

    def _advance(self, history: History, inertial: Inertial) -> None:
        """One node more, with the measurements that every so many AHRS samples bring."""
        newest = history.newest
        moment = Moment(inertial, self._thrust.at(inertial.t_us))
        idle = not self._options.model_aid or _idle(moment, newest.state.x)
        mode = Mode.NOMINAL
        if not inertial.real:
            mode = Mode.BLIND
        elif idle or self._fix_age_us(inertial.t_us) > COAST_AFTER_US:
            mode = Mode.COASTING
        elif self._trim.fresh(inertial.t_us):
            mode = Mode.TRIMMED
        node = history.append(inertial.t_us, moment, step_between(newest.moment.inertial, inertial, mode))
        if not inertial.real:
            return
        self._samples_since += 1
        if self._samples_since % HEADING_EVERY == 0:
            self._fuse(history, node, heading_of(inertial), self._heading)
        if not idle and self._samples_since % MODEL_EVERY == 0:
            self._fuse(history, node, model_aid_of(inertial, self._model, self._follow), self._aid_model)

    def _fix_age_us(self, t_us: int) -> int:
        """How long ago, at ``t_us``, the newest fix was that has been used. There is one since the start."""
        last_us = self._markers.last_fused_us
        return 0 if last_us is None else t_us - last_us

    def _go_blind(self, history: History) -> None:
        """Without AHRS data for too long: let the vehicle model move the state."""
        until_us = self._now_us - AHRS_WAIT_US
        gap_us = until_us - history.newest.t_us
        if gap_us < BLIND_STEP_US:
            return
        step_us = max(BLIND_STEP_US, gap_us // BLIND_STEPS_MAX)
        while history.newest.t_us + step_us <= until_us:
            newest = history.newest
            x = newest.state.x
            ax, ay, az, turn = expected_acceleration(self._model, self._follow, x, newest.moment)
            inertial = made_up(
                newest.t_us + step_us,
                newest.moment.inertial,
                (ax + float(x[8]), ay + float(x[9]), az + float(x[10])),
                BLIND_TILT_DECAY,
                turn * 1e-6 * step_us,
            )
            self._recent.append(inertial)
            self._advance(history, inertial)
            self._counts["ahrs.blind_steps"] += 1

    # Start-up.

    def _try_start(self, until_us: int) -> None:
        for sample in self._intake.due(until_us):
            before = [i for i in self._recent if i.t_us <= sample.t_us]
            fix = self._first_fix(sample, before[-1]) if before else None
            if fix is not None and self._history is None and self._startup.offer(fix):
                self._start(fix, before[-1])

    def _first_fix(self, sample: AidingSample, inertial: Inertial) -> PoseFix | None:
        if isinstance(sample, PoseSample):
            return self._checked(fix_from_sample(sample, "markers"))
        if isinstance(sample, MarkerSighting) and self._solver is not None:
            if not self._solver.well_formed(sample):
                return self._checked(None)
            return self._solver.locate(sample, inertial.roll_rad, inertial.pitch_rad)
        return None

    def _start(self, fix: PoseFix, first: Inertial) -> None:
        """First node at the AHRS sample before the fix, then all AHRS samples since."""
        x = initial_state(fix.z[:3], float(fix.z[3]), wrap_pi(first.ahrs_yaw_rad - float(fix.z[3])))
        node = Node(first.t_us, Moment(first, self._thrust.at(first.t_us)), None, self._core.start(x))
        self._history = History(self._core, node)
        self._markers.last_fused_us = fix.t_us
        for inertial in [i for i in self._recent if i.t_us > first.t_us]:
            self._advance(self._history, inertial)

    # Measurements.

    def _fuse_due(self, history: History) -> None:
        """Use what is due; computing later nodes again is put off while measurements share a node."""
        dirty: Node | None = None
        for sample in self._intake.due(history.newest.t_us):
            if not self._options.compensate_latency:
                sample = replace(sample, t_us=history.newest.t_us)
            node = history.at(sample.t_us)
            if node is None:
                (self._laser if isinstance(sample, LaserSample) else self._markers).counts["late"] += 1
                continue
            if dirty is not None and dirty is not node:
                history.replay(dirty)
                dirty = None
            if self._use(history, node, sample):
                dirty = node
            if self._history is not history:  # moved to another pose: the old history is gone
                return
        if dirty is not None:
            history.replay(dirty)

    def _use(self, history: History, node: Node, sample: AidingSample) -> bool:
        """True if ``node`` has changed."""
        if isinstance(sample, PoseSample):
            return self._use_fix(history, node, self._checked(fix_from_sample(sample, "markers")))
        if isinstance(sample, LaserSample):
            return self._use_laser(history, node, sample)
        if self._solver is None:
            return False
        if not self._solver.well_formed(sample):
            self._checked(None)
            return False
        changed = self._use_fix(history, node, self._solve(node, sample, self._solver))
        dot = self._solver.laser_range(sample)
        if dot is not None and self._history is history:
            laser = LaserSample(t_us=sample.t_us, range_m=dot[0], sigma_m=dot[1])
            self._laser.counts["received"] += 1
            changed = self._use_laser(history, node, laser) or changed
        return changed

    def _solve(self, node: Node, sighting: MarkerSighting, solver: MarkerSolver) -> PoseFix | None:
        """Fix by the predicted pose; after some that do not fit, by a search over the whole floor."""
        if not sighting.ids:
            return None
        inertial, x = node.moment.inertial, node.state.x
        after_s = 1e-6 * (sighting.t_us - node.t_us)
        rpy = np.array([inertial.roll_rad, inertial.pitch_rad, x[YAW] + after_s * inertial.yaw_rate_rad_s])
        fix = solver.track(sighting, x[:3] + after_s * x[4:7], rpy)
        self._unfit_in_row = 0 if fix is not None and self._markers.rejected_in_row == 0 else self._unfit_in_row + 1
        if self._unfit_in_row > LOST_AFTER:
            fix = solver.locate(sighting, inertial.roll_rad, inertial.pitch_rad) or fix
        if fix is None:
            self._markers.counts["rejected"] += 1
        return fix

    def _use_fix(self, history: History, node: Node, fix: PoseFix | None) -> bool:
        if fix is None:
            return False
        y = self._fuse(history, node, fix, self._markers)
        if y is None:
            self._relocation.accepted()
            if fix.tilt_rad is not None and node.moment.inertial.real:
                self._trim.learn(node.moment.inertial, *fix.tilt_rad, fix.sigma_tilt_rad, fix.t_us)
            return True
        lost = self._fix_age_us(fix.t_us) > 1e6 * self._options.dead_reckoning_after_s
        velocity = self._relocation.rejected(fix, lost)
        if velocity is not None:
            self._relocate(history, fix, float(y[3]), velocity)
        return False

    def _use_laser(self, history: History, node: Node, sample: LaserSample) -> bool:
        laser: LaserRange | None = None
        if self._floor_depth_m is not None:
            laser = range_from_sample(sample, self._floor_depth_m, self._laser_mount_frd_m)
            if laser is None:
                self._laser.counts["malformed"] += 1
        return laser is not None and self._fuse(history, node, laser, self._laser) is None

    def _fuse(self, history: History, node: Node, measurement: Measurement, aid: Aid) -> FloatArray | None:
        """Gate and use one measurement. None if it was used, else its residual."""
        innovation = self._core.innovation(node.state, measurement, node.moment, 1e-6 * (measurement.t_us - node.t_us))
        fused = innovation.test_ratio <= 1.0
        if fused:
            history.correct(node, measurement, innovation)
        self._statuses.append(aid.judged(measurement.t_us, self._now_us, innovation, fused))
        return None if fused else innovation.y

    def _relocate(self, history: History, fix: PoseFix, turn_rad: float, vel_ned_m_s: FloatArray) -> None:
        """Believe the fixes and not ourselves: move the newest node there and forget the past."""
        newest = history.newest
        pos = fix.z[:3] + 1e-6 * (newest.t_us - fix.t_us) * vel_ned_m_s
        pose = np.append(pos, newest.state.x[YAW] + turn_rad)
        state = self._core.relocate(newest.state, pose, fix.noise + np.eye(4) * RELOCATED_VARIANCE, vel_ned_m_s)
        self._history = History(self._core, Node(newest.t_us, newest.moment, None, state))
        self._relocation.accepted()
        self._markers.rejected_in_row = 0
        self._markers.last_fused_us = fix.t_us
        self._counts["resets"] += 1

    def _checked(self, fix: PoseFix | None) -> PoseFix | None:
        """Count a malformed sample."""
        if fix is None:
            self._markers.counts["malformed"] += 1
        return fix


def _idle(moment: Moment, x: FloatArray) -> bool:
    """No thrust and no motion."""
    if max(map(abs, moment.thrust_n)) > IDLE_THRUST_N:
        return False
    return math.hypot(x.item(4), x.item(5)) < IDLE_SPEED_M_S
