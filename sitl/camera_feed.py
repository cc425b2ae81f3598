"""When pictures come: exposure, rendering beside the simulation, transport, losses."""

from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from autopilot.core.samples import CameraFrame
from autopilot.core.vehicle import Camera
from drivers.base import Closing
from sitl.camera import SimCamera
from sitl.fault_tables import Lens, Mounting
from sitl.floor import Image
from sitl.outages import OutageClock
from sitl.plant import Truth
from sitl.scenario import CameraSensor, Fault
from sitl.sensor_faults import OpticalFaults

TRANSPORT_SHARE = 0.5
"""Part of the camera's latency that passes before the picture arrives; the rest is for finding the markers in it."""


class CameraFeed(Closing):
    """A :class:`drivers.protocols.Sensor` of pictures.

    Rendering starts at the exposure on one thread of its own and is waited for when the picture is due, so that the
    result does not depend on how fast the machine is. A ``paced`` feed never waits: a picture comes when it is ready,
    and where rendering does not follow, the picture that waits longest is lost for the next one.
    """

    paced = False
    """Whether time goes on without a picture that is due."""

    def __init__(
        self, renderer: SimCamera, settings: CameraSensor, camera: Camera, faults: Iterable[Fault], seed: int
    ) -> None:
        self._renderers: dict[tuple[Lens | Mounting, ...], SimCamera] = {(): renderer}
        faults = list(faults)
        self._faults = OpticalFaults(faults)
        self._settings = settings
        self._rate_hz = settings.rate_hz or camera.rate_hz
        latency_s = camera.latency_s if settings.latency_s is None else settings.latency_s
        self._transport_s = TRANSPORT_SHARE * latency_s
        self._stamp_error_us = round(settings.stamp_error_s * 1e6)
        self._rng = np.random.default_rng((seed, 30))
        self._outages = OutageClock(settings.outages, faults, np.random.default_rng((seed, 31)))
        self._count = 0
        self._last_due_us = 0
        self._queue: deque[tuple[int, int, Future[Image]]] = deque()
        self._worker: ThreadPoolExecutor | None = None

    @property
    def next_us(self) -> int:
        """Time of the next exposure: whole microseconds, 33333 apart at 30 Hz and never drifting from it."""
        return int(self._count * 1e6 / self._rate_hz)

    def open(self) -> None:
        """Start the rendering thread."""
        if self._worker is None:
            self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="render")

    def close(self) -> None:
        """Stop the rendering thread; pictures not yet taken are dropped."""
        if self._worker is not None:
            self._worker.shutdown(cancel_futures=True)
            self._worker = None
            self._queue.clear()

    def observe(self, truth: Truth) -> None:
        """Expose the picture that is due at ``truth.t_us``."""
        index = self._count
        self._count += 1
        jitter, chance = float(self._rng.standard_normal()), float(self._rng.random())
        lost = self._outages.silent(truth.t_us) or chance < self._settings.drop_probability
        if lost or self._worker is None:
            return
        delay_s = self._transport_s + self._settings.latency_jitter_s * jitter
        due_us = max(self._last_due_us, truth.t_us + max(0, round(delay_s * 1e6)))
        self._last_due_us = due_us
        if self.paced and len(self._queue) > 1 and self._queue[-1][2].cancel():
            self._queue.pop()  # the machine does not follow: the newer picture takes its place
        seen = self._faults.seen(truth)
        self._queue.append((due_us, truth.t_us, self._worker.submit(self._renderer(truth.t_us).render, seen, index)))

    def _renderer(self, t_us: int) -> SimCamera:
        """The camera as it is then: one per combination of faults."""
        active = self._faults.camera_at(t_us)
        if active not in self._renderers:
            self._renderers[active] = self._renderers[()].with_faults(active)
        return self._renderers[active]

    def poll(self, t_us: int) -> list[CameraFrame]:
        """The pictures that have arrived up to ``t_us``."""
        frames = []
        while self._queue and self._queue[0][0] <= t_us and (self._queue[0][2].done() or not self.paced):
            _, exposure_us, picture = self._queue.popleft()
            frames.append(CameraFrame(t_us=exposure_us + self._stamp_error_us, image_bgr=picture.result()))
        return frames
