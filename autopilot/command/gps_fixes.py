"""GPS in the local frame: fixes for the estimator, and the origin where nobody has set one."""

from collections.abc import Callable, Sequence

import numpy as np

from autopilot.core import operator_messages as notices
from autopilot.core.geodesy import GeodeticPosition, Origin, ned_from_geodetic, place_from_ned, refuse_place
from autopilot.core.messages import Event, NavHealth, NavState
from autopilot.core.samples import GpsSample, PlanarFixSample, Sample
from autopilot.mavlink.api import CommandReply, CommandResult

UNSET = Origin(lat_deg=0.0, lon_deg=0.0)
"""What ORIGIN_LAT and ORIGIN_LON are by default: in the Atlantic, where no vehicle of ours is."""
ORIGIN_SIGMA_M = 5.0
"""A fix of a larger standard deviation sets no origin."""
ORIGIN_COUNT = 25
"""Good fixes in a row before one sets the origin: five seconds, the first ones after a start are the worst."""


class GpsFixes:
    def __init__(self, set_origin: Callable[[GeodeticPosition], CommandReply]) -> None:
        self._set_origin = set_origin
        self._good = 0
        self._reported_far = self._denied = False
        self._events: list[Event] = []

    def take(
        self, samples: Sequence[Sample], origin: Origin, nav: NavState | None, *, armed: bool
    ) -> tuple[PlanarFixSample, ...]:
        """GPS samples in metres from the origin. While disarmed they may set it; then the estimate stays where it is
        in the local frame.
        """
        fixes = []
        for sample in samples:
            if not isinstance(sample, GpsSample) or not abs(sample.lat_deg) <= 90.0 or not abs(sample.lon_deg) <= 180.0:
                continue
            if origin == UNSET:
                if not armed:
                    self._offer_origin(sample, nav)
                continue
            refusal = refuse_place(origin, sample.lat_deg, sample.lon_deg)
            if refusal:
                self._report_far(sample.t_us, refusal)
                continue
            self._reported_far = False
            place = ned_from_geodetic(origin, sample.lat_deg, sample.lon_deg, origin.alt_m)[:2]
            fixes.append(PlanarFixSample(t_us=sample.t_us, pos_ned_m=np.array(place), sigma_m=sample.sigma_m))
        return tuple(fixes)

    def _offer_origin(self, sample: GpsSample, nav: NavState | None) -> None:
        self._good = self._good + 1 if sample.sigma_m <= ORIGIN_SIGMA_M else 0
        if self._good < ORIGIN_COUNT or self._denied:
            return
        here = GeodeticPosition(lat_deg=sample.lat_deg, lon_deg=sample.lon_deg, alt_m=sample.alt_m)
        known = nav is not None and nav.health is not NavHealth.INVALID
        north, east = nav.pos_ned_m[:2].tolist() if nav is not None and known else (0.0, 0.0)
        place = place_from_ned(here, -north, -east, 0.0)
        if place is None:
            return
        answer = self._set_origin(place)
        if answer.result is CommandResult.ACCEPTED:
            event = notices.ORIGIN_BY_GPS.event(sample.t_us, lat_deg=place.lat_deg, lon_deg=place.lon_deg)
        else:
            self._denied = True
            event = notices.GPS_ORIGIN_DENIED.event(sample.t_us, reason=answer.reason)
        self._events.append(event)

    def _report_far(self, t_us: int, refusal: str) -> None:
        if not self._reported_far:
            self._reported_far = True
            self._events.append(notices.GPS_FAR.event(t_us, reason=refusal))

    def take_events(self) -> list[Event]:
        """Messages to the operator since the last call."""
        events, self._events = self._events, []
        return events
