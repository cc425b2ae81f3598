"""Figures of the estimator's benchmark: accuracy, losses and cost of pictures against height, one line per water;
errors of flights that nobody has calibrated, in standard deviations."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np

from tests.bench.estimator_figures import GAUSS_3_SIGMA
from tests.bench.estimator_images import (
    CLEAR_BAR_M,
    GOOD_HEIGHTS_M,
    TIME_BAR_S,
    TURBID_BAR_M,
    YAW_BAR_RAD,
    ImageRow,
)
from tests.bench.laid_maps import OverFloor

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

PANELS = (
    ("xy_mm", "horizontal error, rms [mm]", True),
    ("z_mm", "vertical error, rms [mm]", True),
    ("yaw_deg", "heading error, rms [deg]", True),
    ("lost_pct", "lost of the pictures with a marker [%]", False),
    ("laser_mm", "laser range, rms [mm]", True),
    ("cpu_ms", "detection, median CPU time [ms]", False),
)
"""Field, label, logarithmic."""
STATES = (("north [mm]", 1e3), ("east [mm]", 1e3), ("down [mm]", 1e3), ("heading [deg]", 180.0 / np.pi))
SHOWN_FLIGHTS = 6
"""Lines beyond that cannot be told apart."""


def draw_honesty(runs: Sequence[OverFloor], folder: str) -> str:
    """Write ``estimator-honesty.png`` (error of each state over time, with its three standard deviations) into the
    folder and return its path."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    path = Path(folder) / "estimator-honesty.png"
    figure, axes = plt.subplots(2, 2, figsize=(9.0, 5.5), sharex=True)
    for column, (axis, (label, scale)) in enumerate(zip(axes.flat, STATES, strict=True)):
        for number, run in enumerate(runs[:SHOWN_FLIGHTS]):
            sigma = GAUSS_3_SIGMA * scale * np.sqrt(run.variance[:, column])
            axis.plot(run.t_s, scale * run.error[:, column], color=f"C{number}", linewidth=1.0)
            for side in (-1.0, 1.0):
                axis.plot(run.t_s, side * sigma, color=f"C{number}", linestyle="--", linewidth=0.7)
        axis.set_ylabel(f"error {label}")
        axis.grid(alpha=0.3)
    for axis in axes[1]:
        axis.set_xlabel("time [s]")
    figure.suptitle("Estimate minus truth, and three standard deviations (dashed); one colour per flight", fontsize=9)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return str(path)


def draw_images(rows: Sequence[ImageRow], folder: str) -> str:
    """Write ``estimator-images.png`` into the folder and return its path."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    path = Path(folder) / "estimator-images.png"
    figure, axes = plt.subplots(2, 3, figsize=(13.0, 7.5), sharex=True)
    waters = sorted({row.turbidity_1_m for row in rows})
    colours = plt.colormaps["viridis"](np.linspace(0.0, 0.85, len(waters)))
    for axis, (field, label, logarithmic) in zip(axes.flat, PANELS, strict=True):
        for turbidity, colour in zip(waters, colours, strict=True):
            mine = [row for row in rows if row.turbidity_1_m == turbidity]
            axis.plot(
                [row.height_m for row in mine],
                [getattr(row, field) for row in mine],
                "o-",
                color=colour,
                label=f"{turbidity:g} 1/m",
            )
        if logarithmic:
            axis.set_yscale("log")
        else:
            axis.set_ylim(0.0, max(10.0, *(1.1 * getattr(row, field) for row in rows)))
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    _bars(axes)
    for axis in axes[1]:
        axis.set_xlabel("height of the camera over the floor [m]")
    axes[0, 0].legend(title="turbidity", fontsize="small")
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return str(path)


def _bars(axes: "np.ndarray[tuple[int, ...], np.dtype[np.object_]]") -> None:
    for axis in axes[0, :2]:
        _bar(axis, 1e3 * CLEAR_BAR_M, "up to 1 1/m")
        _bar(axis, 1e3 * TURBID_BAR_M, "2 1/m")
    _bar(axes[0, 2], float(np.degrees(YAW_BAR_RAD)), "up to 1 1/m")
    axes[1, 2].axhline(1e3 * TIME_BAR_S, color="tab:red", linestyle="--", linewidth=1.0)


def _bar(axis: Axes, level: float, text: str) -> None:
    axis.plot(GOOD_HEIGHTS_M, (level, level), color="tab:red", linestyle="--", linewidth=1.0)
    axis.annotate(f"asked, {text}", (GOOD_HEIGHTS_M[1], level), color="tab:red", fontsize=7, ha="right", va="bottom")
