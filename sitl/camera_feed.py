"""Timing of images: exposure, rendering in the background, transport latency, losses."""

from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor

import cv2
import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.errors import ConfigError
from autopilot.core.samples import CameraFrame
from autopilot.core.vehicle import Camera, Vehicle
from autopilot.sitl.camera_sensor import SimCamera, true_camera
from autopilot.sitl.delayed import LossySensor
from autopilot.sitl.fault_tables import LensFault, Mounting, PictureFault
from autopilot.sitl.floor import Image, build_floor
from autopilot.sitl.picture_faults import Exposure, PictureFaults, reflected
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import CameraBlackout, CameraPicture, Fault, Scenario
from autopilot.sitl.sensor_faults import OpticalFaults
from autopilot.sitl.sensor_tables import CameraSensor
from autopilot.sitl.sitl_tuning import CAMERA_FEED


class CameraFeed(LossySensor[CameraFrame]):
    """A :class:`autopilot.drivers.protocols.Sensor` of pictures.

    Rendering starts at the exposure on one thread of its own and is waited for when the picture is due, so that the
    result does not depend on how fast the machine is. A ``paced`` feed never waits: a picture comes when it is ready,
    and where rendering does not follow, the picture that waits longest is lost for the next one.
    """

    paced = False
    """Whether time goes on without a picture that is due."""

    def __init__(
        self, renderer: SimCamera, settings: CameraSensor, camera: Camera, faults: Iterable[Fault], seed: int
    ) -> None:
        faults = list(faults)
        super().__init__(settings, (camera.rate_hz, camera.latency_s), faults, (seed, 30), sensor="camera")
        self._latency_s *= CAMERA_FEED.transport_fraction
        self._renderers: dict[tuple[LensFault | Mounting, ...], SimCamera] = {(): renderer}
        self._faults = OpticalFaults(faults)
        self._stamp_error_us = round(settings.stamp_error_s * 1e6)
        self._degrading = [fault for fault in faults if isinstance(fault, CameraPicture)]
        self._pictures = PictureFaults(faults)
        self._before: Image | None = None
        self._rendered: deque[tuple[int, int, int, Future[Image]]] = deque()
        """When a picture is due, when it was taken, its number, and the picture."""
        self._worker: ThreadPoolExecutor | None = None

    def open(self) -> None:
        if self._worker is None:
            self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="render")

    def close(self) -> None:
        """Stop the rendering thread; pictures not yet taken are dropped."""
        if self._worker is not None:
            self._worker.shutdown(cancel_futures=True)
            self._worker = None
            self._rendered.clear()

    def tilt(self, off_rad: float) -> None:
        """How far the camera is tilted upwards from where it was calibrated, from now on."""
        self._faults.tilt(off_rad)

    def add(self, fault: Fault) -> bool:
        """A fault that begins while the simulation runs; whether it is one of this sensor."""
        if isinstance(fault, CameraPicture):
            self._degrading.append(fault)
            return True
        return self._pictures.add(fault) or super().add(fault)

    def _taken(self) -> None:
        """The next exposure is on whole microseconds, 33333 apart at 30 Hz and never drifting from it."""
        self._count += 1
        self.next_us = int(self._count * 1e6 / self._rate_hz)

    def observe(self, truth: Truth) -> None:
        """Expose the picture that is due at ``truth.t_us``."""
        index = self._count
        self._taken()
        jitter, chance = float(self._rng.standard_normal()), float(self._rng.random())
        exposure = self._pictures.shown(truth, index)
        if self._lost(truth.t_us, chance) or self._worker is None:
            return
        due_us = self._due_us(truth.t_us, jitter)
        if self.paced and len(self._rendered) > 1 and self._rendered[-1][3].cancel():
            self._rendered.pop()  # the machine does not follow: the newer picture takes its place
        self._rendered.append((due_us, truth.t_us, index, self._picture_of(self._worker, exposure, truth.t_us)))

    def _picture_of(self, worker: ThreadPoolExecutor, exposure: Exposure, t_us: int) -> Future[Image]:
        """The picture of an exposure, taken at ``t_us``."""
        seen, renderer = self._faults.seen(exposure.truth), self._renderer(t_us)
        reflection = self._pictures.reflection(t_us)
        if reflection is None:
            return worker.submit(renderer.render, seen, exposure.number)
        return worker.submit(reflected, renderer.render, exposure._replace(truth=seen), reflection.strength)

    def _renderer(self, t_us: int) -> SimCamera:
        """The camera as it is then: one per combination of faults."""
        active = self._faults.camera_at(t_us)
        if active not in self._renderers:
            self._renderers[active] = self._renderers[()].with_faults(active)
        return self._renderers[active]

    def poll(self, t_us: int) -> list[CameraFrame]:
        """The pictures that have arrived up to ``t_us``."""
        frames = []
        while self._rendered and self._rendered[0][0] <= t_us and (self._rendered[0][3].done() or not self.paced):
            _, exposure_us, index, picture = self._rendered.popleft()
            sent = self._pictures.sent(picture.result(), exposure_us, index)
            image = self._before = self._sent(sent, 1e-6 * exposure_us)
            frames.append(CameraFrame(t_us=exposure_us + self._stamp_error_us, image_bgr=image))
        return frames

    def _sent(self, image: Image, t_s: float) -> Image:
        """The image after the camera's faults."""
        kind = next((f.looks for f in self._degrading if f.at_s <= t_s < f.at_s + f.duration_s), None)
        if kind is None:
            return image
        if kind == "frozen":
            return image if self._before is None else self._before
        gain, level = {"black": (0.01, 0.0), "white": (0.05, 250.0), "fog": (0.03, CAMERA_FEED.fog_level)}[kind]
        blurred = cv2.GaussianBlur(image, (0, 0), CAMERA_FEED.fog_blur_px) if kind == "fog" else image
        noise = np.random.default_rng((self._count, 32)).normal(0.0, CAMERA_FEED.degraded_noise, image.shape[:2])
        degraded = gain * blurred + level + noise[..., None]
        return np.clip(degraded, 0.0, 255.0).astype(np.uint8)


def simulated_camera(scenario: Scenario, vehicle: Vehicle, seed: int) -> CameraFeed:
    """The camera of a vehicle over a scenario's floor. ConfigError without a camera or a floor."""
    floor, eye = build_floor(scenario), vehicle.eye
    if floor is None:
        raise ConfigError(
            f"scenario {scenario.scenario.name!r} has no [tank], so there is no floor for the camera;"
            " use --sensors pose"
        )
    laser = scenario.sensors.laser
    model = true_camera(CameraModel.of_vehicle(vehicle), scenario.camera, laser)
    renderer = SimCamera(model, floor, scenario.camera, seed, laser=laser.enabled and vehicle.laser is not None)
    return CameraFeed(renderer, scenario.sensors.camera, eye, scenario.fault, seed)


def is_of_camera(fault: Fault) -> bool:
    """Whether a :class:`CameraFeed` takes it while it runs."""
    return isinstance(fault, CameraPicture | PictureFault | CameraBlackout)
