"""Interpretation of a file's variables as a current map: names, units, checks.

Two naming schemes. Local: ``current_north_m_s``, ``current_east_m_s`` and optionally ``current_down_m_s`` on the axes
``north_m``, ``east_m``, ``depth_m``, ``time_s``. Ocean models: u is EAST and v is NORTH (``water_u``/``water_v``
HYCOM, ``uo``/``vo`` CMEMS, ``u_eastward``/``v_northward`` ROMS, ``u``/``v``) on ``lat``, ``lon`` (also ``latitude``,
``lat_rho``, ...), ``depth``, ``time``. They may be mixed.
"""

import hashlib
import re
from collections.abc import Callable, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TypeAlias

import numpy as np

from autopilot.control.current.current_map import CurrentMap, MapNodes
from autopilot.control.current.current_tuning import MAP_READING
from autopilot.control.current.map_files import Variable, read_variables
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray

ToLocal: TypeAlias = Callable[[float, float], tuple[float, float]]
"""Latitude and longitude [deg] -> north and east [m] of the local frame."""

NORTH_NAMES = ("current_north_m_s", "water_v", "vo", "v_northward", "v")
EAST_NAMES = ("current_east_m_s", "water_u", "uo", "u_eastward", "u")
DOWN_NAMES = ("current_down_m_s",)
LAT_NAMES = ("lat", "latitude", "lat_deg", "lat_rho")
LON_NAMES = ("lon", "longitude", "lon_deg", "lon_rho")
DEPTH_NAMES = ("depth_m", "depth")
TIME_NAMES = ("time_s", "time", "ocean_time", "MT")


SECONDS_PER = {"s": 1.0, "sec": 1.0, "second": 1.0, "min": 60.0, "minute": 60.0, "h": 3600.0, "hr": 3600.0}
SECONDS_PER |= {"hour": 3600.0, "d": 86400.0, "day": 86400.0}
METRES_PER_S = {"": 1.0, "m/s": 1.0, "m s-1": 1.0, "m.s-1": 1.0, "meter second-1": 1.0, "cm/s": 0.01, "cm s-1": 0.01}
METRES_PER_S |= {"meters/second": 1.0, "metre second-1": 1.0, "cm.s-1": 0.01}


def load_current_map(path: Path, to_local: ToLocal | None = None, start_utc: datetime | None = None) -> CurrentMap:
    """Read and check a map.

    ``to_local`` places latitudes and longitudes. ``start_utc`` is the time of the service's zero for maps whose time
    counts from a date; None = their first frame. ConfigError names file, variable, value and remedy.
    """
    variables = read_variables(path)
    reader = _MapReader(path, variables, to_local, start_utc)
    return CurrentMap(reader.nodes(hashlib.sha256(path.read_bytes()).hexdigest()))


