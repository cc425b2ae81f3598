"""Inputs of a step beside samples and bytes, as JSON in a std_msgs/String, on ticks on which there are any.

Together with ``/in/tick``, the samples and ``/in/mavlink`` they are all of :class:`autopilot.core.messages.Inputs`,
and the calls between ticks. Slowly changing values (picture counts, flight controller state, devices' reasons
against arming) are written on change.
"""

import base64
from collections.abc import Mapping
from dataclasses import dataclass

import msgspec

from autopilot.core.clients import Reach
from autopilot.core.errors import LogError
from autopilot.core.guard import Fault
from autopilot.core.messages import (
    Authority,
    Between,
    DeviceRole,
    DeviceTrouble,
    Event,
    FlightControllerState,
    Inputs,
    MavlinkFrame,
)
from autopilot.core.nondeterminism import Note
from autopilot.core.samples import FrameVerdict, PictureReport
from autopilot.core.stills import CameraReport, StoredStill
from autopilot.log.cdr import CdrBuffer
from autopilot.log.mavlink_frames import Removed

UNSET = msgspec.UNSET


class Datagram(msgspec.Struct, frozen=True, array_like=True):
    """Origin of received bytes; the bytes are in ``/in/mavlink``, packet by packet."""

    link: int
    client: int
    sender: str
    reach: int
    length: int
    """Without keys; negative = so many bytes of the datagram before were the beginning of one."""


class KeyPacket(msgspec.Struct, frozen=True, array_like=True):
    """A SETUP_SIGNING that was removed, with a substitute for its key."""

    datagram: int
    """Of this tick, from 0."""
    offset: int
    """Bytes of the datagram before it."""
    packet: str
    """Base64."""


class FlightControllerNote(msgspec.Struct, frozen=True, omit_defaults=True):
    """A :class:`FlightControllerState` without its time, which is the tick's."""

    authority: str
    acts: bool
    late_us: int = 0
    """How much earlier than the tick it is of."""
    text: str = ""
    problem: str = ""
    refusals: tuple[str, ...] = ()
    pulses_us: tuple[int, ...] = ()
    armed: bool | None = None
    rival: bool = False


_SAME = ("acts", "text", "problem", "refusals", "pulses_us", "armed", "rival")
"""Fields of both."""


class StepNotes(msgspec.Struct, frozen=True, omit_defaults=True, kw_only=True):
    rx: tuple[Datagram, ...] = ()
    keys: tuple[KeyPacket, ...] = ()
    between: tuple[tuple[int | None, int], ...] = ()
    """Calls between ticks: time [us] and number of the first datagrams; without a time a HEARTBEAT."""
    notices: tuple[tuple[int, int, str], ...] = ()
    troubles: tuple[tuple[int, int, str], ...] = ()
    pictures: tuple[tuple[int, str, float, float, float], ...] = ()
    answers: tuple[tuple[str, int, bool | int | str | tuple[int, str] | None], ...] = ()
    faults: tuple[tuple[int, str, str, str, str, str, str], ...] = ()
    """Exceptions of drivers."""
    camera: tuple[int | None, int, int, str] | None = None
    """Newest exposure, bytes in all and free, why no still can be stored."""
    stills: tuple[tuple[int, int, str, int, int, int, str], ...] = ()
    """Results of stills: number, exposure, file, width, height, bytes, problem."""
    log_lost: bool = False
    clock_jump_s: float = 0.0
    frame_counts: dict[str, int] | msgspec.UnsetType | None = UNSET
    below: FlightControllerNote | msgspec.UnsetType | None = UNSET
    refusals: tuple[str, ...] | msgspec.UnsetType = UNSET


EMPTY = StepNotes()


@dataclass(slots=True)
class LatchedNotes:
    """Latest values of the notes that are written on change, while writing and while reading a log."""

    frame_counts: Mapping[str, int] | None = None
    below: FlightControllerNote | None = None
    refusals: tuple[str, ...] = ()


