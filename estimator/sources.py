"""The aiding sources of a vehicle, each a class in its ``measure_*.py``, by sample type."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib import import_module
from typing import Any

from autopilot.core.samples import Sample
from autopilot.core.sensors import SENSOR_ROWS
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.aiding import Aid, ScalarAid
from autopilot.estimator.fix_aid import FixAid
from autopilot.estimator.markers_pose import MarkerSolver
from autopilot.estimator.measure_depth import DepthAid
from autopilot.estimator.measure_external import ExternalAid
from autopilot.estimator.measure_gps import GpsAid
from autopilot.estimator.measure_heading import HeadingAid
from autopilot.estimator.measure_markers import MarkersAid
from autopilot.estimator.measure_model import ModelAid
from autopilot.estimator.measure_range import LaserAid
from autopilot.estimator.measure_velocity import VelocityAid
from autopilot.estimator.options import EstimatorOptions
from autopilot.estimator.pictures import Pictures


class Sources:
    """All aiding sources of one estimator."""

    def __init__(
        self, vehicle: Vehicle, solver: MarkerSolver | None, floor_depth_m: float | None, options: EstimatorOptions
    ) -> None:
        self._options = options
        self.pictures = Pictures(vehicle, solver)
        self.markers, self.external = MarkersAid(self.pictures), ExternalAid(vehicle)
        self.heading, self.model = HeadingAid(), ModelAid(vehicle, options)
        self.velocity, self.laser = VelocityAid(vehicle), LaserAid(vehicle, self.pictures, floor_depth_m)
        self.all: tuple[Aid, ...] = (
            self.markers,
            self.laser,
            self.heading,
            self.model,
            *_of_table(vehicle, floor_depth_m),
            self.velocity,
            self.external,
        )
        """In the order of their counts."""
        self.gps = next(aid for aid in self.all if isinstance(aid, GpsAid))
        self.depth = next(aid for aid in self.all if isinstance(aid, DepthAid))
        self.begun_us: int | None = None
        """Time of the fix that the estimate began at."""
        self.fixes = tuple(aid for aid in self.all if isinstance(aid, FixAid))
        self.fix_of: dict[type, FixAid[Any]] = {kind: aid for aid in self.fixes for kind in aid.samples}
        """Kind of sample -> who makes a pose of it,"""
        scalars = (aid for aid in self.all if isinstance(aid, ScalarAid))
        self.scalar_of: dict[type, ScalarAid[Any]] = {kind: aid for aid in scalars for kind in aid.samples}
        """who makes something else of it,"""
        self.aid_of: dict[type, Aid] = {**self.scalar_of, **self.fix_of}
        """and whose it is."""

    @property
    def newest_fix_us(self) -> int | None:
        """Time of validity of the newest fix that has been used, of GPS only the first; None before any."""
        markers_us, external_us = self.markers.last_fused_us, self.external.last_fused_us
        if markers_us is None or external_us is None:
            found_us = external_us if markers_us is None else markers_us
            return self.begun_us if found_us is None else found_us
        return max(markers_us, external_us)

    def fix_age_us(self, t_us: int) -> int:
        """Age of the newest used fix at ``t_us`` [us]; needs at least one since the start."""
        newest_us = self.newest_fix_us
        return 0 if newest_us is None else t_us - newest_us

    def position_age_us(self, t_us: int) -> int:
        """The same with fixes of GPS, used or agreeing."""
        age_us, gps_us = self.fix_age_us(t_us), self.gps.agreed_us
        return age_us if gps_us is None else min(age_us, t_us - gps_us)

    def in_gap(self, t_us: int) -> bool:
        """Whether no fix has been used for so long that the estimate is dead reckoning."""
        return self.fix_age_us(t_us) > 1e6 * self._options.dead_reckoning_after_s

    def anchor_age_us(self, t_us: int) -> int:
        """Time since the last use of a fix or a velocity over ground [us]."""
        age_us, ground_us = self.fix_age_us(t_us), self.velocity.ground_us
        return age_us if ground_us is None else min(age_us, t_us - ground_us)

    def markers_in_view(self, t_us: int) -> bool:
        """Whether markers have been used of late."""
        seen_us = self.markers.last_fused_us
        return seen_us is not None and t_us - seen_us <= 1e6 * self._options.dead_reckoning_after_s

    def restart(self) -> None:
        """The filter has been reset: discard the evidence of rejected fixes."""
        for aid in self.fixes:
            aid.relocation.accepted()
            aid.trust.restart()

    def on_our_clock(self, sample: Sample) -> Sample:
        """The sample with its sensor's time offset taken off."""
        offset_us = self.aid_of[type(sample)].offset_us
        return replace(sample, t_us=sample.t_us + offset_us) if offset_us else sample

    def counts(self) -> dict[str, int]:
        counts = {name: count for aid in self.all for name, count in aid.named_counts()}
        return {**counts, **self.markers.solver_counts()}


def _of_table(vehicle: Vehicle, floor_depth_m: float | None) -> Iterator[ScalarAid[Any]]:
    """Those that nothing but the table of sensors names."""
    for kind in _TABLED:
        yield kind(vehicle, floor_depth_m)


def _classes() -> Iterator[Callable[[Vehicle, float | None], ScalarAid[Any]]]:
    for row in SENSOR_ROWS:
        if row.aid:
            module, _, name = row.aid.partition(":")
            yield getattr(import_module(module), name)


_TABLED = tuple(_classes())
"""Imported with this module: a process that is forked from another has them then."""