class _MapReader:
    """Conversion of one file to a map."""

    def __init__(
        self, path: Path, variables: Mapping[str, Variable], to_local: ToLocal | None, start_utc: datetime | None
    ) -> None:
        self._path = path
        self._variables = variables
        self._to_local = to_local
        self._start_utc = start_utc
        self._dimensions: list[str] = []
        """Names of the dimensions of time, depth, north, east; "" = not there or not named."""

    def nodes(self, digest: str) -> MapNodes:
        geodetic = "north_m" not in self._variables and self._find(LAT_NAMES) is not None
        time_s, depth_m = self._times(), self._depths()
        north_m, east_m = self._geodetic_axes() if geodetic else (self._metres("north_m"), self._metres("east_m"))
        axes = [time_s, depth_m, north_m, east_m]
        north, east = self._component(NORTH_NAMES, axes), self._component(EAST_NAMES, axes)
        down = self._component(DOWN_NAMES, axes) if self._find(DOWN_NAMES) else np.zeros_like(north)
        current = np.stack([north, east, down], axis=-1)
        return MapNodes(
            name=self._path.name,
            digest=digest,
            time_s=np.sort(axes[0]) if len(axes[0]) else np.zeros(1),
            depth_m=np.sort(axes[1]) if len(axes[1]) else np.zeros(1),
            north_m=np.sort(axes[2]),
            east_m=np.sort(axes[3]),
            current_ned_m_s=current,
            geodetic=geodetic,
        )

    def _refuse(self, text: str) -> ConfigError:
        return ConfigError(f"current map {self._path}: {text}")

    def _find(self, names: tuple[str, ...]) -> str | None:
        return next((name for name in names if name in self._variables), None)

    # Axes

    def _axis(self, name: str, values: FloatArray, least: int) -> FloatArray:
        """Finite, long enough and monotonic (up or down: currents are turned round with it)."""
        if len(values) < least:
            raise self._refuse(f"`{name}` has {len(values)} value(s), needs {least} or more; cut out a larger region")
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise self._refuse(f"`{name}`[{bad[0]}] is {values[bad[0]]}; an axis needs finite numbers")
        steps = np.diff(values)
        if len(steps) and not ((steps > 0.0).all() or (steps < 0.0).all()):
            k = int(np.flatnonzero(np.sign(steps) != np.sign(steps[0]) if steps[0] else steps == 0.0)[0])
            raise self._refuse(
                f"`{name}` is not monotonic: [{k}] = {values[k]:g}, [{k + 1}] = {values[k + 1]:g}; sort the axis"
            )
        return values

    def _one_dimensional(self, name: str) -> FloatArray:
        variable = self._variables[name]
        if variable.values.ndim != 1:
            raise self._refuse(f"`{name}` has {variable.values.ndim} dimensions, an axis has one; regrid the map")
        self._dimensions.append(variable.dimensions[0] if variable.dimensions else "")
        return variable.values

    def _metres(self, name: str) -> FloatArray:
        if name not in self._variables:
            raise self._refuse(
                f"variable `{name}` is missing; give `north_m` and `east_m` (local metres) or `lat` and `lon`"
            )
        return self._axis(name, self._one_dimensional(name), 2)

    def _times(self) -> FloatArray:
        """(k,) seconds of the service's clock, empty without a time axis."""
        name = self._find(TIME_NAMES)
        if name is None or self._variables[name].values.ndim == 0:
            self._dimensions.append("")
            return np.zeros(0)
        values = self._axis(name, self._one_dimensional(name), 1)
        unit, _, since = self._variables[name].attributes.get("units", "s").partition(" since ")
        factor = SECONDS_PER.get(unit.strip().lower().rstrip("s") or "s")
        if factor is None:
            raise self._refuse(f"`{name}` has the unit {unit!r}; use seconds, minutes, hours or days [since a date]")
        seconds: FloatArray = values * factor
        if not since:
            return seconds
        if self._start_utc is None:
            from_first: FloatArray = seconds - seconds.min()
            return from_first
        offset_s = (self._date(name, since) - self._start_utc).total_seconds()
        return seconds + offset_s

    def _date(self, name: str, text: str) -> datetime:
        numbers = [int(n) for n in re.findall(r"\d+", text.partition(".")[0])[:6]]
        try:
            return datetime(numbers[0], numbers[1], numbers[2], tzinfo=UTC) + timedelta(
                **dict(zip(("hours", "minutes", "seconds"), numbers[3:], strict=False))
            )
        except (IndexError, ValueError, OverflowError) as error:
            raise self._refuse(
                f"`{name}` counts since {text!r}, which is no date; write YYYY-MM-DD hh:mm:ss"
            ) from error

    def _depths(self) -> FloatArray:
        """(d,) metres below the surface, empty without a depth axis."""
        name = self._find(DEPTH_NAMES)
        if name is None or self._variables[name].values.ndim == 0:
            self._dimensions.append("")
            return np.zeros(0)
        values = self._axis(name, self._one_dimensional(name), 1)
        upwards = self._variables[name].attributes.get("positive", "down").lower() == "up"
        return -values if upwards else values

    def _geodetic_axes(self) -> tuple[FloatArray, FloatArray]:
        """Local axes of latitudes and longitudes; parallels are straight within the reach of the local frame."""
        lat_name, lon_name = self._find(LAT_NAMES), self._find(LON_NAMES)
        if lat_name is None or lon_name is None:
            raise self._refuse(f"`{lat_name or lon_name}` stands alone; give both latitude and longitude")
        if self._to_local is None:
            raise self._refuse(f"`{lat_name}`: latitudes need an origin; give `north_m` and `east_m` in local metres")
        lat, lon = self._row(lat_name, 0), self._row(lon_name, 1)
        lon = (lon + 180.0) % 360.0 - 180.0 if lon.max() > 180.0 else lon
        self._axis(lat_name, lat, 2)
        self._axis(lon_name, lon, 2)
        if np.abs(lat).max() > 90.0:
            raise self._refuse(f"`{lat_name}` reaches {np.abs(lat).max():g} degrees; latitudes end at 90")
        middle_lat, middle_lon = 0.5 * (lat[0] + lat[-1]), 0.5 * (lon[0] + lon[-1])
        north_m = np.array([self._to_local(float(x), float(middle_lon))[0] for x in lat])
        east_m = np.array([self._to_local(float(middle_lat), float(x))[1] for x in lon])
        return self._axis(lat_name, north_m, 2), self._axis(lon_name, east_m, 2)

    def _row(self, name: str, along: int) -> FloatArray:
        """A latitude or longitude axis; two-dimensional ones (ROMS) have to be rows and columns all the same."""
        variable = self._variables[name]
        if variable.values.ndim != 2:
            return self._one_dimensional(name)
        self._dimensions.append(variable.dimensions[along] if variable.dimensions else "")
        line: FloatArray = variable.values[:, 0] if along == 0 else variable.values[0]
        spread = variable.values - (line[:, None] if along == 0 else line)
        if not np.abs(spread).max() * MAP_READING.metres_per_degree < MAP_READING.rectilinear_m:
            raise self._refuse(f"`{name}` is curvilinear: rows and columns are not parallel to it; regrid the map")
        return line

    # Currents

    def _component(self, names: tuple[str, ...], axes: list[FloatArray]) -> FloatArray:
        """One component (k, d, a, b) in m/s along ascending axes."""
        name = self._find(names)
        if name is None:
            raise self._refuse(f"variable `{names[0]}` is missing (or {', '.join(names[1:])}); add or rename it")
        variable = self._variables[name]
        values = self._ordered(name, variable, [len(axis) for axis in axes])
        unit = variable.attributes.get("units", "").strip()
        if unit not in METRES_PER_S:
            raise self._refuse(f"`{name}` has the unit {unit!r}; use m/s or cm/s")
        values = values * METRES_PER_S[unit]
        for i, axis in enumerate(axes):
            if len(axis) > 1 and axis[0] > axis[-1]:
                values = np.flip(values, axis=i)
        fastest = np.nanmax(np.abs(values)) if np.isfinite(values).any() else 0.0
        if fastest > MAP_READING.plausible_m_s:
            raise self._refuse(
                f"`{name}` reaches {fastest:g} m/s, {MAP_READING.plausible_m_s:g} is plausible; correct the units,"
                " or mark fill values by NaN or _FillValue"
            )
        return values

    def _ordered(self, name: str, variable: Variable, lengths: list[int]) -> FloatArray:
        """The values with the dimensions time, depth, north, east, missing ones of length 1."""
        values = variable.values
        wanted = [i for i in range(4) if lengths[i]]
        if variable.dimensions and all(self._dimensions[i] for i in wanted):
            # Dimensions that no axis goes with (an ensemble of one) may only be of length 1.
            extra = [k for k, d in enumerate(variable.dimensions) if d not in [self._dimensions[i] for i in wanted]]
            if all(values.shape[k] == 1 for k in extra):
                kept = [d for k, d in enumerate(variable.dimensions) if k not in extra]
                values = values.squeeze(axis=tuple(extra))
                order = [kept.index(self._dimensions[i]) for i in wanted if self._dimensions[i] in kept]
                if len(order) == len(kept):
                    wanted = [i for i in wanted if self._dimensions[i] in kept]
                    values = values.transpose(order)
        expected = tuple(lengths[i] for i in wanted)
        if values.shape != expected:
            axes = ", ".join(("time", "depth", "north", "east")[i] for i in wanted)
            raise self._refuse(
                f"`{name}` has the shape {tuple(variable.values.shape)}, its axes ({axes}) ask for {expected};"
                " reorder or complete it"
            )
        full = [lengths[i] if i in wanted else 1 for i in range(4)]
        # A variable without an axis is constant along it.
        return np.broadcast_to(values.reshape(full), [max(length, 1) for length in lengths])
