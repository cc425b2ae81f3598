"""The aiding sources of a vehicle, each a class in its ``measure_*.py``: here they are listed, and found by sample."""

from dataclasses import replace
from typing import Any

from autopilot.core.samples import Sample
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.aiding import Aid, ScalarAid
from autopilot.estimator.fix_aid import FixAid
from autopilot.estimator.markers_pose import MarkerSolver
from autopilot.estimator.measure_depth import DepthAid
from autopilot.estimator.measure_external import ExternalAid
from autopilot.estimator.measure_heading import HeadingAid
from autopilot.estimator.measure_laser import LaserAid
from autopilot.estimator.measure_markers import MarkersAid
from autopilot.estimator.measure_model import ModelAid
from autopilot.estimator.measure_velocity import VelocityAid
from autopilot.estimator.options import EstimatorOptions
from autopilot.estimator.pictures import Pictures


class Sources:
    """All aiding sources of one estimator."""

    def __init__(
        self, vehicle: Vehicle, solver: MarkerSolver | None, floor_depth_m: float | None, options: EstimatorOptions
    ) -> None:
        self.pictures = Pictures(vehicle, solver)
        self.markers, self.external = MarkersAid(self.pictures), ExternalAid(vehicle)
        self.heading, self.model = HeadingAid(), ModelAid(vehicle, options)
        self.velocity = VelocityAid(vehicle)
        self.all: tuple[Aid, ...] = (
            self.markers,
            LaserAid(vehicle, self.pictures, floor_depth_m),
            self.heading,
            self.model,
            DepthAid(vehicle),
            self.velocity,
            self.external,
        )
        """In the order of their counts."""
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
        """Time of validity of the newest fix that has been used, None before the first."""
        return max((aid.last_fused_us for aid in self.fixes if aid.last_fused_us is not None), default=None)

    def on_our_clock(self, sample: Sample) -> Sample:
        """The sample with its sensor's time offset taken off."""
        offset_us = self.aid_of[type(sample)].offset_us
        return replace(sample, t_us=sample.t_us + offset_us) if offset_us else sample

    def counts(self) -> dict[str, int]:
        """Of all sources, as ``sensor.what``."""
        counts = {name: count for aid in self.all for name, count in aid.named_counts()}
        return {**counts, **self.markers.solver_counts()}
