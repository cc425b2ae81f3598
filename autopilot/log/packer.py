"""Makes a log's messages of whole inputs, outputs and truth: every topic at its rate. Runs on the writer's thread.

Rates follow the service's clock, never the wall clock, so that the same run gives the same messages however late they
are packed. Inputs are stamped with their time of validity; ``/in/tick`` opens the group of inputs that one call of
``step`` took in, in file order.
"""

from collections import deque
from collections.abc import Hashable, Mapping, Sequence
from functools import partial
from typing import Any, Protocol

from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.core.guard import Fault
from autopilot.core.messages import Event, Inputs, LoopStats, MavlinkFrame, NavState, Outputs, Severity
from autopilot.core.samples import CameraFrame, MarkerSighting, PlanarFixSample, PowerSample, Sample
from autopilot.log import visuals
from autopilot.log.description import ATTACHMENT, RunDescription, to_json
from autopilot.log.mavlink_frames import Removed, StreamCutter
from autopilot.log.packing import programs, records, step_notes
from autopilot.log.packing.records import Pack, pack_record
from autopilot.log.record_table import MAX_NODES, TruthLike
from autopilot.log.scene import TRUE_CURRENT, body_markers, current_marker, moving_markers, scene_markers
from autopilot.log.topics import AID_PREFIX
from autopilot.log.writer import Payload

TRUTH_US = 10_000
THRUSTERS_US = 20_000
COVARIANCE_US = 100_000
SHADOW_US = 100_000
HORIZON_US = 100_000
SLOW_US = 1_000_000
"""State that seldom changes is written when it changes, and this often."""
VIZ_US = 100_000
TRAIL_US = 500_000
TRAIL_POINTS = 600
"""Points of /viz/path: five minutes of trail."""
MAX_STREAMS = 256
"""MAVLink streams in progress; beyond that the oldest is dropped."""
PICTURES = 64
"""Times of pictures that are kept until their markers arrive."""
JPEG_QUALITY = 80
MAX_PROGRAMS = 32
"""Programs of the optimiser that were not solved that a log keeps, the first ones."""
MAX_FAULTS = 32
"""Internal faults that a log keeps with all they had; of the others it has the line."""
VIEWERS: dict[type, tuple[str, Pack]] = {**records.VIEWERS, PowerSample: ("/in/power", visuals.battery_state)}
"""Class of a sample -> the topic that viewers know, and how it is packed for them."""
_BODY = 12
"""Bytes of a message in front of its content: encapsulation and stamp."""


class Sink(Protocol):
    """Takes messages one after the other."""

    def write(self, topic: str, t_us: int, payload: Payload) -> None: ...
    def write_packet(self, t_us: int, packet: bytes) -> None: ...
    def attach(self, name: str, t_us: int, data: Payload) -> None: ...


