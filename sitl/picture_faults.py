"""Image faults of a scenario: images that are plausible but of another time or position.

Near-frozen, repeated and delayed images and those of another position differ from their stamps: that is selected
before rendering, so that the pose sensor has the same faults. Mirrored and half-frozen images and reflections are
computed from rendered ones.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.sitl.fault_tables import (
    MOST_DELAY_S,
    MOST_PICTURES,
    Delayed,
    Elsewhere,
    HalfFrozen,
    Mirrored,
    NearFrozen,
    PictureFault,
    Reflection,
    Repeated,
)
from autopilot.sitl.floor import Image
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import Fault

FLIPS = {"columns": 1, "rows": 0, "both": -1}
"""OpenCV's codes."""


class Exposure(NamedTuple):
    truth: Truth
    number: int
    """Number of the picture: chooses its noise."""


class PictureFaults:
    """Faults of one camera, or of the pose sensor in its place. Times must not decrease."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        self._faults: list[PictureFault] = []
        self._past: deque[Exposure] = deque()
        self._began: dict[int, Exposure] = {}
        self._loops: dict[int, list[Exposure]] = {}
        self._halves: dict[int, Image] = {}
        for fault in faults:
            self.add(fault)

    def add(self, fault: Fault) -> bool:
        """A fault that begins while the simulation runs; whether it is one of pictures."""
        if isinstance(fault, PictureFault):
            self._faults.append(fault)
            return True
        return False

    def _active(self, t_us: int) -> list[tuple[int, PictureFault]]:
        return [(k, fault) for k, fault in enumerate(self._faults) if fault.holds(t_us)]

    def shown(self, truth: Truth, index: int) -> Exposure:
        """True exposure of image number ``index`` that is stamped ``truth.t_us``."""
        now = Exposure(truth, index)
        if not self._faults:
            return now
        result = now
        for k, fault in self._active(truth.t_us):
            first = self._began.setdefault(k, now)
            if isinstance(fault, NearFrozen):
                result = first
            elif isinstance(fault, Repeated):
                loop = self._loops.setdefault(k, list(self._past)[-fault.pictures :] or [now])
                result = loop[(index - first.number) % len(loop)]
            elif isinstance(fault, Delayed):
                result = self._before(truth.t_us - round(1e6 * fault.delay_s), now)
            elif isinstance(fault, Elsewhere):
                result = Exposure(_elsewhere(first.truth, truth, fault), index)
        self._past.append(now)
        while len(self._past) > MOST_PICTURES and self._past[0].truth.t_us < truth.t_us - 1e6 * MOST_DELAY_S:
            self._past.popleft()
        return result

    def _before(self, t_us: int, now: Exposure) -> Exposure:
        """The last picture at or before that time, or the oldest one."""
        for exposure in reversed(self._past):
            if exposure.truth.t_us <= t_us:
                return exposure
        return self._past[0] if self._past else now

    def pose_shown(self, truth: Truth, index: int) -> Truth | None:
        """As :meth:`shown` for a pose sensor: None = such an image gives no pose. An image that is half of another
        time gives either, alternating. Reflections are ignored.
        """
        t_us, result = truth.t_us, self.shown(truth, index).truth
        for k, fault in self._active(t_us):
            if isinstance(fault, Mirrored):
                return None
            if isinstance(fault, HalfFrozen) and index % 2:
                result = self._began[k].truth
        return result if result is truth else replace(result, t_us=t_us)

    def reflection(self, t_us: int) -> Reflection | None:
        return next((fault for _, fault in self._active(t_us) if isinstance(fault, Reflection)), None)

    def sent(self, image: Image, t_us: int, index: int) -> Image:
        """The rendered image of ``t_us`` after its faults."""
        for k, fault in self._active(t_us) if self._faults else ():
            if isinstance(fault, Mirrored):
                image = np.ascontiguousarray(cv2.flip(image, FLIPS[fault.across]))
            elif isinstance(fault, NearFrozen):
                image = _noisy(image, fault.noise_levels, index)
            elif isinstance(fault, HalfFrozen):
                old = _noisy(self._halves.setdefault(k, image), fault.noise_levels, index)
                image = _patched(image, old, fault)
        return image


def reflected(render: Callable[[Truth, int], Image], exposure: Exposure, strength: float) -> Image:
    """A picture with the floor's image in the surface: light that goes up and comes down again travels from floor to
    surface and from there to the camera, as if the camera were as high above the surface as it is below."""
    truth, index = exposure
    above: FloatArray = truth.pos_ned_m * np.array([1.0, 1.0, -1.0])
    mirrored = cv2.flip(render(replace(truth, pos_ned_m=above), index), FLIPS["columns"])
    result: Image = cv2.addWeighted(render(truth, index), 1.0 - strength, mirrored, strength, 0.0).astype(np.uint8)
    return result


def _elsewhere(first: Truth, truth: Truth, fault: Elsewhere) -> Truth:
    """Position and heading of the exposure: the vehicle's later path, rotated as a whole."""
    seen = truth if fault.follows else first
    c, s = math.cos(fault.yaw_rad), math.sin(fault.yaw_rad)
    north, east, down = (seen.pos_ned_m - first.pos_ned_m).tolist()
    offset = np.array([c * north - s * east, s * north + c * east, down])
    turned = seen.rpy_rad + np.array([0.0, 0.0, fault.yaw_rad])
    return replace(seen, t_us=truth.t_us, pos_ned_m=first.pos_ned_m + fault.offset_m + offset, rpy_rad=turned)


def _noisy(image: Image, levels: float, index: int) -> Image:
    if levels == 0.0:
        return image
    noise = np.random.default_rng((index, 33)).normal(0.0, levels, image.shape[:2])
    return np.clip(np.rint(image + noise[..., None]), 0, 255).astype(np.uint8)


def _patched(image: Image, old: Image, fault: HalfFrozen) -> Image:
    """The picture with a part of an old one."""
    rows, columns = round(fault.share * image.shape[0]), round(fault.share * image.shape[1])
    down, across = {
        "top": (slice(rows), slice(None)),
        "bottom": (slice(image.shape[0] - rows, None), slice(None)),
        "left": (slice(None), slice(columns)),
        "right": (slice(None), slice(image.shape[1] - columns, None)),
    }[fault.part]
    result = image.copy()
    result[down, across] = old[down, across]
    return result
