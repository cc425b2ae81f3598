"""Draws docs/figures/frames.png: ``python docs/frame_figures.py``."""

import math
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

PAGE = Path(__file__).resolve().parent
WORLD, BODY, CAMERA, HULL = "#1f4e79", "#b85c00", "#3a7d44", "#9aa5b1"


def arrow(axes: Any, at: tuple[float, float], to: tuple[float, float], text: str, colour: str) -> None:
    """An axis of a frame from ``at`` along ``to``, named at its tip."""
    end = (at[0] + to[0], at[1] + to[1])
    axes.annotate("", end, at, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2.0})
    length = math.hypot(*to)
    wide = 0.16 + 0.14 * abs(to[0]) / length  # texts are wider than high
    place = (end[0] + wide * to[0] / length, end[1] + 0.16 * to[1] / length)
    axes.text(*place, text, color=colour, ha="center", va="center", fontsize=10)


def hull(axes: Any, at: tuple[float, float], length: float, width: float, turned_rad: float) -> None:
    corners = [(0.5, 0.0), (0.3, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.3, -0.5)]
    c, s = math.cos(turned_rad), math.sin(turned_rad)
    x = [at[0] + c * length * a - s * width * b for a, b in corners]
    y = [at[1] + s * length * a + c * width * b for a, b in corners]
    axes.fill(x, y, facecolor=HULL, alpha=0.45, edgecolor=HULL)


def from_above(axes: Any) -> None:
    """North up, east to the right, yaw clockwise."""
    axes.set_title("from above", fontsize=11)
    arrow(axes, (0.0, 0.0), (0.0, 0.8), "x north", WORLD)
    arrow(axes, (0.0, 0.0), (0.8, 0.0), "y east", WORLD)
    axes.text(-0.12, -0.16, "ned: origin at the surface", color=WORLD, fontsize=9)
    at, yaw = (1.5, 1.15), math.radians(50.0)
    ahead, right = (math.sin(yaw), math.cos(yaw)), (math.cos(yaw), -math.sin(yaw))
    hull(axes, at, 0.9, 0.5, 0.5 * math.pi - yaw)
    axes.plot([at[0], at[0]], [at[1], at[1] + 0.75], color=WORLD, lw=1.0, ls=":")
    turn = [math.radians(a) for a in range(51)]
    axes.plot([at[0] + 0.6 * math.sin(a) for a in turn], [at[1] + 0.6 * math.cos(a) for a in turn], color=BODY, lw=1.2)
    axes.text(at[0] + 0.3, at[1] + 0.72, "yaw", color=BODY, fontsize=9)
    arrow(axes, at, (0.85 * ahead[0], 0.85 * ahead[1]), "x ahead", BODY)
    arrow(axes, at, (0.75 * right[0], 0.75 * right[1]), "y starboard", BODY)
    axes.text(at[0] - 1.3, at[1] + 0.85, "frd: at the centre of gravity", color=BODY, fontsize=9)
    axes.set_xlim(-0.4, 2.9)
    axes.set_ylim(-0.4, 2.3)


def from_the_side(axes: Any) -> None:
    """Depth down; the camera looks down, its x to starboard and its y aft."""
    axes.set_title("from port", fontsize=11)
    axes.plot([-0.4, 2.9], [0.0, 0.0], color=WORLD, lw=1.0)
    axes.text(2.85, 0.06, "surface, z = 0", color=WORLD, fontsize=9, ha="right")
    axes.plot([-0.4, 2.9], [-2.1, -2.1], color=HULL, lw=3.0)
    axes.text(2.85, -2.04, "floor with markers", color="#5b6670", fontsize=9, ha="right")
    arrow(axes, (0.0, 0.0), (0.0, -0.8), "z down", WORLD)
    at, eye = (1.8, -0.9), (1.6, -1.12)
    hull(axes, at, 1.0, 0.42, math.pi)
    arrow(axes, at, (-0.9, 0.0), "x ahead", BODY)
    arrow(axes, at, (0.0, -0.75), "z", BODY)
    axes.plot([eye[0], eye[0] - 0.4], [eye[1], -2.1], color=CAMERA, lw=0.8, ls=":")
    axes.plot([eye[0], eye[0] + 0.4], [eye[1], -2.1], color=CAMERA, lw=0.8, ls=":")
    arrow(axes, eye, (0.0, -0.6), "z", CAMERA)
    arrow(axes, eye, (0.75, 0.0), "y aft", CAMERA)
    axes.plot(*eye, marker="o", ms=7, mfc="white", mec=CAMERA)
    axes.plot(*eye, marker="x", ms=5, color=CAMERA)
    axes.text(eye[0] - 0.08, eye[1] - 0.12, "cam: x to starboard", color=CAMERA, fontsize=9, ha="right")
    axes.set_xlim(-0.4, 2.9)
    axes.set_ylim(-2.3, 0.4)


def draw(path: Path) -> None:
    figure = Figure(figsize=(9.6, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, view in zip(figure.subplots(1, 2), (from_above, from_the_side), strict=True):
        view(axes)
        axes.set_aspect("equal")
        axes.axis("off")
    figure.savefig(path, dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    draw(PAGE / "figures" / "frames.png")
