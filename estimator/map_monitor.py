"""In-flight check of the marker map: moved markers, swapped ids, displaced sheets, printed size."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from autopilot.core import operator_messages as notices
from autopilot.core.frames import FloatArray
from autopilot.core.map_errors import STATES
from autopilot.core.markers import ID_SPAN, MarkerMap
from autopilot.core.messages import NavDoubt
from autopilot.estimator.estimator_tuning import CAMERA_MONITOR, MAP_MONITOR
from autopilot.estimator.gauge import KNOWN_FRACTION, Gauge
from autopilot.estimator.history import Node
from autopilot.estimator.measure_pose import MarkerOutlier, PoseFix
from autopilot.estimator.monitor import Monitor
from autopilot.estimator.states import DOWN, EAST, NORTH, SheetStates


@dataclass
class _MisplacedMarker:
    """Observed position of a displaced marker."""

    count: int = 0
    north_m: float = 0.0
    east_m: float = 0.0
    scatter_m2: float = 0.0
    reported: bool = False

    def add(self, north_m: float, east_m: float) -> None:
        """One more sighting; begins anew when the place is another one."""
        off = math.hypot(north_m - self.north_m, east_m - self.east_m)
        if self.count and off > 5.0 * MAP_MONITOR.same_m:
            self.count, self.scatter_m2 = 0, 0.0
        self.count += 1
        gain = 1.0 / min(self.count, 50)
        self.scatter_m2 += gain * ((off * off if self.count > 1 else 0.0) - self.scatter_m2)
        self.north_m += gain * (north_m - self.north_m)
        self.east_m += gain * (east_m - self.east_m)

    @property
    def steady(self) -> bool:
        """Whether it is a place and no accident."""
        return self.count >= MAP_MONITOR.sightings and self.scatter_m2 < MAP_MONITOR.same_m * MAP_MONITOR.same_m


class MapMonitor(Monitor):
    def __init__(self, markers: MarkerMap) -> None:
        super().__init__()
        self._markers = markers
        errors = markers.errors
        self._frame = None if errors is None or not any(errors.frame_sigma) else errors.frame_sigma
        self._gauge = None if errors is None else Gauge(errors)
        self._middle = markers.centers_ned_m.mean(axis=0).tolist()
        self._depth_variance_m2, self._scale_sigma = markers.depth_sigma_m**2, markers.scale_sigma
        self._misplaced: dict[tuple[int, int], _MisplacedMarker] = {}
        self._strained: dict[int, deque[int]] = {}
        self._reported_sheets: set[int] = set()
        self._found_us: int | None = None
        self._seen_print: deque[float] = deque(maxlen=CAMERA_MONITOR.focal_estimates)
        self.print_error = 0.0
        """Share by which markers are taken to be larger than the map has them."""
        self._print_reported = False

    def systematic_variance(self, t_us: int, newest: Node) -> FloatArray:
        """See :class:`Monitor`: variance of the whole map at the state's position in addition to the filter's;
        negative where sheets were laid better than stated.
        """
        x = newest.state.x
        more = [0.0] * 4 if self._gauge is None else self._gauge.more_variance(x)
        more[2] += self._depth_variance_m2 + (self._scale_sigma * (self._middle[2] - x.item(DOWN))) ** 2
        if self._frame is not None:
            across, down, turn = self._frame
            north, east = x.item(NORTH) - self._middle[0], x.item(EAST) - self._middle[1]
            frame = (
                across * across + (turn * east) ** 2,
                across * across + (turn * north) ** 2,
                down * down,
                turn * turn,
            )
            more = [each + of_frame for each, of_frame in zip(more, frame, strict=True)]
        return np.array(more)

    def doubts(self, t_us: int, newest: Node) -> tuple[NavDoubt, ...]:
        found_of_late = self._found_us is not None and t_us - self._found_us <= MAP_MONITOR.held_us
        return (NavDoubt.MAP,) if found_of_late else ()

    def check_outliers(self, fix: PoseFix) -> None:
        """One pose that was used, with the markers that did not fit to it."""
        for outlier in fix.outliers:
            place = self._misplaced.setdefault((outlier.code, outlier.marker), _MisplacedMarker())
            place.add(outlier.north_m, outlier.east_m)
            if place.steady and not place.reported:
                self._judge(fix.t_us, outlier, place)
            if place.steady and place.reported:  # in doubt once it has a name
                self._found_us = fix.t_us

    def check_print(self, fix: PoseFix) -> None:
        """The size of the printed markers by one more picture."""
        if fix.print_error is None:
            return
        error, sigma = fix.print_error
        self._seen_print.append(self.print_error + error)
        if len(self._seen_print) < CAMERA_MONITOR.focal_estimates:
            return
        off = sum(self._seen_print) / len(self._seen_print) - self.print_error
        if abs(off) > (CAMERA_MONITOR.doubted if self.print_error else CAMERA_MONITOR.focal_sigmas) * sigma:
            self.print_error += off
            self._seen_print.clear()
        elif self.print_error and not self._print_reported:
            self._print_reported = True
            percent, what = 100.0 * abs(self.print_error), "larger" if self.print_error > 0.0 else "smaller"
            self._notify(fix.t_us, notices.PRINT_OFF(percent=percent, what=what).text)

    def loosened(self, fix: PoseFix, explaining: int | None) -> list[int]:
        """Sheets whose places become suspect by one picture more. ``explaining``: the one that would explain why it was
        rejected, None = it was not, or none would."""
        result = []
        for sheet in {*fix.strained, *(() if explaining is None else (explaining,))}:
            times = self._strained.setdefault(sheet, deque(maxlen=MAP_MONITOR.strains))
            times.append(fix.t_us)
            if len(times) == MAP_MONITOR.strains and fix.t_us - times[0] <= MAP_MONITOR.strains_us:
                times.clear()
                result.append(sheet)
        return result

    def laid(self, sheet: int) -> tuple[float, ...]:
        """Laying accuracy of a sheet (4,)."""
        errors = self._markers.errors
        assert errors is not None
        return tuple(errors.sigma[sheet].tolist())

    def check_sheets(self, t_us: int, states: SheetStates | None, sheets: tuple[int, ...]) -> None:
        """Check the sheets of an image for offsets beyond their stated accuracy."""
        errors = self._markers.errors
        if errors is None or states is None:
            return
        if self._gauge is not None:
            self._gauge.update(states)
        for sheet in sheets:
            if sheet in self._reported_sheets or sheet not in states.which:
                continue
            k = STATES * states.which.index(sheet)
            offset, variance = states.offset[k : k + STATES], states.cov.diagonal()[k : k + STATES]
            prior = errors.sigma[sheet] ** 2
            # Its heading is known from the first pictures on; its place is never known better than the map's frame.
            known = variance[3] < KNOWN_FRACTION * prior[3]
            if known and float((offset * offset / (prior + variance)).sum()) > MAP_MONITOR.off_distance2:
                self._reported_sheets.add(sheet)
                off_mm = 1e3 * math.hypot(float(offset[0]), float(offset[1]))
                turn_deg = math.degrees(float(offset[3]))
                found = notices.SHEET_OFF(name=errors.names[sheet], off_mm=off_mm, turn_deg=turn_deg)
                self._notify(t_us, found.text)

    def _judge(self, t_us: int, outlier: MarkerOutlier, place: _MisplacedMarker) -> None:
        markers = self._markers
        apart = np.hypot(markers.centers_ned_m[:, 0] - place.north_m, markers.centers_ned_m[:, 1] - place.east_m)
        nearest = int(apart.argmin())
        name = outlier.code % ID_SPAN
        if float(apart[nearest]) < MAP_MONITOR.taken_m and int(markers.ids[nearest]) != outlier.code:
            other = int(markers.ids[nearest])
            partner = self._at(other, outlier.marker)
            if partner is not None:
                partner.reported = place.reported = True
                self._notify(t_us, notices.MARKERS_SWAPPED(number=name, other=other % ID_SPAN).text)
            elif place.count >= MAP_MONITOR.alone:
                place.reported = True
                self._notify(t_us, notices.MARKER_TAKES_PLACE(number=name, other=other % ID_SPAN).text)
            return
        place.reported = True
        if outlier.marker < 0:
            self._notify(t_us, notices.MARKER_UNKNOWN(number=name).text)
            return
        if outlier.quarters:
            self._notify(t_us, notices.MARKER_TURNED(number=name, turn_deg=90 * outlier.quarters).text)
            return
        north_m = place.north_m - float(markers.centers_ned_m[outlier.marker, 0])
        east_m = place.east_m - float(markers.centers_ned_m[outlier.marker, 1])
        direction = _direction(north_m, east_m)
        off_cm = 100.0 * math.hypot(north_m, east_m)
        self._notify(t_us, notices.MARKER_OFF(number=name, off_cm=off_cm, way=direction).text)

    def _at(self, code: int, index: int) -> _MisplacedMarker | None:
        """Strays of a marker seen where the map has marker ``index``."""
        if index < 0:
            return None
        center = self._markers.centers_ned_m[index]
        for (other, _), place in self._misplaced.items():
            near = math.hypot(place.north_m - float(center[0]), place.east_m - float(center[1])) < MAP_MONITOR.taken_m
            if other == code and near and place.count >= MAP_MONITOR.sightings // 2:
                return place
        return None

    def _notify(self, t_us: int, text: str) -> None:
        self._found_us = t_us
        self._texts.append(text)


def _direction(north_m: float, east_m: float) -> str:
    eighth = round(math.atan2(east_m, north_m) / (math.pi / 4.0)) % 8
    return ("north", "NE", "east", "SE", "south", "SW", "west", "NW")[eighth]
