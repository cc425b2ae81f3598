"""Pictures of a calibration board as a camera with known intrinsics takes them."""

from typing import Any

import cv2
import numpy as np

from autopilot.calibrate.boards import CalibrationBoard
from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray

PX_PER_M = 8000
FINE = 2
"""Pixels are averaged over FINE x FINE samples."""


def camera(
    values: tuple[float, ...] = (520.0, 522.0, 322.0, 238.0, -0.12, 0.06, 0.001, -0.0015, -0.01),
) -> CameraModel:
    """fx fy cx cy k1 k2 p1 p2 k3, 640 x 480."""
    fx, fy, cx, cy, *distortion = values
    return CameraModel(
        width_px=640,
        height_px=480,
        focal_px=(fx, fy),
        center_px=(cx, cy),
        distortion=tuple(distortion),  # type: ignore[arg-type]
        position_frd_m=np.zeros(3),
        laser_offset_cam_m=np.array([0.05, 0.0, 0.0]),
    )


class Printed:
    """A board as it was printed, with white round it, and rays of a camera computed once."""

    def __init__(self, board: CalibrationBoard, model: CameraModel) -> None:
        self.board, self.model = board, model
        width_m, height_m = board.spec.size_m
        self.margin_m = 0.02
        shape = tuple(round((side + 2 * self.margin_m) * PX_PER_M) for side in (height_m, width_m))
        sheet = np.full(shape, 235, dtype=np.uint8)
        for left, top, width, height in board.black_rectangles_m():
            x0, y0 = (round((v + self.margin_m) * PX_PER_M) for v in (left, top))
            x1, y1 = (round((v + self.margin_m) * PX_PER_M) for v in (left + width, top + height))
            sheet[y0:y1, x0:x1] = 25
        self.sheet = cv2.GaussianBlur(sheet, (0, 0), 2.0)
        fine = (np.arange(FINE) + 0.5) / FINE - 0.5
        columns = (np.arange(model.width_px)[:, None] + fine).ravel()
        rows = (np.arange(model.height_px)[:, None] + fine).ravel()
        self.rays = model.normalized(np.stack(np.meshgrid(columns, rows), axis=-1))

    def picture(self, turn: FloatArray, shift_m: FloatArray, rng: np.random.Generator, noise: float = 2.0) -> Any:
        """The board with this rotation vector (board to camera) and place of its top left corner, grey."""
        r = np.asarray(cv2.Rodrigues(np.asarray(turn, dtype=float))[0])
        homography = np.linalg.inv(np.column_stack((r[:, 0], r[:, 1], shift_m)))
        hit = np.dstack((self.rays, np.ones(self.rays.shape[:2]))) @ homography.T
        where = (hit[..., :2] / hit[..., 2:] + self.margin_m) * PX_PER_M - 0.5
        fine = cv2.remap(
            self.sheet,
            where.astype(np.float32), None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(120,),
        )  # fmt: skip
        grey = cv2.resize(fine, (self.model.width_px, self.model.height_px), interpolation=cv2.INTER_AREA)
        grey = cv2.GaussianBlur(grey, (0, 0), 0.7).astype(float)
        return np.clip(np.rint(grey + noise * rng.standard_normal(grey.shape)), 0, 255).astype(np.uint8)

    def pictures(self, count: int, rng: np.random.Generator, tilt_rad: float = 0.5) -> list[tuple[str, Any]]:
        """Views from different places and angles."""
        centre = np.array([*self.board.spec.size_m, 0.0]) / 2
        out = []
        for number in range(count):
            about = rng.uniform(0.0, 2.0 * np.pi)
            turn = rng.uniform(0.3, 1.0) * tilt_rad * np.array([np.cos(about), np.sin(about), 0.0])
            turn[2] = rng.uniform(-0.4, 0.4)
            r = np.asarray(cv2.Rodrigues(turn)[0])
            z = rng.uniform(0.3, 0.5)
            aim = z * np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.22, 0.22), 1.0])
            out.append((f"view{number:02d}.png", self.picture(turn, aim - r @ centre, rng)))
        return out
