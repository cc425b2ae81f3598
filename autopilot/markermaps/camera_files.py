"""Camera calibration files of OpenCV and ROS (YAML), for pictures of any camera."""

import re
from pathlib import Path

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.errors import ConfigError

MATRICES = {"matrix": ("camera_matrix", "K"), "distortion": ("distortion_coefficients", "D")}
FISHEYE = ("fisheye", "equidistant")
BROWN = ("plumb_bob", "pinhole", "radtan", "brown")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def load_camera(path: Path, fisheye: bool = False) -> CameraModel:
    """Camera of a file, at the origin of its own frame. ``fisheye``: default for files that do not name a model.
    ConfigError names a missing or unusable key.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: is no camera file ({error}); give OpenCV's or ROS's YAML") from error
    width, height = (_whole(path, text, f"image_{side}") for side in ("width", "height"))
    matrix = _values(path, text, "matrix")
    if len(matrix) != 9 or min(matrix[0], matrix[4]) <= 0.0:
        raise ConfigError(f"{path}: `camera_matrix` is not 3 x 3 with focal lengths above 0; calibrate the camera")
    model = re.search(r"^\s*(?:distortion_model|camera_model)\s*:\s*\"?(\w+)", text, re.MULTILINE)
    if model is not None and model[1].lower() not in (*FISHEYE, *BROWN):
        known = ", ".join((*BROWN, *FISHEYE))
        raise ConfigError(f"{path}: distortion model {model[1]!r} cannot be used; calibrate with one of {known}")
    fisheye = fisheye if model is None else model[1].lower() in FISHEYE
    distortion = _values(path, text, "distortion")
    most = 4 if fisheye else 5
    if np.any(distortion[most:]):
        raise ConfigError(
            f"{path}: has {len(distortion)} distortion coefficients; a {'fisheye' if fisheye else 'pinhole'} camera can"
            f" have {most} here: calibrate without the rational model, or say whether it is a fisheye (--fisheye)"
        )
    k1, k2, k3, k4, k5 = (*distortion[:most], *[0.0] * 5)[:5]
    return CameraModel(
        width_px=width,
        height_px=height,
        focal_px=(matrix[0], matrix[4]),
        center_px=(matrix[2], matrix[5]),
        distortion=(k1, k2, k3, k4, k5),
        position_frd_m=np.zeros(3),
        laser_offset_cam_m=np.array([0.1, 0.0, 0.0]),
        fisheye=fisheye,
    )


def _whole(path: Path, text: str, key: str) -> int:
    found = re.search(rf"^\s*{key}\s*:\s*(\d+)\s*$", text, re.MULTILINE)
    if found is None or int(found[1]) < 1:
        raise ConfigError(f"{path}: has no `{key}`; add it, in pixels")
    return int(found[1])


def _values(path: Path, text: str, what: str) -> list[float]:
    """Numbers of a matrix in OpenCV's or ROS's format."""
    names = MATRICES[what]
    for name in names:
        found = re.search(rf"^\s*{name}\s*:(?:[^\[]*?data\s*:)?\s*\[([^\]]*)\]", text, re.MULTILINE | re.DOTALL)
        if found is not None:
            return [float(number) for number in re.findall(_NUMBER, found[1])]
    raise ConfigError(f"{path}: has no `{names[0]}`; give a file of OpenCV's calibration or ROS's camera_info")