def notes_of(inputs: Inputs, removed: list[Removed], standing: LatchedNotes) -> StepNotes | None:
    """Notes of a tick, None if there are none; ``standing`` is updated. ``removed``: bytes removed from each of
    ``inputs.mavlink_rx``.
    """
    below = None if inputs.below is None else _flight_controller_note(inputs.t_us, inputs.below)
    camera = inputs.camera
    quiet = not (
        inputs.mavlink_rx or inputs.between or inputs.notices or inputs.troubles or inputs.pictures or inputs.answers
    )
    if (
        quiet
        and not (inputs.faults or inputs.log_lost or inputs.clock_jump_s or inputs.stills)
        and inputs.camera is None
        and inputs.frame_counts == standing.frame_counts
        and below == standing.below
        and inputs.refusals == standing.refusals
    ):
        return None
    notes = StepNotes(
        rx=tuple(
            Datagram(frame.link, frame.client, frame.sender, int(frame.reach), len(frame.data) - out.count)
            for frame, out in zip(inputs.mavlink_rx, removed, strict=True)
        ),
        keys=tuple(
            KeyPacket(number, offset, base64.b64encode(packet).decode())
            for number, out in enumerate(removed)
            for offset, packet in out.keys
        ),
        between=tuple((call.t_us, call.frames) for call in inputs.between),
        notices=tuple((event.t_us, int(event.severity), event.text) for event in inputs.notices),
        troubles=tuple((trouble.t_us, int(trouble.device), trouble.text) for trouble in inputs.troubles),
        pictures=tuple(
            (p.t_us, p.verdict.value, p.contrast, p.white_fraction, p.black_fraction) for p in inputs.pictures
        ),
        answers=tuple((note.kind, note.number, note.fact) for note in inputs.answers),
        faults=tuple((f.t_us, f.part, f.kind, f.place, f.text, f.traceback, f.inputs) for f in inputs.faults),
        camera=None if camera is None else (camera.frame_us, camera.total_bytes, camera.free_bytes, camera.refusal),
        stills=tuple(
            (s.index, s.exposure_us, s.path, s.width_px, s.height_px, s.size, s.problem) for s in inputs.stills
        ),
        log_lost=inputs.log_lost,
        clock_jump_s=inputs.clock_jump_s,
        frame_counts=UNSET if inputs.frame_counts == standing.frame_counts else _counts(inputs.frame_counts),
        below=UNSET if below == standing.below else below,
        refusals=UNSET if inputs.refusals == standing.refusals else inputs.refusals,
    )
    standing.frame_counts, standing.below, standing.refusals = inputs.frame_counts, below, inputs.refusals
    return notes


def pack(notes: StepNotes) -> bytes:
    """std_msgs/String."""
    out = CdrBuffer()
    out.string(msgspec.json.encode(notes).decode())
    return out.getvalue()


def unpack(text: str, place: str) -> StepNotes:
    """Inverse of :func:`pack`. LogError, naming ``place``, for an invalid text."""
    try:
        return msgspec.json.decode(text, type=StepNotes)
    except msgspec.MsgspecError as error:
        raise LogError(f"{place}: cannot be read ({error}); the log is of another version") from error


def inputs_with(inputs: Inputs, notes: StepNotes, datagrams: tuple[bytes, ...], standing: LatchedNotes) -> Inputs:
    """``inputs`` (time, samples, load) with all that ``notes`` say; ``standing`` is brought up to date."""
    if notes.frame_counts is not UNSET:
        standing.frame_counts = notes.frame_counts
    if notes.below is not UNSET:
        standing.below = notes.below
    if notes.refusals is not UNSET:
        standing.refusals = notes.refusals
    t_us = inputs.t_us
    return Inputs(
        t_us=t_us,
        samples=inputs.samples,
        overruns=inputs.overruns,
        cpu_load=inputs.cpu_load,
        mavlink_rx=tuple(
            MavlinkFrame(link=d.link, client=d.client, sender=d.sender, reach=Reach(d.reach), data=data)
            for d, data in zip(notes.rx, datagrams, strict=True)
        ),
        between=tuple(Between(t_us=at, frames=count) for at, count in notes.between),
        notices=tuple(Event(t_us=at, severity=severity, text=text) for at, severity, text in notes.notices),
        troubles=tuple(DeviceTrouble(t_us=at, device=DeviceRole(d), text=text) for at, d, text in notes.troubles),
        pictures=tuple(
            PictureReport(
                t_us=at, verdict=FrameVerdict(verdict), contrast=c, white_fraction=white, black_fraction=black
            )
            for at, verdict, c, white, black in notes.pictures
        ),
        answers=tuple(Note(kind, number, fact) for kind, number, fact in notes.answers),
        faults=tuple(
            Fault(t_us=at, part=part, kind=kind, place=place, text=text, traceback=trace, inputs=given)
            for at, part, kind, place, text, trace, given in notes.faults
        ),
        camera=None if notes.camera is None else _camera(*notes.camera),
        stills=tuple(
            StoredStill(index=i, exposure_us=at, path=path, width_px=w, height_px=h, size=size, problem=problem)
            for i, at, path, w, h, size, problem in notes.stills
        ),
        log_lost=notes.log_lost,
        clock_jump_s=notes.clock_jump_s,
        frame_counts=standing.frame_counts,
        below=None if standing.below is None else _below(t_us, standing.below),
        refusals=standing.refusals,
    )


def _camera(frame_us: int | None, total_bytes: int, free_bytes: int, refusal: str) -> CameraReport:
    return CameraReport(frame_us=frame_us, total_bytes=total_bytes, free_bytes=free_bytes, refusal=refusal)


def _counts(counts: Mapping[str, int] | None) -> dict[str, int] | None:
    return None if counts is None else dict(counts)


def _flight_controller_note(t_us: int, below: FlightControllerState) -> FlightControllerNote:
    same = {name: getattr(below, name) for name in _SAME}
    return FlightControllerNote(authority=below.authority.value, late_us=t_us - below.t_us, **same)


def _below(t_us: int, note: FlightControllerNote) -> FlightControllerState:
    same = {name: getattr(note, name) for name in _SAME}
    return FlightControllerState(t_us=t_us - note.late_us, authority=Authority(note.authority), **same)
