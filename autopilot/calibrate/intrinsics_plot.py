"""One picture of a camera calibration: where corners were found, how far off they are, view by view."""

import io
import math
from pathlib import Path

import matplotlib
import numpy as np

from autopilot.calibrate.calibrate_tuning import INTRINSICS
from autopilot.calibrate.intrinsics import Coverage, Intrinsics
from autopilot.core.disk import write_result

ARROW_PX = 12.0
"""Drawn length of a residual of the size of the rms."""


def write_plot(result: Intrinsics, spread: Coverage, target: Path) -> Path:
    """Draw corners with residuals, their scatter, rms per view and tilt of the board as a PNG."""
    matplotlib.use("Agg")
    from matplotlib import patches
    from matplotlib import pyplot as plt

    pixels = np.concatenate([view.pixels for view in result.views])
    residual = np.concatenate(result.residual_px)
    times = 10.0 ** np.floor(np.log10(ARROW_PX / max(result.rms_px, 1e-4)))
    times *= 5.0 if ARROW_PX / max(result.rms_px, 1e-4) > 5.0 * times else 1.0
    figure, axes = plt.subplots(2, 2, figsize=(11.0, 8.6), layout="constrained")
    figure.suptitle(
        f"{len(result.views)} views, {len(pixels)} corners, rms {result.rms_px:.3f} px, coverage {spread.coverage:.0%}"
    )
    image = axes[0, 0]
    image.set_title(f"corners and residuals, drawn {times:.0f} times too large")
    image.imshow(
        spread.cells, extent=(0, result.width_px, result.height_px, 0), cmap="Greens", alpha=0.45, aspect="equal"
    )
    length = np.hypot(residual[:, 0], residual[:, 1])
    arrows = image.quiver(
        pixels[:, 0], pixels[:, 1], residual[:, 0], residual[:, 1], length, angles="xy", scale_units="xy",
        scale=1.0 / times, width=0.002, cmap="viridis",
    )  # fmt: skip
    figure.colorbar(arrows, ax=image, label="residual [px]", shrink=0.8)
    image.plot(*result.values[2:4], "r+", markersize=12)
    image.set(xlabel="x [px]", ylabel="y [px]", xlim=(0, result.width_px), ylim=(result.height_px, 0))
    image.set_xticks(np.linspace(0, result.width_px, INTRINSICS.cells[0] + 1))
    image.set_yticks(np.linspace(0, result.height_px, INTRINSICS.cells[1] + 1))
    image.tick_params(labelsize=7)

    cloud = axes[0, 1]
    cloud.set_title("reprojection error")
    cloud.scatter(residual[:, 0], residual[:, 1], s=3, c=length, cmap="viridis")
    reach = max(0.1, 1.1 * float(np.abs(residual).max()))
    for radius in (result.rms_px, 3.0 * result.rms_px):
        cloud.add_patch(patches.Circle((0.0, 0.0), radius, fill=False, color="red", linestyle="--", linewidth=0.8))
    cloud.set(xlabel="x [px]", ylabel="y [px]", xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    cloud.grid(alpha=0.3)

    bars = axes[1, 0]
    bars.set_title("rms of each view")
    bars.bar(range(len(result.views)), result.view_rms_px)
    bars.axhline(result.rms_px, color="red", linestyle="--", linewidth=0.8)
    bars.set(xlabel="view", ylabel="rms [px]")

    tilt = axes[1, 1]
    tilt.set_title("tilt of the board against the optical axis")
    normal = result.normals_cam
    tilt.plot(
        np.degrees(np.arctan2(normal[:, 0], normal[:, 2])), np.degrees(np.arctan2(normal[:, 1], normal[:, 2])), "o"
    )
    most = max(20.0, 1.1 * math.degrees(float(spread.tilt_rad.max())))
    tilt.set(xlabel="about y [deg]", ylabel="about x [deg]", xlim=(-most, most), ylim=(-most, most), aspect="equal")
    tilt.grid(alpha=0.3)
    picture = io.BytesIO()
    figure.savefig(picture, dpi=110, format="png")
    plt.close(figure)
    write_result(target, picture.getvalue(), folder=True)
    return target
