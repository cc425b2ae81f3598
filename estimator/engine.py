"""The estimator around a filter core: takes samples in, keeps history, gates, watches over the sensors, reports.

The filter lives on the time axis of the AHRS: every good AHRS sample makes a node. Measurements go to the node at or
before their time of validity, and the nodes after it change with it (:mod:`.estimator.history`). What is told to the
vehicle is the newest node carried on to now.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import AidStatus, NavDoubt, NavHealth, NavState, ShadowStatus
from autopilot.core.samples import AhrsSample, ImuSample, LaserSample, MarkerSighting, PoseSample, Sample
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.aiding import Aid, ScalarAid
from autopilot.estimator.attitude import AttitudeSource
from autopilot.estimator.camera_doubt import NO_CAMERA, CameraWatch
from autopilot.estimator.doubt import STEADY_M_S2, STEADY_RAD_S
from autopilot.estimator.evidence import Evidence
from autopilot.estimator.filter_core import FilterCore, Innovation
from autopilot.estimator.fix_aid import FixAid
from autopilot.estimator.fix_motion import Seen, drift_variance, plausible
from autopilot.estimator.fix_trust import DENYING, FixTrust
from autopilot.estimator.history import History, Loosening, Node, Reopening
from autopilot.estimator.imu_watch import GYRO_STATE, HEADING_STATES, NOTHING_NEW, ImuWatch
from autopilot.estimator.inertial import AhrsDoor, AhrsMount, Inertial, Mode, level, made_up, step_between
from autopilot.estimator.intake import Intake
from autopilot.estimator.map_watch import LOOSE_VARIANCE, MapWatch
from autopilot.estimator.markers_pose import MarkerSolver
from autopilot.estimator.measure_model import MODEL_EVERY
from autopilot.estimator.measure_pose import PoseFix
from autopilot.estimator.measurement import Measurement, Moment
from autopilot.estimator.options import DEFAULT_OPTIONS, EstimatorOptions
from autopilot.estimator.output import judge_health, nav_state
from autopilot.estimator.refined import refined_map
from autopilot.estimator.sources import Sources
from autopilot.estimator.startup import StartUp
from autopilot.estimator.states import (
    ACCEL_BIAS,
    BIAS_AHEAD,
    BIAS_DOWN,
    BIAS_RIGHT,
    CURRENT,
    CURRENT_RATE,
    DOWN,
    GYRO_BIAS,
    INITIAL_SIGMA,
    LASER_BIAS,
    POS,
    VEL,
    YAW,
    initial_state,
)
from autopilot.estimator.thrust import ThrustLag
from autopilot.estimator.tilt import TiltTrim

AHRS_WAIT_US = 60_000
"""After so long without AHRS data the filter goes on without."""
BLIND_STEP_US = 20_000
BLIND_STEPS_MAX = 500
"""At most so many steps without AHRS data per tick; they get longer when the gap is longer."""
BLIND_TILT_DECAY = 0.99
"""Per blind step: roll and pitch fade to level within 2 s."""
COAST_AFTER_US = 300_000
"""Time without a fix or a velocity over ground after which the current is held."""
TRACKED_US = 1_000_000
"""So recent a velocity over ground keeps dead reckoning going."""
INERTIAL = (AhrsSample, ImuSample)
PICTURES = (PoseSample, MarkerSighting)
"""Kinds of samples that make a node, and that give a pose by a picture."""
REDRIVEN_US = 800_000
"""A sensor that ceases to be believed has been wrong for up to so long."""
DOUBT_US = 1_000_000
"""At least so long an estimate is not called good after a sensor has ceased to be believed."""
ANCHORED_US = 500_000
"""With a sensor that is not believed the estimate is good only when fixes have been used for so long."""
LEARN_EVERY_US = 200_000
"""How often a picture is asked how sheets lie to each other: in between its errors are nearly the same."""
CARRIED_US = 3_000
"""Smaller changes of what is known of the stamps leave the estimate as it is."""
CARRIED_SIGMA = np.array([0.005, 0.005, 0.005, 0.01])
"""m, rad; besides all of what it was carried forward."""
RELOCATED_VARIANCE = 1e-3
"""Added to the variance of the fix that a reset goes to (m^2, rad^2): it has been carried on to now."""

ASTRAY = (ACCEL_BIAS, CURRENT, CURRENT_RATE)
"""What dead reckoning goes by: the water may have changed on the way, and its change passed for an offset."""


class Engine:
    """:class:`autopilot.estimator.protocol.Estimator` on a filter core."""

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
        solver = None if markers is None else MarkerSolver(CameraModel.of_vehicle(vehicle), markers)
        self._sources = Sources(vehicle, solver, floor_depth_m, options)
        self._intake = Intake(self._sources.aid_of)
        self._door = AhrsDoor()
        self._attitude = AttitudeSource()
        self._mount = AhrsMount(vehicle.ahrs.position_frd_m)
        self._ahrs_offset_us = round(1e6 * vehicle.ahrs.time_offset_s)
        self._thrust = ThrustLag(vehicle.thrusters)
        self._imu = ImuWatch(self._sources.model.vehicle)
        self._evidence = Evidence()
        self._markers = markers
        camera = vehicle.camera or NO_CAMERA
        self._camera = CameraWatch(camera, options.stamps_every_s)
        self._camera_down_m = camera.position_frd_m[2]
        self._latency_s = camera.latency_s
        self._focal_share, self._focal_changed, self._stamps_changed = 0.0, False, False
        self._map = None if markers is None else MapWatch(markers)
        self._judged: Innovation | None = None
        self._anchored_since_us: int | None = None
        self._startup = StartUp()
        self._trim = TiltTrim()
        self._history: History | None = None
        self._recent: deque[Inertial] = deque(maxlen=128)
        self._statuses: list[AidStatus] = []
        self._now_us = -1
        self._last: NavState | None = None
        self._against: frozenset[NavDoubt] = frozenset()
        """:meth:`_doubts` of the last step."""
        self._samples_since = 0
        self._ahrs_us: int | None = None
        self._learned_us = -LEARN_EVERY_US
        sheets = ("sheets.fused", "sheets.rejected", "sheets.loosened")
        names = ("resets", "clock.backwards", "ahrs.blind_steps", *sheets, "stamps.retimed", "focal.rescaled")
        self._counts = dict.fromkeys(names, 0)

    def step(self, t_us: int, samples: Sequence[Sample], thrust_n: FloatArray) -> NavState | None:
        """See :class:`autopilot.estimator.protocol.Estimator`."""
        if t_us <= self._now_us:
            self._counts["clock.backwards"] += 1
            return self._last
        self._now_us = t_us
        self._thrust.advance(t_us, thrust_n)
        self._take_in(samples)
        if self._stamps_changed:
            self._retime(self._history)
        if self._history is not None:
            self._go_blind(self._history)
        elif self._recent:
            self._try_start(self._recent[-1].t_us)
        if self._history is None:
            return None
        self._fuse_due(self._history)
        if self._options.compensate_latency and self._camera.look_at_stamps():
            self._retime(self._history)
        if self._focal_changed:
            self._rescale(self._history)
        newest = self._history.newest
        ground_us = self._sources.velocity.ground_us
        tracked = ground_us is not None and t_us - ground_us <= TRACKED_US
        doubts = self._against = self._doubts(self._history, t_us)
        doubted = bool(doubts) and not self._harmless(doubts, t_us)
        health = judge_health(
            newest, self._core, self._fix_age_us(t_us), self._options, tracked=tracked, doubted=doubted
        )
        more = self._evidence.unexplained_variance(t_us, newest.state.x.item(LASER_BIAS))
        rate = newest.moment.inertial.yaw_rate_rad_s
        more = more + self._camera.unexplained_variance(self._height_m(newest), newest.state.x, rate)
        if self._map is not None:
            more = more + self._map.more_variance(newest.state.x)
        self._last = nav_state(self._core, newest, t_us, health, self._counts["resets"], more, doubts)
        return self._last

    def take_aids(self) -> tuple[AidStatus, ...]:
        """See :class:`autopilot.estimator.protocol.Estimator`."""
        result = tuple(self._statuses)
        self._statuses.clear()
        return result

    def counters(self) -> Mapping[str, int]:
        """See :class:`autopilot.estimator.protocol.Estimator`."""
        result = dict(self._counts)
        result.update({f"ahrs.{verdict.value}": count for verdict, count in self._door.counts.items()})
        result["ahrs.tilt_disagreements"] = self._attitude.disagreements
        result["ahrs.field_disturbances"] = self._attitude.field_disturbances
        result["doubt.accel"], result["doubt.gyro"] = self._imu.accel.count, self._imu.gyro.count
        result["doubt.jumps"] = self._evidence.jumps
        result["doubt.camera"] = self._sources.markers.trust.count
        result["doubt.compass_jumps"] = self._imu.gyro.jumps
        result["thrust.malformed"] = self._thrust.malformed
        result.update(self._sources.counts())
        return result

    def take_made(self) -> tuple[PoseSample | LaserSample, ...]:
        """Poses and ranges from pictures since the last call, stamped as the pictures were."""
        return self._sources.pictures.take_made()

    def take_remarks(self) -> tuple[str, ...]:
        """See :class:`autopilot.estimator.protocol.Estimator`."""
        return self._camera.take_texts() + (() if self._map is None else self._map.take_texts())

    @property
    def refined_map(self) -> MarkerMap | None:
        """See :class:`autopilot.estimator.protocol.Estimator`."""
        if self._markers is None or self._history is None:
            return self._markers
        return refined_map(self._markers, self._history.newest.state.sheets)

    @property
    def doubts(self) -> frozenset[NavDoubt]:
        """See :class:`autopilot.estimator.protocol.Estimator`."""
        return self._against

    @property
    def ahrs_us(self) -> int | None:
        """See :class:`autopilot.estimator.protocol.Estimator`."""
        return self._ahrs_us

    @property
    def shadow(self) -> ShadowStatus | None:
        """Nobody watches a single estimator."""
        return None

    # Samples in.

    def _take_in(self, samples: Sequence[Sample]) -> None:
        inertial: list[AhrsSample | ImuSample] = []
        aiding: list[Sample] = []
        for sample in samples:
            if isinstance(sample, INERTIAL):
                inertial.append(sample)
            elif type(sample) in self._sources.aid_of:
                aiding.append(sample)
        if len(inertial) > 1:
            inertial.sort(key=lambda s: s.t_us)
        for given in inertial:
            self._take_inertial(given)
        for stamped in aiding:
            sample = self._sources.on_our_clock(stamped)
            self._intake.admit(sample, self._now_us)
            if isinstance(sample, PICTURES):
                if isinstance(sample, MarkerSighting):
                    self._camera.note_picture()
                ahead_us = sample.t_us - self._now_us
                self._stamps_changed |= self._camera.stamps.arrives(self._now_us, ahead_us, self._latency_s)

    def _take_inertial(self, given: AhrsSample | ImuSample) -> None:
        """One sample that makes a node, if it is good."""
        own = isinstance(given, AhrsSample)
        sample = given if isinstance(given, AhrsSample) else self._attitude.attitude(given)
        if self._ahrs_offset_us:
            sample = replace(sample, t_us=sample.t_us + self._ahrs_offset_us)
        newest_us = self._recent[-1].t_us if self._recent else -1
        if not self._door.let_in(sample, self._now_us, newest_us):
            return
        self._ahrs_us = self._now_us
        if own and self._options.watch_tilt:
            self._attitude.watch(sample)
        sample = self._mount.at_center(sample)
        inertial = level(sample, self._trim.at(sample))
        self._recent.append(inertial)
        self._camera.stamps.feel(inertial)
        if self._history is not None:
            self._advance(self._history, inertial)

    def _advance(self, history: History, inertial: Inertial) -> None:
        """One node more, with the measurements that every so many AHRS samples bring."""
        newest = history.newest
        moment = Moment(inertial, self._thrust.at(inertial.t_us))
        model_tells = self._sources.model.has_a_say(moment, newest.state.x)
        anchored = self._anchor_age_us(inertial.t_us) <= COAST_AFTER_US
        mode = Mode.NOMINAL
        if not inertial.real:
            mode = Mode.BLIND
        elif not model_tells or not anchored:
            mode = Mode.COASTING
        elif self._trim.fresh(inertial.t_us):
            mode = Mode.TRIMMED
        if inertial.real and self._imu.since_us is not None:
            driven, step = self._imu.drive(newest, inertial)
            node = history.append(inertial.t_us, moment._replace(inertial=driven), step)
        else:
            node = history.append(inertial.t_us, moment, step_between(newest.moment.inertial, inertial, mode))
        if not inertial.real:
            return
        if self._options.model_aid:
            self._watch_imu(history, newest, node, inertial, anchored=anchored)
        self._samples_since += 1
        heading, model = self._sources.heading, self._sources.model
        if heading.due(self._samples_since):
            self._use_scalar(history, node, heading.measured(inertial), heading)
        accel_believed = self._imu.accel.since_us is None
        if model_tells and accel_believed and model.due(self._samples_since):
            self._use_scalar(history, node, model.measured(inertial), model)

    def _watch_imu(self, history: History, before: Node, node: Node, raw: Inertial, *, anchored: bool) -> None:
        """Cease to believe a sensor that the evidence denies, and believe it again when it has mended."""
        if not anchored:
            self._anchored_since_us = None
        elif self._anchored_since_us is None:
            self._anchored_since_us = node.t_us
        found = self._imu.look(
            before,
            node,
            raw,
            model_dt_s=1e-6 * MODEL_EVERY * (node.t_us - before.t_us) * self._sources.model.due(self._samples_since),
            anchored=anchored,
            denied=self._evidence.denies,
            heading_denied=not self._camera.stamps.suspects and self._evidence.denies_heading(self._imu.gyro.quick_rad),
            model_rejected=self._sources.model.rejected_in_row,
            compass_rejected=self._sources.heading.rejected_in_row,
        )
        if found is NOTHING_NEW:
            return
        if found.doubted:
            history.redrive(node.t_us - REDRIVEN_US, self._imu.drive, self._sources.model.sensor)
            for aid in self._sources.fixes:
                aid.trust.begin_anew()
        forgotten: list[tuple[slice, float, tuple[float, ...] | None]] = []
        if found.apart_rad:
            forgotten += [(part, found.apart_rad**2, None) for part in HEADING_STATES]
        if found.jump_rad:
            forgotten.append((HEADING_STATES[1], found.jump_rad**2, None))
        if found.accel_offset is not None:
            self._imu.accel.believe()
            forgotten.append((ACCEL_BIAS, STEADY_M_S2**2, found.accel_offset))
        if found.gyro_offset is not None:
            self._imu.gyro.believe()
            forgotten.append((GYRO_STATE, STEADY_RAD_S**2, found.gyro_offset))
        for part, variance, value in forgotten:
            history.reopen(node, Reopening("imu", node.t_us, part, variance, value))

    def _doubts(self, history: History, t_us: int) -> frozenset[NavDoubt]:
        """What speaks against the estimate or its sensors."""
        found = self._evidence.doubts(t_us, history.newest.state.x.item(LASER_BIAS))
        trust = self._sources.markers.trust
        for sensor, name in ((self._imu.accel, NavDoubt.ACCELEROMETER), (self._imu.gyro, NavDoubt.GYRO)):
            if sensor.since_us is not None and trust.witnessed(sensor.since_us):
                found.add(name)
        if self._map is not None and self._map.doubtful(t_us):
            found.add(NavDoubt.MAP)
        if self._camera.doubtful:
            found.add(NavDoubt.CALIBRATION)
        if trust.doubtful(t_us):
            found.add(NavDoubt.CAMERA)
        return frozenset(found)

    def _harmless(self, doubts: frozenset[NavDoubt], t_us: int) -> bool:
        """Whether fixes hold the position in spite of the doubts: only inertial sensors or the range are concerned."""
        if NavDoubt.FIXES in doubts or NavDoubt.CAMERA in doubts:
            return False
        since_us = self._imu.since_us
        if since_us is None:
            return True
        held_us = self._anchored_since_us
        return held_us is not None and t_us - held_us >= ANCHORED_US and t_us - since_us >= DOUBT_US

    def _fix_age_us(self, t_us: int) -> int:
        """How long ago, at ``t_us``, the newest fix was that has been used. There is one since the start."""
        newest_us = self._sources.newest_fix_us
        return 0 if newest_us is None else t_us - newest_us

    def _anchor_age_us(self, t_us: int) -> int:
        """The same of anything that tells the motion over ground: a fix or a velocity."""
        age_us = self._fix_age_us(t_us)
        ground_us = self._sources.velocity.ground_us
        return age_us if ground_us is None else min(age_us, t_us - ground_us)

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
            ax, ay, az, turn = self._sources.model.vehicle.at(x, newest.moment)
            inertial = made_up(
                newest.t_us + step_us,
                newest.moment.inertial,
                (ax + float(x[BIAS_AHEAD]), ay + float(x[BIAS_RIGHT]), az + float(x[BIAS_DOWN])),
                BLIND_TILT_DECAY,
                turn * 1e-6 * step_us,
            )
            self._recent.append(inertial)
            self._camera.stamps.feel(inertial)
            self._advance(history, inertial)
            self._counts["ahrs.blind_steps"] += 1

    # Start-up.

    def _try_start(self, until_us: int) -> None:
        for sample in self._intake.due(until_us):
            before = [i for i in self._recent if i.t_us <= sample.t_us]
            aid = self._sources.fix_of.get(type(sample))
            fix = aid.first_fix(sample, before[-1]) if before and aid is not None else None
            if aid is not None and fix is not None and self._history is None and self._startup.offer(fix):
                self._start(fix, aid, before[-1])

    def _start(self, fix: PoseFix, aid: Aid, first: Inertial) -> None:
        """First node at the AHRS sample before the fix, then all AHRS samples since."""
        x = initial_state(fix.z[:3], float(fix.z[3]), wrap_pi(first.ahrs_yaw_rad - float(fix.z[3])))
        node = Node(first.t_us, Moment(first, self._thrust.at(first.t_us)), None, self._core.start(x))
        self._history = History(self._core, node)
        aid.last_fused_us = fix.t_us
        for inertial in [i for i in self._recent if i.t_us > first.t_us]:
            self._advance(self._history, inertial)

    # Measurements.

    def _fuse_due(self, history: History) -> None:
        """Use what is due."""
        for sample in self._intake.due(history.newest.t_us):
            if not self._options.compensate_latency:
                sample = replace(sample, t_us=history.newest.t_us)
            node = history.at(sample.t_us)
            if node is None:
                self._sources.aid_of[type(sample)].counts["late"] += 1
                continue
            fixing = self._sources.fix_of.get(type(sample))
            fix = None if fixing is None else fixing.fix(sample, node)
            if fixing is not None and fix is not None:
                self._use_fix(history, node, fix, fixing)
            if self._history is not history:  # moved to another pose: the old history is gone
                return
            aid = self._sources.scalar_of.get(type(sample))
            if aid is not None and (self._sources.markers.trust.believed or not aid.of_pictures):
                scalar = aid.measured(sample)
                if scalar is not None:
                    self._use_scalar(history, node, scalar, aid)

    def _use_fix(self, history: History, node: Node, fix: PoseFix, aid: FixAid[Any]) -> None:
        """Gate one fix, and what follows from it for sheets, tilt, doubts and resets."""
        relocation, trust = aid.relocation, aid.trust
        if not trust.believed:
            self._watch_doubted(history, node, fix, aid)
            return
        known = () if node.state.sheets is None else node.state.sheets.which
        missed = self._fuse(history, node, fix, aid)
        if aid is self._sources.markers or not self._markers_in_view(fix.t_us):
            assert self._judged is not None
            self._evidence.weigh(self._judged, None if missed is None else relocation.agreeing_with(fix))
        if aid is self._sources.markers:
            self._camera.stamps.see(fix, missed=missed is not None or self._evidence.shows)
            self._focal_changed |= fix.focal is not None and self._camera.look_at_focal(*fix.focal)
        self._watch_map(history, node, fix, rejected=missed is not None)
        if missed is None:
            relocation.accepted()
            trust.begin_anew()
            self._learn_sheets(history, node, fix, known)
            aid.jumped = False
            if fix.tilt_rad is not None and node.moment.inertial.real:
                self._trim.learn(node.moment.inertial, *fix.tilt_rad, fix.sigma_tilt_rad, fix.t_us)
            return
        seen = self._against_reckoning(node, fix, missed)
        trust.see(fix, seen)
        if aid is not self._sources.external or not self._markers_in_view(fix.t_us):  # they know better
            self._consider_reset(history, fix, aid, missed, seen)

    def _consider_reset(self, history: History, fix: PoseFix, aid: FixAid[Any], missed: Innovation, seen: Seen) -> None:
        """After a fix that was rejected: go where fixes are, or cease to believe them."""
        relocation, trust = aid.relocation, aid.trust
        gap = self._in_gap(fix.t_us)
        lost = gap or self._imu.since_us is not None or aid.jumped
        agreeing = 1 + relocation.agreeing_with(fix)
        velocity = relocation.rejected(fix, lost)
        if velocity is None:
            return
        camera = aid is self._sources.markers
        near = plausible(seen.y, missed.variance, seen.drift, 1e-6 * self._anchor_age_us(fix.t_us))
        if trust.denied(agreeing):
            if camera and agreeing >= DENYING:
                self._disbelieve(trust)
        elif (
            camera
            and self._imu.since_us is None
            and not (trust.may_reset(self._now_us, agreeing) and (not gap or near))
        ):
            self._disbelieve(trust)
        else:
            if not lost:
                self._evidence.note_jump(self._now_us, np.abs(missed.y))
            self._relocate(history, fix, aid, float(missed.y[3]), velocity, lost=lost)

    def _in_gap(self, t_us: int) -> bool:
        """Whether no fix has been used for so long that the estimate is dead reckoning."""
        return self._fix_age_us(t_us) > 1e6 * self._options.dead_reckoning_after_s

    def _disbelieve(self, trust: FixTrust) -> None:
        """The camera shows another place or time: what its fixes have denied so far they have denied wrongly."""
        trust.disbelieve(self._now_us)
        self._evidence.forgive()

    def _against_reckoning(self, node: Node, fix: PoseFix, judged: Innovation) -> Seen:
        """A fix that is not used, as it lies to dead reckoning."""
        p = node.state.p
        gap_s = 1e-6 * self._anchor_age_us(fix.t_us)
        drift = drift_variance(
            p if p.ndim == 1 else p.diagonal(),
            gap_s,
            accel=self._imu.accel.since_us is None,
            gyro=self._imu.gyro.since_us is None,
        )
        return Seen(fix.t_us, fix.z, judged.y, fix.noise.diagonal(), drift, judged.test_ratio <= 1.0)

    def _watch_doubted(self, history: History, node: Node, fix: PoseFix, aid: FixAid[Any]) -> None:
        """A fix of a camera that is not believed: not used, until a run of them is right again."""
        trust = aid.trust
        judged = self._core.innovation(node.state, fix, node.moment, 1e-6 * (fix.t_us - node.t_us))
        self._statuses.append(aid.judged(fix.t_us, self._now_us, judged, False, fix.fit))
        self._camera.stamps.see(fix, missed=True)
        trust.see(fix, self._against_reckoning(node, fix, judged))
        run = trust.recovered(lost=self._last is not None and self._last.health is NavHealth.INVALID)
        if run is None:
            return
        for sensor in (self._imu.accel, self._imu.gyro):
            if sensor.since_us is not None and not trust.witnessed(sensor.since_us):
                sensor.believe()  # nobody could tell who was wrong: fixes will
        trust.believe(self._now_us)
        aid.relocation.accepted()
        if judged.test_ratio <= 1.0:
            return
        self._evidence.note_jump(self._now_us, np.abs(judged.y))
        velocity = run.velocity(node.state.x[VEL])
        self._relocate(history, fix, aid, float(judged.y[3]), velocity, lost=self._in_gap(fix.t_us))

    def _watch_map(self, history: History, node: Node, fix: PoseFix, *, rejected: bool) -> None:
        """Look for what does not lie where the map has it."""
        if self._map is None or fix.sensor != "markers":
            return
        if not rejected:
            self._map.look(fix)
        for sheet in self._map.loosened(fix, rejected=rejected):
            history.loosen(node, Loosening("sheets", fix.t_us, sheet, self._map.laid(sheet), LOOSE_VARIANCE))
            self._counts["sheets.loosened"] += 1

    def _learn_sheets(self, history: History, node: Node, fix: PoseFix, known: Sequence[int]) -> None:
        """Every so often a picture is asked how its sheets lie to each other, and whenever it shows a new one: the pose
        takes the blame for what is wrong with a sheet until somebody asks."""
        if fix.ties is None or fix.ground is None:
            return
        if abs(fix.t_us - self._learned_us) < LEARN_EVERY_US and set(fix.ground.sheets) <= set(known):
            return
        self._learned_us = fix.t_us
        ties = fix.ties()
        if ties is None:
            return
        innovation = self._core.innovation(node.state, ties, node.moment, 0.0)
        if innovation.test_ratio <= 1.0:
            history.correct(node, ties, innovation)
            self._counts["sheets.fused"] += 1
            if self._map is not None:
                self._map.look_at_sheets(fix.t_us, node.state.sheets, fix.ground.sheets)
        else:
            self._counts["sheets.rejected"] += 1

    def _markers_in_view(self, t_us: int) -> bool:
        """Whether markers have been used of late."""
        seen_us = self._sources.markers.last_fused_us
        return seen_us is not None and t_us - seen_us <= 1e6 * self._options.dead_reckoning_after_s

    def _use_scalar(self, history: History, node: Node, measurement: Measurement, aid: ScalarAid[Any]) -> None:
        """Gate one measurement that is not of a pose."""
        missed = self._fuse(history, node, measurement, aid)
        if missed is not None:
            self._reopen(history, node, measurement, aid, missed)
        else:
            aid.used(measurement)

    def _fuse(self, history: History, node: Node, measurement: Measurement, aid: Aid) -> Innovation | None:
        """Gate and use one measurement. None if it was used, else what spoke against it."""
        innovation = self._core.innovation(node.state, measurement, node.moment, 1e-6 * (measurement.t_us - node.t_us))
        self._judged = innovation
        fused = innovation.test_ratio <= 1.0
        if fused:
            history.correct(node, measurement, innovation)
        fit = measurement.fit if isinstance(measurement, PoseFix) else None
        self._statuses.append(aid.judged(measurement.t_us, self._now_us, innovation, fused, fit))
        return None if fused else innovation

    def _reopen(
        self, history: History, node: Node, measurement: Measurement, aid: ScalarAid[Any], missed: Innovation
    ) -> None:
        """Reset a sensor that keeps missing by the same amount: forget its own states."""
        miss = aid.agreed_miss(missed)
        if miss is None:
            return
        part = aid.reopened(measurement, fixed=not self._in_gap(measurement.t_us))
        if part is None:
            return
        variance = max(miss, float((INITIAL_SIGMA[part] ** 2).max()))
        history.reopen(node, Reopening(aid.sensor, measurement.t_us, part, variance))
        aid.reset(self._now_us)

    def _retime(self, history: History | None) -> None:
        """Pictures are stamped later than was thought: what comes from now on is put right, and the estimate, which has
        followed pictures that lay behind, is carried forward."""
        self._stamps_changed = False
        late_us = round(1e6 * self._camera.stamps.late_s)
        pictures = self._sources.pictures
        more_us, pictures.late_us = late_us - pictures.late_us, late_us
        self._intake.retime_pictures(-more_us)
        if history is None or abs(more_us) < CARRIED_US:
            return
        newest, more_s = history.newest, 1e-6 * more_us
        x, inertial = newest.state.x, newest.moment.inertial
        c, s = math.cos(x.item(YAW)), math.sin(x.item(YAW))
        forward, right, down = (a - x.item(ACCEL_BIAS.start + i) for i, a in enumerate(inertial.accel_level_m_s2))
        velocity = more_s * np.array([c * forward - s * right, s * forward + c * right, down])
        turn = inertial.yaw_rate_rad_s - x.item(GYRO_BIAS)
        self._carry(newest, more_s * np.append(x[VEL], turn), velocity)
        self._counts["stamps.retimed"] += 1

    def _rescale(self, history: History) -> None:
        """The focal length is another than was thought: pictures and the estimate come nearer to the markers, or go
        away from them."""
        self._focal_changed = False
        newest, before = history.newest, self._focal_share
        self._focal_share = self._camera.focal_share
        self._sources.pictures.believe_focal(self._focal_share)
        share = (1.0 + self._focal_share) / (1.0 + before) - 1.0
        self._carry(newest, np.array([0.0, 0.0, self._height_m(newest) * share, 0.0]), np.zeros(3))
        self._counts["focal.rescaled"] += 1

    def _height_m(self, node: Node) -> float:
        """Of the camera over the floor with the markers, 0 = there is none."""
        if self._markers is None:
            return 0.0
        return max(self._markers.floor_m - node.state.x.item(DOWN) - self._camera_down_m, 0.0)

    def _carry(self, newest: Node, along: FloatArray, velocity: FloatArray) -> None:
        """The calibration was off: move the estimate by ``along`` (4,) [m, rad] and its ``velocity`` (3,), and forget
        what has followed it: inertial biases, doubts, and the past."""
        x = newest.state.x
        noise = np.diag(CARRIED_SIGMA**2 + along**2)
        state = self._core.relocate(newest.state, np.append(x[POS], x[YAW]) + along, noise, x[VEL] + velocity)
        for part in (GYRO_STATE, ACCEL_BIAS):
            state = self._core.reopen(state, part, float((INITIAL_SIGMA[part] ** 2).max()))
        self._imu.accel.believe()
        self._imu.gyro.believe()
        self._begin_at(Node(newest.t_us, newest.moment, None, state))
        for aid in self._sources.fixes:
            aid.trust.believe(None if aid.trust.believed else self._now_us)
        self._evidence.forgive()

    def _begin_at(self, node: Node) -> None:
        """Forget the past."""
        self._history = History(self._core, node)
        for aid in self._sources.fixes:
            aid.relocation.accepted()
            aid.trust.begin_anew()

    def _relocate(
        self,
        history: History,
        fix: PoseFix,
        aid: FixAid[Any],
        turn_rad: float,
        vel_ned_m_s: FloatArray,
        *,
        lost: bool,
    ) -> None:
        """Believe the fixes and not ourselves: move the newest node there and forget the past. One who was ``lost``
        has been carried astray by what was taken for granted on the way."""
        newest = history.newest
        pos = fix.z[:3] + 1e-6 * (newest.t_us - fix.t_us) * vel_ned_m_s
        pose = np.append(pos, newest.state.x[YAW] + turn_rad)
        state = self._core.relocate(newest.state, pose, fix.noise + np.eye(4) * RELOCATED_VARIANCE, vel_ned_m_s)
        for part in ASTRAY if lost else ():
            state = self._core.reopen(state, part, float((INITIAL_SIGMA[part] ** 2).max()))
        self._begin_at(Node(newest.t_us, newest.moment, None, state))
        self._evidence.begin_anew(self._now_us)
        aid.reset(self._now_us)
        aid.last_fused_us = fix.t_us
        aid.trust.note_reset(self._now_us)
        self._sources.external.jumped = False
        self._counts["resets"] += 1