class Packer:
    """Stateful part of packing. All calls come from one thread, in the order of the run."""

    def __init__(self, sink: Sink, epoch_ns: int, description: RunDescription) -> None:
        self._sink = sink
        self._epoch_ns = epoch_ns
        self._description, self._scene = description, scene_markers(description)
        self._last_us: dict[str, int] = {}
        self._last_key: dict[str, Hashable] = {}
        self._last_body: dict[str, bytes] = {}
        self._cutters: dict[tuple[str, int, int], StreamCutter] = {}
        self._lost_bytes = False
        """Data have been dropped: a new stream may begin anywhere."""
        self._standing = step_notes.LatchedNotes()
        self._trail: list[tuple[float, float, float]] = []
        self._pictures: deque[int] = deque(maxlen=PICTURES)
        """Times of the pictures logged last, whose detections are pending."""
        self._truth: tuple[FloatArray, FloatArray] | None = None
        """Place and current of the simulated vehicle."""
        self._faults = self._programs = 0

    def after_loss(self) -> None:
        """Data since the last call has been dropped: streams resynchronise."""
        self._lost_bytes = True
        for cutter in self._cutters.values():
            cutter.lose_track()

    def describe(self, t_us: int, description: RunDescription, attachments: Mapping[str, Payload]) -> None:
        """A new description with its attachments (plans changed since the log began); readers use the last."""
        self._description, self._scene = description, scene_markers(description)
        self._sink.attach(ATTACHMENT, t_us, lambda: to_json(description))
        for name, data in attachments.items():
            self._sink.attach(name, t_us, data)

    def inputs(self, inputs: Inputs) -> None:
        t_us = inputs.t_us
        self._record("/in/tick", t_us, inputs)
        for sample in inputs.samples:
            self._sample(sample)
        if inputs.below is not None:
            self._on_change("/in/below", t_us, inputs.below)
        removed = [self._mavlink("/in/mavlink", t_us, frame) for frame in inputs.mavlink_rx]
        notes = step_notes.notes_of(inputs, removed, self._standing)
        if notes is not None:
            self._write("/in/step", t_us, step_notes.pack(notes))

    def camera(self, frame: CameraFrame) -> None:
        stamp_ns = self._ns(frame.t_us)
        self._pictures.append(frame.t_us)
        self._sink.write("/in/camera", frame.t_us, partial(_jpeg, frame, stamp_ns))
        camera = self._description.camera
        if camera is not None:
            self._sink.write("/in/camera_info", frame.t_us, partial(visuals.camera_info, stamp_ns, camera))

    def still(self, exposure_us: int, png: bytes) -> None:
        """A still in full size, as a PNG; its metadata come with ``Outputs.stills``."""
        data = visuals.compressed_image(self._ns(exposure_us), png, "png")
        self._write("/payload/image", exposure_us, data)

    def truth(self, t_us: int, truth: TruthLike) -> None:
        if self._due("/sim/truth", t_us, TRUTH_US):
            self._record("/sim/truth", t_us, truth)
        if self._due("/sim/thrusters", t_us, THRUSTERS_US):
            self._record("/sim/thrusters", t_us, truth)
        if self._due("/viz/truth", t_us, VIZ_US):
            self._truth = truth.pos_ned_m.copy(), truth.current_ned_m_s.copy()
            self._write("/viz/truth", t_us, visuals.pose_stamped(self._ns(t_us), truth))
            self._write("/viz/tf", t_us, visuals.true_transform(self._ns(t_us), truth))

    def contact(self, t_us: int, count: int, penetration_m: float) -> None:
        """Contacts of the simulated hull begun so far and the deepest penetration of now, once per tick."""
        if self._changed("/sim/contact", t_us, (count, penetration_m)):
            self._on_change("/sim/contact", t_us, (count, penetration_m))

    def payload_truth(self, t_us: int, levels: tuple[float, ...]) -> None:
        """Where the simulated vehicle's equipment is, once per tick."""
        if levels and self._changed("/sim/payload", t_us, levels):
            self._on_change("/sim/payload", t_us, levels)

    def loop(self, stats: LoopStats) -> None:
        self._record("/sys/loop", stats.t_us, stats)
        if stats.process is not None:
            self._record("/sys/process", stats.t_us, stats.process)

    def event(self, event: Event) -> None:
        """An event from outside ``step`` (``Outputs.events`` are written by ``outputs``)."""
        self._write("/rosout", event.t_us, visuals.event(self._ns(event.t_us), event))

    def outputs(self, outputs: Outputs) -> None:
        t_us = outputs.t_us
        stamp_ns = self._ns(t_us)
        if outputs.nav is not None:
            self._nav(t_us, stamp_ns, outputs.nav)
        if outputs.estimated_from is not None:
            given = outputs.estimated_from
            self._on_change("/nav/thrust", t_us, given.thrust_n)
            for given_sample in given.samples:
                topic = "/nav/gps" if isinstance(given_sample, PlanarFixSample) else "/nav/external"
                self._record(topic, given_sample.t_us, given_sample)
        for aid in outputs.aids:
            self._record(AID_PREFIX + aid.sensor, aid.t_us, aid)
            if aid.fit is not None:
                self._record("/nav/fit", aid.t_us, aid.fit)
        if outputs.counters is not None:
            self._record("/nav/counters", t_us, outputs.counters)
        if outputs.shadow is not None and self._due("/nav/shadow", t_us, SHADOW_US):
            self._record("/nav/shadow", t_us, outputs.shadow)
        mode, done = outputs.mode, outputs.progress
        if self._changed("/sys/mode", t_us, (mode.armed, mode.custom_mode, mode.failsafes)):
            self._on_change("/sys/mode", t_us, mode)
        if done is not None and self._changed(
            "/mission/progress", t_us, (done.current_seq, done.reached_seq, done.lap, done.state)
        ):
            self._on_change("/mission/progress", t_us, done)
        if outputs.goal is not None and self._changed("/ctl/goal", t_us, outputs.goal):
            self._on_change("/ctl/goal", t_us, outputs.goal)
        drive = None if outputs.goal is None else outputs.goal.drive
        if (drive is not None or "/ctl/drive" in self._last_key) and self._changed("/ctl/drive", t_us, drive):
            self._on_change("/ctl/drive", t_us, drive)
        if outputs.control is not None:
            self._control(t_us, stamp_ns, outputs)
        self._on_change("/out/thrusters", t_us, outputs.command, always=outputs.control is not None)
        if outputs.thrusters is not None:
            self._record("/ctl/thrusters", t_us, outputs.thrusters)
        if outputs.payload is not None and self._changed("/payload/outputs", t_us, outputs.payload.pulses_us):
            self._on_change("/payload/outputs", t_us, outputs.payload)
        for record in outputs.stills:
            exposure_us = record.still.exposure_us
            self._record("/payload/still", exposure_us, record)
        for name, value in outputs.parameters.items():
            self._record("/sys/parameters", t_us, (name, value))
        for frame in outputs.mavlink_tx:
            self._mavlink("/out/mavlink", t_us, frame)
        for event in outputs.events:
            self.event(event)
        for fault in outputs.faults:
            self._fault(fault)

    def _fault(self, fault: Fault) -> None:
        """An exception inside the service: a line, and an attachment with its context; rate-limited if it persists."""
        if not fault.traceback:
            return
        text = f"{fault.line}: {fault.text} ({fault.place})"
        self.event(Event(t_us=fault.t_us, severity=Severity.ERROR, text=text))
        if self._faults < MAX_FAULTS:
            self._faults += 1
            body = f"{fault.t_us} us, {fault.part}\n\n{fault.traceback}\ninputs:\n{fault.inputs}\n"
            self._sink.attach(f"fault-{self._faults:02d}.txt", fault.t_us, body.encode(errors="replace"))

    def _ns(self, t_us: int) -> int:
        return self._epoch_ns + t_us * 1000

    def _write(self, topic: str, t_us: int, payload: bytes) -> None:
        self._sink.write(topic, t_us, payload)

    def _record(self, topic: str, t_us: int, value: Any) -> None:
        """Pack ``value`` with the row of its type."""
        self._write(topic, t_us, pack_record(topic, self._ns(t_us), value))

    def _due(self, topic: str, t_us: int, period_us: int) -> bool:
        last = self._last_us.get(topic)
        if last is not None and t_us - last < period_us:
            return False
        self._last_us[topic] = t_us
        return True

    def _changed(self, topic: str, t_us: int, key: Hashable) -> bool:
        """Whether to pack a message: its source is another object, or SLOW_US have passed."""
        if self._last_key.get(topic) == key and t_us - self._last_us[topic] < SLOW_US:
            return False
        self._last_key[topic] = key
        return True

    def _on_change(self, topic: str, t_us: int, value: Any, always: bool = False) -> None:
        """A record when its content differs from the last, when ``always``, and every SLOW_US."""
        payload = pack_record(topic, self._ns(t_us), value)
        changed = self._last_body.get(topic) != payload[_BODY:]
        if changed or always or t_us - self._last_us[topic] >= SLOW_US:
            self._last_body[topic] = payload[_BODY:]
            self._last_us[topic] = t_us
            self._write(topic, t_us, payload)

    def _sample(self, sample: Sample) -> None:
        t_us, stamp_ns = sample.t_us, self._ns(sample.t_us)
        topic = records.SAMPLE_TOPICS[type(sample)]
        if isinstance(sample, MarkerSighting):
            self._write(topic, t_us, records.marker_sighting(stamp_ns, sample))
        else:
            self._record(topic, t_us, sample)
        if type(sample) in VIEWERS:
            topic, pack = VIEWERS[type(sample)]
            self._write(topic, t_us, pack(stamp_ns, sample))
        if isinstance(sample, MarkerSighting) and t_us in self._pictures:
            self._sink.write("/viz/detections", t_us, partial(visuals.image_annotations, stamp_ns, sample))

    def _mavlink(self, topic: str, t_us: int, frame: MavlinkFrame) -> Removed:
        """Packets completed by a datagram, and the bytes removed."""
        stream = (topic, frame.link, frame.client)
        if stream not in self._cutters and len(self._cutters) >= MAX_STREAMS:
            self._forget_stream(next(iter(self._cutters)), t_us)
        cutter = self._cutters.get(stream)
        if cutter is None:
            cutter = self._cutters[stream] = StreamCutter()
            if self._lost_bytes:
                cutter.lose_track()
        for piece in cutter.cut(frame.data):
            self._record(topic, t_us, (piece.data, frame.link, frame.client))
            if piece.is_packet:
                self._sink.write_packet(t_us, piece.data)
        return cutter.removed

    def _forget_stream(self, stream: tuple[str, int, int], t_us: int) -> None:
        """Write the incomplete rest of a stream."""
        topic, link, client = stream
        for piece in self._cutters.pop(stream).rest():
            self._record(topic, t_us, (piece.data, link, client))

    def _nav(self, t_us: int, stamp_ns: int, nav: NavState) -> None:
        self._record("/nav/state", t_us, nav)
        if self._changed("/nav/status", t_us, (nav.health, nav.reset_count)):
            self._on_change("/nav/status", t_us, nav)
        if self._due("/nav/covariance", t_us, COVARIANCE_US):
            self._record("/nav/covariance", t_us, nav)
        if self._due("/viz/pose", t_us, VIZ_US):
            self._write("/viz/pose", t_us, visuals.pose_stamped(stamp_ns, nav))
            self._write("/viz/tf", t_us, visuals.transforms(stamp_ns, nav, self._description.camera))
            self._current(t_us, stamp_ns, nav)
        if self._due("trail", t_us, TRAIL_US):
            north, east, down = nav.pos_ned_m.tolist()
            self._trail = [*self._trail[1 - TRAIL_POINTS :], (north, east, down)]
        if self._due("/viz/markers", t_us, SLOW_US):
            self._draw(t_us, stamp_ns)

    def _draw(self, t_us: int, stamp_ns: int) -> None:
        """Messages for viewers other than poses. Packed on the writer's thread."""
        run, truth, write = self._description, self._truth, self._sink.write
        write("/viz/markers", t_us, partial(_all_markers, stamp_ns, self._scene, run, t_us * 1e-6))
        write("/viz/path", t_us, partial(visuals.path, stamp_ns, self._trail))
        body = body_markers(run, truth=truth is not None)
        write("/viz/body", t_us, partial(visuals.marker_array, stamp_ns, body))

    def _current(self, t_us: int, stamp_ns: int, nav: NavState) -> None:
        """Current at the vehicle as an arrow: estimate and, in simulation, truth."""
        arrows = [current_marker("current", nav.pos_ned_m, nav.current_ned_m_s)]
        if self._truth is not None:
            arrows.append(current_marker(TRUE_CURRENT, *self._truth))
        self._sink.write("/viz/current", t_us, partial(visuals.marker_array, stamp_ns, arrows))

    def _control(self, t_us: int, stamp_ns: int, outputs: Outputs) -> None:
        control = outputs.control
        assert control is not None
        self._record("/ctl/nmpc", t_us, control.status)
        for program in control.unsolved[: MAX_PROGRAMS - self._programs]:
            self._programs += 1
            self._sink.attach(programs.NAME.format(self._programs), t_us, partial(programs.pack, program))
        if control.plan is not None:
            self._record("/ctl/plan", t_us, control.plan)
        if not self._due("/ctl/horizon", t_us, HORIZON_US):
            return
        places, after_s = control.horizon_ned_m.tolist(), control.nominal_t_s.tolist()
        if len(after_s) != len(places):
            after_s = []
        self._sink.write("/ctl/horizon", t_us, partial(visuals.path, stamp_ns, places, after_s))
        if 0 < len(control.tube_m) == len(places) <= MAX_NODES:
            self._record("/ctl/tube", t_us, control)
        depth = 0.0 if outputs.nav is None else float(outputs.nav.pos_ned_m[2])
        route = [(north, east, depth) for north, east in control.route_ned_m.tolist()]
        self._sink.write("/ctl/route", t_us, partial(visuals.path, stamp_ns, route))


def _all_markers(stamp_ns: int, scene: Sequence[visuals.VisualMarker], run: RunDescription, t_s: float) -> bytes:
    return visuals.marker_array(stamp_ns, [*scene, *moving_markers(run, t_s)])


def _jpeg(frame: CameraFrame, stamp_ns: int) -> bytes:
    import cv2

    done, jpeg = cv2.imencode(".jpg", frame.image_bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        raise LogError("image cannot be compressed as JPEG; camera images must be uint8 (rows, columns, 3)")
    return visuals.compressed_image(stamp_ns, jpeg.tobytes())
