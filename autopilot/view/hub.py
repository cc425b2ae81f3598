"""One thread that encodes frames from the loop's snapshots and distributes them to the viewers.

A slow viewer blocks nobody: it has one slot per kind of message, with the newest. A viewer that does not receive
within :data:`autopilot.view.http_server.PATIENCE_S` is disconnected. Without viewers the thread sleeps and the loop
does next to nothing.
"""

import threading
import time
from collections.abc import Mapping

import msgspec
import numpy as np

from autopilot.core.vehicle import Vehicle
from autopilot.view.ages import FLOW_S
from autopilot.view.controls import Controls
from autopilot.view.encode import frame_of, picture_of, plan_points_m, scene_of
from autopilot.view.feed import UNKNOWN_NED_M, Feed, TickSnapshot, Watched

POLL_S = 0.05
IDLE_S = 0.5
"""Interval at which the page is informed that the loop is silent."""
BREATH_S = 5.0
"""Keep-alive interval, by which disconnected viewers are detected."""
MAX_VIEWERS = 16

KINDS = ("scene", "frame", "flow", "picture", "trouble")
"""Messages, in the order in which they are sent."""

_encoder = msgspec.json.Encoder()


class Viewer:
    """One page: the newest of each kind of message that it has not had yet."""

    def __init__(self, *, pictures: bool) -> None:
        self.pictures = pictures
        self._news = threading.Condition()
        self._waiting: dict[str, bytes] = {}
        self._over = False
        self.scene = -1
        """The scene that it has been given; the hub's."""

    def put(self, kind: str, data: bytes) -> None:
        with self._news:
            self._waiting[kind] = data
            self._news.notify()

    def end(self) -> None:
        with self._news:
            self._over = True
            self._news.notify()

    def take(self) -> bytes | None:
        """The next bytes of its stream of server-sent events, None at the end. Waits."""
        with self._news:
            if not self._waiting and not self._over:
                self._news.wait(BREATH_S)
            if self._over:
                return None
            waiting, self._waiting = self._waiting, {}
        if not waiting:
            return b": nothing new\n\n"
        return b"".join(b"event: %b\ndata: %b\n\n" % (k.encode(), waiting[k]) for k in KINDS if k in waiting)


class _Run:
    def __init__(self, feed: Feed, vehicle: Vehicle, controls: Controls, simulated: bool, pictures: bool) -> None:
        self.feed, self.vehicle, self.controls = feed, vehicle, controls
        self.simulated, self.pictures = simulated, pictures


class Hub:
    """Viewers on one side, the run of now on the other."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._viewers: list[Viewer] = []
        self._run: _Run | None = None
        self._wake = threading.Event()
        self._closed = False
        self._scene: tuple[int, bytes] = (-1, b"")
        self._seen = (0, 0)
        """Run and snapshot of the last frame."""
        self._runs = self._scenes = 0
        self._frame_s = self._flow_s = 0.0
        self._pictured = -1
        self._thread = threading.Thread(target=self._work, name="view", daemon=True)
        self._thread.start()

    # The run's side

    def attach(
        self, watched: Watched, vehicle: Vehicle, controls: Controls, *, simulated: bool, pictures: bool
    ) -> Feed:
        """A run begins; the feed is for its loop. ``pictures``: whether a camera delivers any."""
        feed = Feed(watched, self._scenes)
        with self._lock:
            self._run = _Run(feed, vehicle, controls, simulated, pictures)
            self._runs += 1
            self._pictured = -1
        self._count()
        return feed

    def detach(self) -> None:
        """The run is over; viewers stay, for the next one."""
        with self._lock:
            self._run = None

    def close(self) -> None:
        """Send all viewers away and end the thread."""
        self._closed = True
        self._wake.set()
        with self._lock:
            viewers, self._viewers = self._viewers, []
        for viewer in viewers:
            viewer.end()
        self._thread.join(2.0)

    # The page's side

    @property
    def controls(self) -> Controls | None:
        run = self._run
        return None if run is None else run.controls

    @property
    def viewers(self) -> int:
        return len(self._viewers)

    def join(self, *, pictures: bool) -> Viewer | None:
        """Add a viewer; None when the limit is reached."""
        with self._lock:
            if len(self._viewers) >= MAX_VIEWERS or self._closed:
                return None
            viewer = Viewer(pictures=pictures)
            self._viewers = [*self._viewers, viewer]
        self._count()
        self._wake.set()
        return viewer

    def leave(self, viewer: Viewer) -> None:
        with self._lock:
            self._viewers = [other for other in self._viewers if other is not viewer]
        self._count()

    def _count(self) -> None:
        run, viewers = self._run, self._viewers
        if run is not None:
            run.feed.watched = bool(viewers)
            run.feed.pictured = any(viewer.pictures for viewer in viewers)

    # The thread

    def _work(self) -> None:
        while not self._closed:
            if not self._viewers:
                self._wake.wait()
                self._wake.clear()
                continue
            time.sleep(POLL_S)
            try:
                self._give()
            except Exception as error:  # noqa: BLE001 - a fault of the view is shown on the page; nothing else stops
                self._all("trouble", {"text": f"internal fault ({type(error).__name__}: {error})"})
                time.sleep(1.0)

    def _give(self) -> None:
        run, now_s = self._run, time.monotonic()
        snapshot = None if run is None else run.feed.snapshot
        if run is None or snapshot is None:
            return
        seen = (self._runs, snapshot.number)
        if seen == self._seen and now_s - self._frame_s < IDLE_S:
            return
        self._seen, self._frame_s = seen, now_s
        self._give_scene(run, snapshot)
        frame = frame_of(snapshot, run.vehicle, run.controls.steered, now_s=now_s, viewers=len(self._viewers))
        self._all("frame", frame)
        if now_s - self._flow_s >= FLOW_S:
            self._flow_s = now_s
            nav = snapshot.outputs.nav
            place = np.array(UNKNOWN_NED_M) if nav is None else nav.pos_ned_m
            shown_m = plan_points_m(snapshot.description, place)
            flow = run.controls.flow(1e-6 * snapshot.outputs.t_us, place, shown_m)
            if flow is not None:
                self._all("flow", flow)
        taken = snapshot.picture
        if taken is not None and taken.number != self._pictured:
            self._pictured = taken.number
            data = _encoder.encode(picture_of(taken))
            for viewer in self._viewers:
                if viewer.pictures:
                    viewer.put("picture", data)

    def _give_scene(self, run: _Run, snapshot: TickSnapshot) -> None:
        """Send the scene to viewers without it; encoded for each, because of the track."""
        without = [viewer for viewer in self._viewers if viewer.scene != snapshot.scene]
        if not without:
            return
        self._scenes = max(self._scenes, snapshot.scene)
        steerable = run.controls.steerable
        scene = scene_of(snapshot, run.vehicle, steerable, simulated=run.simulated, pictures=run.pictures)
        data = _encoder.encode(scene)
        for viewer in without:
            viewer.scene = snapshot.scene
            viewer.put("scene", data)

    def _all(self, kind: str, message: msgspec.Struct | Mapping[str, str]) -> None:
        data = _encoder.encode(message)
        for viewer in self._viewers:
            viewer.put(kind, data)
