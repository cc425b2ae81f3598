"""Processing of pose fixes: update, map and camera refinement, tilt trim, monitors, resets.

A fix inside its gate corrects the filter. Fixes outside that are mutually consistent reset it, unless dead reckoning
is the more reliable; then their source is only monitored until it is consistent again.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavHealth
from autopilot.estimator.estimator_tuning import MAP_MONITOR
from autopilot.estimator.filter_core import Innovation
from autopilot.estimator.fix_aid import FixAid
from autopilot.estimator.fix_motion import FixResidual, drift_variance, plausible
from autopilot.estimator.fix_trust import DENYING
from autopilot.estimator.fusion import Fusion
from autopilot.estimator.history import Loosening, Node
from autopilot.estimator.map_monitor import MapMonitor
from autopilot.estimator.measure_pose import PoseFix
from autopilot.estimator.monitors import Monitors
from autopilot.estimator.sources import Sources
from autopilot.estimator.states import ACCEL_BIAS, CURRENT, CURRENT_RATE, VEL, YAW
from autopilot.estimator.tilt import TiltTrim

LEARN_EVERY_US = 200_000
"""How often a picture is asked how sheets lie to each other: in between its errors are nearly the same."""
REGAINED_US = 1_000_000
"""So long after a gap fixes that disagree are no jump: the first of them may have been used with a wrong velocity."""
RELOCATED_VARIANCE = 1e-3
"""Added to the variance of the fix that a reset goes to (m^2, rad^2): it has been carried on to now."""
ASTRAY = (ACCEL_BIAS, CURRENT, CURRENT_RATE)
"""What dead reckoning goes by: the water may have changed on the way, and its change passed for an offset."""


class Fixes:
    def __init__(self, fusion: Fusion, sources: Sources, monitors: Monitors, trim: TiltTrim) -> None:
        self._fusion, self._sources, self._trim = fusion, sources, trim
        self._evidence, self._imu, self._camera, self._map, *_ = monitors
        self._learned_us = -LEARN_EVERY_US
        self._regained_us = -REGAINED_US
        """When the first fix after a gap was used."""
        self.counts = dict.fromkeys(("sheets.fused", "sheets.rejected", "sheets.loosened"), 0)

    def use(self, node: Node, fix: PoseFix, aid: FixAid[Any], health: NavHealth | None) -> None:
        """Process one fix at ``node``; ``health``: that of the last estimate."""
        if fix.stamp_sigma_s > 0.0:
            motion = np.append(node.state.x[VEL], node.moment.inertial.yaw_rate_rad_s)
            fix = replace(fix, noise=fix.noise + np.diag((fix.stamp_sigma_s * motion) ** 2))
        if not aid.trust.trusted:
            self._watch(node, fix, aid, lost=health is NavHealth.INVALID)
            return
        from_camera = aid is self._sources.markers
        has_weight = from_camera or not self._sources.markers_in_view(fix.t_us)  # markers know better
        known = () if node.state.sheets is None else node.state.sheets.which
        gap = self._sources.in_gap(fix.t_us)
        if fix.focal is not None:
            fix = replace(fix, noise=fix.noise + np.diag(self._camera.lens_variance(node.state.x)))
        judged = self._fusion.fuse(node, fix, aid)
        self._imu.gyro.see_fix(judged.y.item(3))
        if has_weight:
            self._evidence.weigh(judged, None if judged.passes else aid.relocation.agreeing_with(fix))
        if from_camera:
            self._camera.stamps.see(fix, missed=not judged.passes or self._evidence.shows)
            if fix.focal is not None:
                self._camera.update_focal(*fix.focal)
            self._watch_map(node, fix, rejected=not judged.passes)
        if judged.passes:
            if gap:
                self._regained_us = fix.t_us
            aid.relocation.accepted()
            aid.trust.restart()
            aid.jumped = False
            self._learn_sheets(node, fix, known)
            if fix.tilt_rad is not None and node.moment.inertial.real and self._camera.lens_fits:
                stamp_sigma_s = math.hypot(fix.stamp_sigma_s, self._camera.stamp_sigma_s)
                self._trim.learn(node.moment.inertial, *fix.tilt_rad, fix.sigma_tilt_rad, fix.t_us, stamp_sigma_s)
                self._camera.tilt_off_rad = self._trim.difference_rad
            return
        seen = self._against_reckoning(node, fix, judged)
        aid.trust.see(fix, seen)
        if has_weight:
            self._consider_reset(fix, aid, judged, seen)

    def _consider_reset(self, fix: PoseFix, aid: FixAid[Any], missed: Innovation, seen: FixResidual) -> None:
        """After a fix that was rejected: relocate to where fixes are, or suspect them."""
        trust, now_us = aid.trust, self._fusion.now_us
        gap = self._sources.in_gap(fix.t_us)
        regained = fix.t_us - self._regained_us <= REGAINED_US
        lost = gap or self._imu.since_us is not None or aid.jumped or regained
        agreeing = 1 + aid.relocation.agreeing_with(fix)
        velocity = aid.relocation.rejected(fix, lost)
        if velocity is None:
            return
        from_camera = aid is self._sources.markers
        denied = trust.denied(agreeing) and not regained
        if denied:
            wrong = agreeing >= DENYING
        else:
            gap_s = 1e-6 * self._sources.anchor_age_us(fix.t_us)
            near = plausible(seen.y, missed.variance, seen.drift, gap_s)
            may_move = trust.may_reset(now_us, agreeing) and (not gap or near)
            wrong = self._imu.since_us is None and not may_move
        if from_camera and wrong:
            # It shows another position or time: the evidence of its fixes so far is void.
            trust.suspect(now_us)
            self._evidence.forgive()
        elif not denied:
            if not lost:
                self._evidence.note_jump(now_us, np.abs(missed.y))
            self._relocate(fix, aid, float(missed.y[3]), velocity, lost=lost)

    def _watch(self, node: Node, fix: PoseFix, aid: FixAid[Any], *, lost: bool) -> None:
        """A fix of a suspect camera: not used until a series of them is consistent."""
        trust, now_us = aid.trust, self._fusion.now_us
        judged = self._fusion.judge(node, fix)
        self._fusion.report(fix, aid, judged, used=False)
        self._camera.stamps.see(fix, missed=True)
        trust.see(fix, self._against_reckoning(node, fix, judged))
        run = trust.recovered(lost=lost)
        if run is None:
            return
        self._imu.forgive_unwitnessed()
        trust.reinstate(now_us)
        aid.relocation.accepted()
        if judged.passes:
            return
        self._evidence.note_jump(now_us, np.abs(judged.y))
        velocity = run.velocity(node.state.x[VEL])
        self._relocate(fix, aid, float(judged.y[3]), velocity, lost=self._sources.in_gap(fix.t_us))

    def _against_reckoning(self, node: Node, fix: PoseFix, judged: Innovation) -> FixResidual:
        """A fix that is not used, as it lies to dead reckoning."""
        p = node.state.p
        drift = drift_variance(
            p if p.ndim == 1 else p.diagonal(),
            1e-6 * self._sources.anchor_age_us(fix.t_us),
            accel=self._imu.accel.trusted,
            gyro=self._imu.gyro.trusted,
        )
        return FixResidual(fix.t_us, fix.z, judged.y, fix.noise.diagonal(), drift, judged.passes)

    def _watch_map(self, node: Node, fix: PoseFix, *, rejected: bool) -> None:
        if self._map is None:
            return
        self._map.check_print(fix)
        if not rejected:
            self._map.check_outliers(fix)
        explaining = self._explaining_sheet(node, fix, self._map) if rejected else None
        for sheet in self._map.loosened(fix, explaining):
            laid = self._map.laid(sheet)
            self._fusion.history.forget(node, Loosening("sheets", fix.t_us, sheet, laid, MAP_MONITOR.loose_variance))
            self.counts["sheets.loosened"] += 1

    def _explaining_sheet(self, node: Node, fix: PoseFix, floor: MapMonitor) -> int | None:
        """The sheet of a rejected fix without whose place it would fit best; None if it would with none."""
        found, least = None, 1.0
        for sheet in () if fix.ground is None else fix.ground.sheets:
            loose = self._fusion.core.loosen(node.state, sheet, floor.laid(sheet), MAP_MONITOR.loose_variance)
            ratio = self._fusion.judge(replace(node, state=loose), fix).test_ratio
            if ratio <= least:
                found, least = sheet, ratio
        return found

    def _learn_sheets(self, node: Node, fix: PoseFix, known: Sequence[int]) -> None:
        """Measurement of the relative sheet offsets, periodically and whenever an image shows a new sheet: until then
        the pose absorbs the error of a sheet.
        """
        if fix.ties is None or fix.ground is None:
            return
        learned_recently = abs(fix.t_us - self._learned_us) < LEARN_EVERY_US
        shows_a_new_one = not set(fix.ground.sheets) <= set(known)
        if learned_recently and not shows_a_new_one:
            return
        self._learned_us = fix.t_us
        ties = fix.ties()
        if ties is None:
            return
        judged = self._fusion.core.innovation(node.state, ties, node.moment, 0.0)
        if judged.passes:
            self._fusion.history.correct(node, ties, judged)
            self.counts["sheets.fused"] += 1
            if self._map is not None:
                self._map.check_sheets(fix.t_us, node.state.sheets, fix.ground.sheets)
        else:
            self.counts["sheets.rejected"] += 1

    def _relocate(
        self, fix: PoseFix, aid: FixAid[Any], turn_rad: float, vel_ned_m_s: FloatArray, *, lost: bool
    ) -> None:
        """Reset the position to the fixes. If ``lost``, the states that have caused the drift are reset too."""
        fusion = self._fusion
        newest, now_us = fusion.history.newest, fusion.now_us
        pos = fix.z[:3] + 1e-6 * (newest.t_us - fix.t_us) * vel_ned_m_s
        pose = np.append(pos, newest.state.x[YAW] + turn_rad)
        fusion.move(pose, fix.noise + np.eye(4) * RELOCATED_VARIANCE, vel_ned_m_s, ASTRAY if lost else ())
        fusion.resets += 1
        self._sources.restart()
        self._evidence.restart(now_us)
        aid.reset(now_us)
        aid.last_fused_us = fix.t_us
        aid.trust.note_reset(now_us)
        self._sources.external.jumped = False
