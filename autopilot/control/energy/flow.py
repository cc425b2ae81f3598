"""Snapshot of the current for a planner: samples on a grid, cubic interpolation.

With a snapshot a request is pure data: later changes of the forecast do not change the answer.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from autopilot.control.current.currents import CurrentForecast
from autopilot.control.energy.energy_tuning import FLOW
from autopilot.core.frames import FloatArray
from autopilot.core.free_space import Area, workspace_of
from autopilot.core.geometry import Fence
from autopilot.core.messages import NavState
from autopilot.core.shapes import bounding_box


def area_of(fence: Fence, places_ned_m: FloatArray) -> Area:
    """Area of possible paths between ``places_ned_m`` (m, 2): the workspace; in open water their bounding box with a
    border.
    """
    workspace = workspace_of(fence)
    if workspace is not None and bool((workspace.high_m > workspace.low_m).all()):
        return workspace
    span = float(np.hypot(*(places_ned_m.max(axis=0) - places_ned_m.min(axis=0))))
    border = FLOW.open_water_border_m + FLOW.open_water_fraction * span
    points = np.concatenate([places_ned_m, *(np.stack(bounding_box(shape)) for shape in fence.exclusions)])
    return Area(low_m=points.min(axis=0) - border, high_m=points.max(axis=0) + border)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FlowSamples:
    """Samples of the present forecast over an area."""

    north_m: FloatArray
    """(a,)"""
    east_m: FloatArray
    """(b,)"""
    current_ned_m_s: FloatArray
    """(a, b, 3)"""


def sample_flow(forecast: CurrentForecast, nav: NavState, area: Area, depth_m: float) -> FlowSamples:
    """Ask the forecast for the current all over an area at one depth, at the time of ``nav``."""
    size = np.maximum(area.high_m - area.low_m, 1e-3)
    cell = max(FLOW.finest_sample_m, math.sqrt(float(size[0] * size[1]) / FLOW.max_samples))
    axes = [
        np.linspace(low, high, max(FLOW.least_samples, math.ceil(length / cell) + 1))
        for low, high, length in zip(area.low_m, area.high_m, size, strict=True)
    ]
    north, east = np.meshgrid(*axes, indexing="ij")
    places = np.stack([north.ravel(), east.ravel(), np.full(north.size, depth_m)], axis=1)
    out = np.empty_like(places)
    forecast.fill(nav, places, np.zeros(len(places)), out)
    return FlowSamples(north_m=axes[0], east_m=axes[1], current_ned_m_s=out.reshape(*north.shape, 3))


def _spline(samples: FlowSamples, axis: int) -> Any:
    # Imported here: a controller that never plans by energy starts without it.
    from scipy.interpolate import RectBivariateSpline

    return RectBivariateSpline(samples.north_m, samples.east_m, samples.current_ned_m_s[..., axis])


class FlowField:
    """Current and its gradient anywhere; beyond the samples as at their border."""

    def __init__(self, samples: FlowSamples) -> None:
        values = samples.current_ned_m_s
        self._mean: FloatArray = values.reshape(-1, 3).mean(axis=0)
        self.uniform = bool(np.abs(values - self._mean).max() < FLOW.uniform_m_s)
        """The same everywhere."""
        self._splines = () if self.uniform else tuple(_spline(samples, i) for i in range(2))

    def current(self, places_ned_m: FloatArray) -> FloatArray:
        """(m, 3) at places (m, 2)."""
        out = np.tile(self._mean, (len(places_ned_m), 1))
        for i, spline in enumerate(self._splines):
            out[:, i] = spline.ev(places_ned_m[:, 0], places_ned_m[:, 1])
        return out

    def gradient(self, places_ned_m: FloatArray) -> FloatArray:
        """(m, 4) d c_n / dx, d c_n / dy, d c_e / dx, d c_e / dy [1/s]."""
        out = np.zeros((len(places_ned_m), 4))
        for i, spline in enumerate(self._splines):
            for j, order in enumerate(((1, 0), (0, 1))):
                out[:, 2 * i + j] = spline.ev(places_ned_m[:, 0], places_ned_m[:, 1], dx=order[0], dy=order[1])
        return out
