"""The estimator around a filter core: validation, history, gating, monitors, output.

The filter runs on the time axis of the AHRS: every valid AHRS sample is a node. A measurement is applied at the last
node before its time of validity, and the later nodes are corrected (:mod:`.estimator.history`). The output is the
newest node, predicted to now.

Measurements come from :mod:`.sources` through :mod:`.intake`; they are applied by :mod:`.fusion`, poses by
:mod:`.fixes`; inconsistencies are found by the monitors (:mod:`.monitor`).
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import AidStatus, NavDoubt, NavState
from autopilot.core.samples import (
    AhrsSample,
    CameraTiltSample,
    DepthSample,
    ImuSample,
    LaserSample,
    MarkerSighting,
    PlanarFixSample,
    PoseSample,
    Sample,
)
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.aiding import Aid
from autopilot.estimator.attitude import AttitudeSource
from autopilot.estimator.camera_monitor import NO_CAMERA, CameraMonitor
from autopilot.estimator.estimator_tuning import ENGINE
from autopilot.estimator.evidence import Evidence
from autopilot.estimator.filter_core import FilterCore
from autopilot.estimator.fixes import Fixes
from autopilot.estimator.fusion import Fusion
from autopilot.estimator.history import History, Node
from autopilot.estimator.imu_monitor import NOTHING_NEW, ImuMonitor
from autopilot.estimator.inertial import (
    AhrsMount,
    ImuValidator,
    Inertial,
    ProcessNoiseMode,
    level,
    made_up,
    step_between,
)
from autopilot.estimator.intake import SampleBuffer
from autopilot.estimator.map_monitor import MapMonitor
from autopilot.estimator.markers_pose import MarkerSolver
from autopilot.estimator.measure_gps import START_OFFSET_SIGMA_M
from autopilot.estimator.measure_pose import PoseFix
from autopilot.estimator.measurement import Moment
from autopilot.estimator.monitors import Monitors
from autopilot.estimator.options import DEFAULT_OPTIONS, EstimatorOptions
from autopilot.estimator.output import judge_health, nav_state
from autopilot.estimator.protocol import Estimator
from autopilot.estimator.recalibration import Recalibration
from autopilot.estimator.refined import refined_map
from autopilot.estimator.sources import Sources
from autopilot.estimator.startup import StartUp
from autopilot.estimator.states import BIAS_AHEAD, BIAS_DOWN, BIAS_RIGHT, CURRENT, DEPTH_OFFSET, YAW, initial_state, one
from autopilot.estimator.thrust import ThrustLag
from autopilot.estimator.tilt import TiltTrim
from autopilot.estimator.tilted_camera import TiltedCamera
from autopilot.estimator.water import WaterVariation

FIXED = (ProcessNoiseMode.NOMINAL, ProcessNoiseMode.TRIMMED)
"""Modes in which fixes and the vehicle model show the current."""
INERTIAL = (AhrsSample, ImuSample)
AGES = 31
"""Number of AHRS samples that show their usual age."""
PICTURES = (PoseSample, MarkerSighting)
"""Kinds of samples that make a node, and that give a pose by a picture."""


class FixRhythm:
    """Ages that the newest fix or velocity over ground reaches before the next is used, interval and latency included.

    30 Hz of pictures reach 0.15 s; an acoustic position that comes twice a second reaches more than twice what begins
    a gap among pictures.
    """

    def __init__(self, longest_us: int = ENGINE.longest_rhythm_us) -> None:
        """``longest_us``: no longer age is taken for the usual one."""
        self._longest_us = longest_us
        self._ages_us: deque[int] = deque(maxlen=ENGINE.rhythms_kept)
        self._last_us = 0
        self.alone_after_us = ENGINE.alone_after_us
        self.coast_after_us = ENGINE.coast_after_us

    def note(self, age_us: int) -> None:
        """``age_us``: since the newest fix or velocity over ground that has been used, at every node."""
        if age_us < self._last_us:
            self.reached(self._last_us)
        self._last_us = age_us

    def reached(self, age_us: int) -> None:
        """One age that was reached before the next was used."""
        self._ages_us.append(min(age_us, self._longest_us))
        usual_us = sorted(self._ages_us)[len(self._ages_us) // 2]
        self.alone_after_us = max(ENGINE.alone_after_us, round(ENGINE.alone_rhythms * usual_us))
        self.coast_after_us = max(ENGINE.coast_after_us, round(ENGINE.coast_rhythms * usual_us))


class AidedEstimator(Estimator):
    def __init__(
        self,
        core: FilterCore,
        vehicle: Vehicle,
        markers: MarkerMap | None,
        floor_depth_m: float | None,
        options: EstimatorOptions = DEFAULT_OPTIONS,
    ) -> None:
        self._options = options
        self._markers = markers
        solver = None if markers is None else MarkerSolver(CameraModel.of_vehicle(vehicle), markers)
        self._sources = Sources(vehicle, solver, floor_depth_m, options)
        self._intake = SampleBuffer(self._sources.aid_of)
        self._fusion = Fusion(core)
        self._startup = StartUp()
        # The AHRS, or the IMU that stands for it, and what drives the vehicle.
        self._validator = ImuValidator()
        self._attitude = AttitudeSource()
        self._mount = AhrsMount(vehicle.ahrs.position_frd_m)
        self._ahrs_offset_us = round(1e6 * vehicle.ahrs.time_offset_s)
        self._thrust = ThrustLag(vehicle.thrusters)
        self._water = WaterVariation()
        # Monitors.
        trust = self._sources.markers.trust
        camera = vehicle.camera or NO_CAMERA
        self._latency_s = camera.latency_s
        self._mounting_rad2 = max(camera.mounting_sigma_rad[:2]) ** 2
        self._trim = TiltTrim(max(camera.mounting_sigma_rad[:2]))
        self._monitors = monitors = Monitors(
            Evidence(self._sources.laser, self._sources.depth),
            ImuMonitor(self._sources.model.vehicle, trust, self._water),
            CameraMonitor(camera, options.stamps_every_s, None if markers is None else markers.floor_m),
            None if markers is None else MapMonitor(markers),
            trust,
            None if vehicle.tilt is None or vehicle.tilt.camera_deg is None else TiltedCamera(vehicle.tilt),
        )
        self._fixes = Fixes(self._fusion, self._sources, monitors, self._trim)
        self._recalibration = Recalibration(self._fusion, self._sources, self._intake, monitors)
        self._recent: deque[Inertial] = deque(maxlen=128)
        self._last: NavState | None = None
        self._against: frozenset[NavDoubt] = frozenset()
        """:meth:`_doubts` of the last step."""
        self._foreseen_yaw_rad = 0.0
        """Heading of the newest node before its measurements."""
        self._ahrs_us: int | None = None
        self._ahrs_ages_us: deque[int] = deque(maxlen=AGES)
        """Of the last samples on arrival: by a slow link they come late, and are not missing."""
        self._anchored_since_us: int | None = None
        self._rhythm = FixRhythm()
        self._fix_rhythm = FixRhythm(round(1e6 * ENGINE.coast_rhythms * options.dead_reckoning_after_s))
        """Of fixes alone: whether the estimate is dead reckoning."""
        self._counts = dict.fromkeys(("clock.backwards", "ahrs.blind_steps"), 0)

    def step(self, t_us: int, samples: Sequence[Sample], thrust_n: FloatArray) -> NavState | None:
        if t_us <= self._fusion.now_us:
            self._counts["clock.backwards"] += 1
            return self._last
        self._fusion.now_us = t_us
        self._thrust.advance(t_us, thrust_n)
        self._take_in(samples)
        self._recalibration.retime()
        if self._fusion.past is not None:
            self._go_blind()
        elif self._recent:
            self._try_start(self._recent[-1].t_us)
        if self._fusion.past is None:
            return None
        self._fuse_due()
        if self._options.compensate_latency:
            self._monitors.camera.check_stamps()
            self._recalibration.retime()
        self._recalibration.rescale()
        self._recalibration.resize()
        self._last = self._state(t_us, self._fusion.history.newest)
        return self._last

    def _state(self, t_us: int, newest: Node) -> NavState:
        """The estimate at the newest node."""
        core, ground_us = self._fusion.core, self._sources.velocity.ground_us
        doubts = self._against = self._monitors.doubts(t_us, newest)
        health = judge_health(
            newest,
            core,
            self._sources.position_age_us(t_us),
            self._options,
            usual_us=self._fix_rhythm.coast_after_us,
            tracked=ground_us is not None and t_us - ground_us <= ENGINE.tracked_us,
            blind=not newest.moment.inertial.real
            and (self._ahrs_us is None or t_us - self._ahrs_us > ENGINE.blind_after_us),
            doubted=bool(doubts) and not self._harmless(doubts, t_us),
        )
        more = self._monitors.systematic_variance(t_us, newest)
        return nav_state(core, newest, t_us, health, self._fusion.resets, more, doubts, self._mounting_rad2)

    def _harmless(self, doubts: frozenset[NavDoubt], t_us: int) -> bool:
        """Whether fixes hold the position in spite of suspect sensors: only inertial ones or the range."""
        if NavDoubt.FIXES in doubts or NavDoubt.CAMERA in doubts:
            return False
        since_us = self._monitors.imu.since_us
        if since_us is None:
            return True
        return self._long_anchored(t_us) and t_us - since_us >= ENGINE.suspect_us

    def _long_anchored(self, t_us: int) -> bool:
        """Whether fixes or velocities over ground have been used without a break for a while."""
        since_us = self._anchored_since_us
        return since_us is not None and t_us - since_us >= ENGINE.anchored_us

    def take_aids(self) -> tuple[AidStatus, ...]:
        return self._fusion.take_statuses()

    def counters(self) -> Mapping[str, int]:
        result = {
            "resets": self._fusion.resets,
            **self._counts,
            **self._fixes.counts,
            **self._recalibration.counts,
            **{f"ahrs.{verdict.value}": count for verdict, count in self._validator.counts.items()},
            "ahrs.tilt_disagreements": self._attitude.disagreements,
            "ahrs.field_disturbances": self._attitude.field_disturbances,
            "thrust.malformed": self._thrust.malformed,
            **self._sources.counts(),
        }
        for monitor in self._monitors.all:
            result.update(monitor.counts())
        return result

    def take_made(self) -> tuple[PoseSample | LaserSample, ...]:
        return self._sources.pictures.take_made()

    def take_remarks(self) -> tuple[str, ...]:
        sources = self._sources
        parts = (self._startup, self._attitude, sources.velocity, sources.markers, *self._monitors.all)
        return tuple(text for part in parts for text in part.take_texts())

    @property
    def refined_map(self) -> MarkerMap | None:
        if self._markers is None or self._fusion.past is None:
            return self._markers
        return refined_map(self._markers, self._fusion.history.newest.state.sheets)

    @property
    def doubts(self) -> frozenset[NavDoubt]:
        return self._against

    @property
    def ahrs_us(self) -> int | None:
        return self._ahrs_us

    # Samples in.

    def _take_in(self, samples: Sequence[Sample]) -> None:
        now_us = self._fusion.now_us
        inertial: list[AhrsSample | ImuSample] = []
        aiding: list[Sample] = []
        for sample in samples:
            if isinstance(sample, INERTIAL):
                inertial.append(sample)
            elif isinstance(sample, PlanarFixSample) and not self._options.gps:
                continue
            elif type(sample) in self._sources.aid_of:
                aiding.append(sample)
            elif isinstance(sample, CameraTiltSample) and self._monitors.tilted is not None:
                self._monitors.tilted.note(sample)
        if len(inertial) > 1:
            inertial.sort(key=lambda s: s.t_us)
        for given in inertial:
            self._take_inertial(given)
        tilted = self._monitors.tilted
        for stamped in aiding:
            sample = self._sources.on_our_clock(stamped)
            of_pictures = tilted is not None and self._sources.aid_of[type(sample)].of_pictures
            if of_pictures and tilted is not None and not tilted.uses(sample.t_us, now_us):
                continue
            self._intake.admit(sample, now_us)
            if isinstance(sample, PICTURES):
                if isinstance(sample, MarkerSighting):
                    self._monitors.camera.note_picture()
                self._monitors.camera.stamps.arrives(now_us, sample.t_us - now_us, self._latency_s)

    def _take_inertial(self, given: AhrsSample | ImuSample) -> None:
        """One sample that makes a node, if it is good."""
        now_us = self._fusion.now_us
        own = isinstance(given, AhrsSample)
        sample = given if isinstance(given, AhrsSample) else self._attitude.attitude(given)
        later_us = self._ahrs_offset_us - self._recalibration.inertial_late_us
        if later_us:
            sample = replace(sample, t_us=sample.t_us + later_us)
        newest_us = self._recent[-1].t_us if self._recent else -1
        self._ahrs_ages_us.append(now_us - sample.t_us)
        if not self._validator.let_in(sample, now_us, newest_us):
            return
        if self._ahrs_us is not None and now_us - self._ahrs_us > ENGINE.restarted_us:
            self._monitors.imu.forgive()
        self._ahrs_us = now_us
        if own and self._options.watch_tilt:
            sample = self._attitude.watch(sample)
        sample = self._mount.at_center(sample)
        self._feel(level(sample, self._trim.at(sample)))

    def _feel(self, inertial: Inertial) -> None:
        """One moment more, measured or made up."""
        self._recent.append(inertial)
        self._monitors.camera.stamps.feel(inertial)
        if self._fusion.past is not None:
            self._advance(self._fusion.past, inertial)

    def _advance(self, history: History, inertial: Inertial) -> None:
        """One node more, with the measurements that every so many AHRS samples bring."""
        newest = history.newest
        moment = Moment(inertial, self._thrust.at(inertial.t_us))
        heading, model = self._sources.heading, self._sources.model
        model_informs = model.is_informative(moment, newest.state.x)
        anchor_age_us = self._sources.anchor_age_us(inertial.t_us)
        self._rhythm.note(anchor_age_us)
        anchored = anchor_age_us <= self._rhythm.coast_after_us
        mode = ProcessNoiseMode.NOMINAL
        if not inertial.real:
            mode = ProcessNoiseMode.BLIND
        elif not model_informs or not anchored:
            mode = ProcessNoiseMode.COASTING
        elif self._trim.fresh(inertial.t_us):
            mode = ProcessNoiseMode.TRIMMED
        imu, before, x = self._monitors.imu, newest.moment.inertial, newest.state.x
        if inertial.real and imu.since_us is not None:
            self._water.lose()
            driven, step = imu.drive(newest, inertial)
            moment = moment._replace(inertial=driven)
        elif mode in FIXED:
            self._water.meet(inertial.t_us, 1e-6 * (inertial.t_us - newest.t_us), x)
            step = step_between(before, inertial, mode)
        else:  # at rest with fixes the current is not seen either, but what it does matters to nothing
            self._water.lose()
            step = step_between(before, inertial, mode, None, 0.0 if anchored else self._water.variance_per_s(x))
        if anchor_age_us <= self._rhythm.alone_after_us:
            imu.gyro.anchor()
        elif imu.gyro.trusted:
            grown = imu.gyro.coast(step.dt_s, x.item(YAW) - self._foreseen_yaw_rad)
            step = step._replace(yaw_variance_rad2=grown)
        drift = self._sources.velocity.drift
        fix_age_us = self._sources.position_age_us(inertial.t_us)
        self._fix_rhythm.note(fix_age_us)
        if fix_age_us <= self._rhythm.alone_after_us:
            drift.fixed(inertial.t_us, x)
        elif anchored:
            step = step._replace(position_variance_m2=drift.growth(inertial.t_us, step.dt_s, x))
        node = history.append(inertial.t_us, moment, step)
        self._foreseen_yaw_rad = node.state.x.item(YAW)
        if model.let_go(moment, informs=model_informs):
            self._fusion.forget(node, model, CURRENT)
        if not inertial.real:
            return
        model_dt_s = model.due_s(step.dt_s)
        if self._options.model_aid:
            self._watch_imu(history, newest, node, inertial, model_dt_s, anchored=anchored)
        if heading.due_s(step.dt_s):
            self._fusion.fuse_scalar(node, heading.measured(inertial), heading, fixed=True)
        if model_informs and self._monitors.imu.accel.trusted and model_dt_s:
            model.feel(node, inertial)
            self._fusion.fuse_scalar(node, model.measured(inertial), model, fixed=True)

    def _watch_imu(
        self, history: History, before: Node, node: Node, raw: Inertial, model_dt_s: float, *, anchored: bool
    ) -> None:
        """Suspect a sensor that the evidence contradicts, and trust it again when it has recovered. ``model_dt_s``:
        since the accelerometer was last held against the model, 0 = not now."""
        if not anchored:
            self._anchored_since_us = None
        elif self._anchored_since_us is None:
            self._anchored_since_us = node.t_us
        model, (evidence, imu, camera, *_) = self._sources.model, self._monitors
        found = imu.check(
            before,
            node,
            raw,
            model_dt_s=model_dt_s,
            anchored=anchored,
            denied=evidence.denies,
            heading_denied=not camera.stamps.suspects and evidence.denies_heading(imu.gyro.quick_rad),
            model_rejected=model.rejected_in_row,
            compass_rejected=self._sources.heading.rejected_in_row,
        )
        if found is NOTHING_NEW:
            return
        if found.doubted:
            history.redrive(node.t_us - ENGINE.redriven_us, imu.drive, model.sensor)
            for aid in self._sources.fixes:
                aid.trust.restart()
        for reopening in imu.reopenings(found, node.t_us):
            history.forget(node, reopening)

    def _go_blind(self) -> None:
        """Without AHRS data for too long: let the vehicle model move the state."""
        history = self._fusion.history
        ages_us = sorted(self._ahrs_ages_us)
        usual_us = min(ages_us[len(ages_us) // 2], ENGINE.ahrs_age_max_us) if ages_us else 0
        until_us = self._fusion.now_us - max(ENGINE.ahrs_wait_us, usual_us + ENGINE.ahrs_gap_us)
        gap_us = until_us - history.newest.t_us
        if gap_us < ENGINE.blind_step_us:
            return
        step_us = max(ENGINE.blind_step_us, gap_us // ENGINE.blind_steps_max)
        while history.newest.t_us + step_us <= until_us:
            newest = history.newest
            x = newest.state.x
            ax, ay, az, turn = self._sources.model.vehicle.at(x, newest.moment)
            inertial = made_up(
                newest.t_us + step_us,
                newest.moment.inertial,
                (ax + float(x[BIAS_AHEAD]), ay + float(x[BIAS_RIGHT]), az + float(x[BIAS_DOWN])),
                ENGINE.blind_tilt_decay,
                turn * 1e-6 * step_us,
            )
            self._feel(inertial)
            self._counts["ahrs.blind_steps"] += 1

    # Start-up.

    def _try_start(self, until_us: int) -> None:
        gps = self._sources.gps
        for sample in self._intake.due(until_us):
            aid = self._sources.fix_of.get(type(sample))
            before = [i for i in self._recent if i.t_us <= sample.t_us]
            if isinstance(sample, DepthSample):
                gps.note_depth(sample)
            if isinstance(sample, PlanarFixSample) and before and self._fusion.past is None:
                surface = gps.first_fix(sample, before[-1])
                if surface is not None:
                    self._start(surface, gps, before[-1])
            if aid is None or not before:
                continue
            fix = aid.first_fix(sample, before[-1])
            if fix is not None and self._fusion.past is None and self._startup.offer(fix):
                self._start(fix, aid, before[-1])

    def _start(self, fix: PoseFix, aid: Aid, first: Inertial) -> None:
        """First node at the AHRS sample before the fix, then all AHRS samples since."""
        x = initial_state(fix.z[:3], float(fix.z[3]), wrap_pi(first.ahrs_yaw_rad - float(fix.z[3])))
        state = self._fusion.core.start(x)
        if aid is self._sources.gps:  # metres, while the covariance of the start is that of markers
            state = self._fusion.core.relocate(state, fix.z, fix.noise, np.zeros(3))
            state = self._fusion.core.reopen(state, one(DEPTH_OFFSET), START_OFFSET_SIGMA_M**2)
            self._sources.gps.agreed_us = fix.t_us
            self._sources.velocity.drift.fixed(fix.t_us, x)
        self._fusion.begin_at(Node(first.t_us, Moment(first, self._thrust.at(first.t_us)), None, state))
        aid.last_fused_us = self._sources.begun_us = fix.t_us
        if self._startup.interval_us is not None:  # else what comes once a second would begin with a gap
            age_us = round(self._startup.interval_us) + self._fusion.now_us - fix.t_us
            self._rhythm.reached(age_us)
            self._fix_rhythm.reached(age_us)
        for inertial in [i for i in self._recent if i.t_us > first.t_us]:
            self._advance(self._fusion.history, inertial)

    # Measurements.

    def _fuse_due(self) -> None:
        history, sources = self._fusion.history, self._sources
        health = None if self._last is None else self._last.health
        for sample in self._intake.due(history.newest.t_us):
            if not self._options.compensate_latency:
                sample = replace(sample, t_us=history.newest.t_us)
            kind = type(sample)
            node = history.at(sample.t_us)
            if node is None:
                sources.aid_of[kind].counts["late"] += 1
                continue
            if kind in sources.fix_of:
                source = sources.fix_of[kind]
                fix = source.fix(sample, node)
                if fix is not None:
                    self._fixes.use(node, fix, source, health)
                if self._fusion.past is not history:  # moved to another pose: the old history is gone
                    return
            if kind in sources.scalar_of:
                aid = sources.scalar_of[kind]
                trusted = sources.markers.trust.trusted
                if aid.contradicted and trusted and not self._long_anchored(sample.t_us):
                    continue
                trusted |= not aid.of_pictures
                scalar = aid.measured(sample) if trusted and aid.wanted(sample, node) else None
                if scalar is not None:
                    self._fusion.fuse_scalar(node, scalar, aid, fixed=not sources.in_gap(scalar.t_us))
