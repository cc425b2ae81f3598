"""Markers on the floor as a source of poses: from images, or from a sensor that delivers poses."""

import math
from dataclasses import replace

import numpy as np

from autopilot.core import operator_messages as notices
from autopilot.core.samples import MarkerSighting, PoseSample
from autopilot.estimator.estimator_tuning import MARKERS_POSE, PNP
from autopilot.estimator.fix_aid import FixAid
from autopilot.estimator.history import Node
from autopilot.estimator.inertial import Inertial
from autopilot.estimator.markers_pose import MarkerSolver
from autopilot.estimator.measure_pose import PoseFix, fix_from_sample
from autopilot.estimator.pictures import Pictures
from autopilot.estimator.remarks import Remarks
from autopilot.estimator.states import POS, VEL, YAW, SheetStates

LOST_AFTER = 3
"""Sightings in a row that do not fit the predicted pose before the whole floor is searched."""


class MarkersAid(Remarks, FixAid[PoseSample | MarkerSighting]):
    """Camera and map, or a pose sensor."""

    sensor = "markers"
    samples = (PoseSample, MarkerSighting)
    of_pictures = True

    def __init__(self, pictures: Pictures) -> None:
        Remarks.__init__(self)
        FixAid.__init__(self)
        self._pictures = pictures
        self._unfit_in_row = 0
        self._unlocated = 0
        """Pictures in a row of several markers of the map that are nowhere on it."""
        self._reported_at = -1
        """Number of fixes that had been used when that was reported."""

    @property
    def offset_us(self) -> int:
        return self._pictures.offset_us

    def first_fix(self, sample: PoseSample | MarkerSighting, inertial: Inertial) -> PoseFix | None:
        if isinstance(sample, PoseSample):
            return self.counted(fix_from_sample(sample, self.sensor))
        solver = self._solver_of(sample)
        return None if solver is None else self._kept(self._located(sample, solver, inertial))

    def fix(self, sample: PoseSample | MarkerSighting, node: Node) -> PoseFix | None:
        if isinstance(sample, PoseSample):
            return self.counted(fix_from_sample(sample, self.sensor))
        solver = self._solver_of(sample)
        fix = None if solver is None else self._kept(self._solve(node, sample, solver))
        if fix is None or fix.fit is None or 4 * fix.fit.used > PNP.few_points:
            return fix
        more = MARKERS_POSE.few_inflation
        return replace(fix, noise=more * fix.noise, sigma_tilt_rad=math.sqrt(more) * fix.sigma_tilt_rad)

    def solver_counts(self) -> dict[str, int]:
        """Counts of rejections as ``markers.<reason>``."""
        solver = self._pictures.solver
        return {} if solver is None else {f"{self.sensor}.{what}": n for what, n in solver.counts.items()}

    def _solver_of(self, sighting: MarkerSighting) -> MarkerSolver | None:
        """Pose solver of a sighting; None without a map, and for a malformed one."""
        solver = self._pictures.solver
        if solver is None or solver.well_formed(sighting):
            return solver
        return self.counted(None)

    def _solve(self, node: Node, sighting: MarkerSighting, solver: MarkerSolver) -> PoseFix | None:
        """Fix by the predicted pose; after some that do not fit, by a search over the whole floor."""
        if not sighting.ids:
            return None
        inertial, x = node.moment.inertial, node.state.x
        after_s = 1e-6 * (sighting.t_us - node.t_us)
        rpy = np.array([inertial.roll_rad, inertial.pitch_rad, x[YAW] + after_s * inertial.yaw_rate_rad_s])
        sheets = () if node.state.sheets is None else (node.state.sheets,)
        fix = solver.track(sighting, x[POS] + after_s * x[VEL], rpy, *sheets)
        fits = fix is not None and self.rejected_in_row == 0
        self._unfit_in_row = 0 if fits else self._unfit_in_row + 1
        lost = self._unfit_in_row > LOST_AFTER
        if lost:
            fix = self._located(sighting, solver, inertial, *sheets) or fix
        if fix is None:
            self.counts["rejected"] += 1
        return fix

    def _located(
        self, sighting: MarkerSighting, solver: MarkerSolver, inertial: Inertial, *sheets: SheetStates
    ) -> PoseFix | None:
        """Pose by a search over the whole floor. That the map is another floor's, or its sizes are wrong, is reported
        once until a fix is used; from then on a few markers that happen to fit are no pose."""
        fix = solver.locate(sighting, inertial.roll_rad, inertial.pitch_rad, *sheets)
        few = fix is None or fix.fit is None or fix.fit.used < MARKERS_POSE.nowhere_markers
        if few and self._unlocated >= MARKERS_POSE.nowhere_pictures:
            fix = None
        if fix is not None:
            self._unlocated = 0
        elif solver.known_in(sighting) >= MARKERS_POSE.nowhere_markers:
            self._unlocated += 1
            if self._unlocated >= MARKERS_POSE.nowhere_pictures and self._reported_at != self.counts["fused"]:
                self._reported_at = self.counts["fused"]
                self._texts.append(notices.MARKERS_NOWHERE().text)
        return fix

    def _kept(self, fix: PoseFix | None) -> PoseFix | None:
        """Tell others of a pose from a picture."""
        if fix is not None:
            sigma = np.sqrt(fix.noise.diagonal())
            self._pictures.note_made(
                PoseSample(
                    t_us=fix.t_us,
                    pos_ned_m=fix.z[:3],
                    yaw_rad=float(fix.z[3]),
                    sigma_pos_m=sigma[:3],
                    sigma_yaw_rad=float(sigma[3]),
                )
            )
        return fix
