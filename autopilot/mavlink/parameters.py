"""Parameter protocol: list, read, set. Integers are encoded as the profile requires (bytewise union or C cast)."""

import struct
from dataclasses import dataclass

from pymavlink.dialects.v20 import development as mav

from autopilot.core import operator_messages as notices
from autopilot.core.clock import TICK_US
from autopilot.core.crc import file_crc32
from autopilot.core.errors import ConfigError
from autopilot.core.origin_params import shortest_decimal
from autopilot.core.params import ParamSpec, ParamType
from autopilot.mavlink.budget import LISTS
from autopilot.mavlink.context import Context, MavlinkPeer
from autopilot.mavlink.profiles import ParamEncoding
from autopilot.mavlink.stubs import Stubs, VehicleFacts
from autopilot.mavlink.wire import Message

PER_TICK = 6
"""PARAM_VALUEs of a list that go out per tick and client: 600/s, 19 kB/s."""
MAX_LISTS = 8
"""Clients that read the list at the same time; one more has to ask again."""

SLOW_DISK_US = 3_000_000
"""Delay after which a parameter still not on disk is reported."""

HASH_CHECK = "_HASH_CHECK"
"""PX4's cache check, asked by QGroundControl: it need not download what it has. A client that has it sets this back."""

PACKED_FILE = "param.pck"
"""ArduPilot's file of all parameters, below the folder ``@PARAM``."""
_PACKED, _PACKED_WITH_DEFAULTS = 0x671B, 0x671C
_PACKED_TYPES = {ParamType.INT32: (3, "<i"), ParamType.REAL32: (4, "<f")}

_INT32, _REAL32 = mav.MAV_PARAM_TYPE_INT32, mav.MAV_PARAM_TYPE_REAL32
_MISSING, _OUT_OF_RANGE = mav.MAV_PARAM_ERROR_DOES_NOT_EXIST, mav.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE
_READ_ONLY = 5
"""MAV_PARAM_ERROR_READ_ONLY (common.xml)."""
_TYPE_MISMATCH = 7
"""MAV_PARAM_ERROR_TYPE_MISMATCH (common.xml; newer than the packaged dialect)."""


def encode(value: float, kind: ParamType, encoding: ParamEncoding) -> float:
    if kind is ParamType.INT32 and encoding is ParamEncoding.BYTEWISE:
        (as_float,) = struct.unpack("<f", struct.pack("<i", int(value)))
        return float(as_float)
    return value


def decode(param_value: float, kind: ParamType, encoding: ParamEncoding) -> float:
    if kind is ParamType.INT32 and encoding is ParamEncoding.BYTEWISE:
        (as_int,) = struct.unpack("<i", struct.pack("<f", param_value))
        return float(as_int)
    return shortest_decimal(param_value)


@dataclass(slots=True, kw_only=True)
class _ParameterWrite:
    """A parameter being written to the disk."""

    number: int
    since_us: int
    reported: bool = False


class Parameters:
    def __init__(self, ctx: Context, vehicle: VehicleFacts) -> None:
        self._ctx = ctx
        self._stubs = Stubs(ctx.profile, ctx.params, vehicle)
        self._names = tuple(sorted((*ctx.params, *self._stubs.table)))
        self._index = {name: i for i, name in enumerate(self._names)}
        self._lists: dict[MavlinkPeer, int] = {}
        self._saving: dict[str, _ParameterWrite] = {}
        """Parameters being saved; reported when they are."""
        self._unsaved = False
        """Whether a loss at the next restart has been reported to the operator."""

    @property
    def specs(self) -> tuple[ParamSpec, ...]:
        """All that are offered, in the order of their index."""
        return tuple(self._spec(name) for name in self._names)

    def _spec(self, name: str) -> ParamSpec:
        stub = self._stubs.table.get(name)
        return self._ctx.params.spec(name) if stub is None else stub.spec

    def _now(self, name: str) -> float:
        return self._stubs.value(name) if name in self._stubs.table else self._ctx.params[name]

    def hash(self) -> int:
        """_HASH_CHECK: hash over names and values, as PX4 and QGroundControl compute it."""
        crc = 0
        for name in self._names:
            whole = self._spec(name).type is ParamType.INT32
            value = struct.pack("<i", int(self._now(name))) if whole else struct.pack("<f", self._now(name))
            crc = file_crc32(name.encode("ascii") + value, crc)
        return crc

    def packed_file(self, peer: MavlinkPeer, path: str) -> bytes | None:
        """``@PARAM/param.pck`` for profiles whose integers are C casts (ardusub): clients that have read it set all
        parameters as floats, which others refuse. MAVProxy and QGroundControl request ``?withdefaults=1``.
        """
        folder, _, file = path.partition("/")
        name, _, options = file.partition("?")
        if folder != "@PARAM" or name != PACKED_FILE:
            return None
        if self._ctx.profile.param_encoding is ParamEncoding.BYTEWISE:
            self._ctx.text(notices.PACKED_PARAMETERS(), peer)
            return None
        return self.packed(defaults="withdefaults=1" in options.split("&"))

    def packed(self, *, defaults: bool) -> bytes:
        """The content of ``@PARAM/param.pck``: per parameter its type (and, with a flag, that a default follows its
        value), how many characters of the name before it begins with, the rest of its name, its value."""
        head = _PACKED_WITH_DEFAULTS if defaults else _PACKED
        data, before = bytearray(struct.pack("<HHH", head, len(self._names), len(self._names))), b""
        for text in self._names:
            name, spec, now = text.encode("ascii"), self._spec(text), self._now(text)
            code, form = _PACKED_TYPES[spec.type]
            with_default = defaults and now != spec.default
            common = next((n for n, (a, b) in enumerate(zip(name, before, strict=False)) if a != b), len(before))
            common = min(common, len(name) - 1, 15)
            data += bytes((code | with_default << 4, common | (len(name) - common - 1) << 4)) + name[common:]
            for number in (now, spec.default)[: 1 + with_default]:
                data += struct.pack(form, int(number) if spec.type is ParamType.INT32 else number)
            before = name
        return bytes(data)

    def value(self, name: str) -> Message:
        ctx = self._ctx
        kind = self._spec(name).type
        return mav.MAVLink_param_value_message(
            name.encode("ascii"),
            encode(self._now(name), kind, ctx.profile.param_encoding),
            _INT32 if kind is ParamType.INT32 else _REAL32,
            len(self._names),
            self._index[name],
        )

    def on_request_list(self, peer: MavlinkPeer) -> None:
        """PARAM_REQUEST_LIST: the list is sent over the next ticks."""
        if peer in self._lists or len(self._lists) < MAX_LISTS:
            self._lists[peer] = 0

    def known_value(self, name: str) -> Message | None:
        """PARAM_VALUE, None for a name that does not exist."""
        return self.value(name) if name in self._index else None

    def on_request_read(self, peer: MavlinkPeer, msg: Message) -> None:
        """PARAM_REQUEST_READ by index, or by name when the index is -1."""
        if msg.param_index == -1:
            name = msg.param_id
            if name == HASH_CHECK:
                self._answer_hash(peer)
                return
        elif 0 <= msg.param_index < len(self._names):
            name = self._names[msg.param_index]
        else:
            name = ""
        if name not in self._index:
            self._refuse(peer, msg.param_id, msg.param_index, _MISSING)
            return
        self._ctx.send(peer, self.value(name))

    def on_set(self, peer: MavlinkPeer, msg: Message) -> None:
        """PARAM_SET: the value is broadcast once it is on disk, a refusal at once with its reason."""
        ctx, name = self._ctx, msg.param_id
        if name == HASH_CHECK:
            self._lists.pop(peer, None)  # the client has found its own list to be this one
            return
        if name not in self._index:
            self._refuse(peer, name, -1, _MISSING)
            ctx.say(notices.PARAMETER_UNKNOWN(name=name), peer)
            return
        if name in self._stubs.table:
            self._refuse(peer, name, self._index[name], _READ_ONLY)
            decides = self._stubs.table[name].follows
            remedy = f"set {decides}" if decides else "it has no effect here"
            ctx.say(notices.PARAMETER_STUB(name=name, remedy=remedy), peer)
            ctx.broadcast(self.value(name))
            return
        number: int | None = None
        spec = ctx.params.spec(name)
        if not self._type_fits(spec, msg.param_type):
            self._refuse(peer, name, self._index[name], _TYPE_MISMATCH)
            ctx.say(notices.PARAMETER_TYPE(name=name, type=spec.type.value), peer)
        elif self._change(peer, name, decode(msg.param_value, spec.type, ctx.profile.param_encoding)):
            number = None if ctx.saving is None else ctx.saving.save(ctx.t_us // TICK_US, name)
        if number is None:
            ctx.broadcast(self.value(name))
        else:
            self._saving[name] = _ParameterWrite(number=number, since_us=ctx.t_us)

    def on_extended(self, peer: MavlinkPeer, msg: Message) -> None:
        """PARAM_EXT_REQUEST_READ, _LIST, _SET: for parameters longer than 32 bits, which there are none of. A list has
        no answer that refuses it, only the text, which is limited; the protocol has none for reading either, but
        PARAM_ERROR says that there is no such parameter."""
        self._ctx.text(notices.EXTENDED_PARAMETERS(), peer)
        number = msg.get_msgId()
        if number == mav.MAVLINK_MSG_ID_PARAM_EXT_REQUEST_READ:
            self._refuse(peer, msg.param_id, msg.param_index, _MISSING)
        elif number == mav.MAVLINK_MSG_ID_PARAM_EXT_SET:
            name, value = (text.encode("ascii", errors="replace") for text in (msg.param_id, msg.param_value))
            refused = mav.PARAM_ACK_VALUE_UNSUPPORTED
            self._ctx.send(peer, mav.MAVLink_param_ext_ack_message(name, value, msg.param_type, refused))

    def reset(self) -> int:
        """Set every parameter to its default and save; returns the number changed. Parameters with joint checks are
        repeated until none is refused because of another's old value.
        """
        ctx = self._ctx
        changed = [name for name in ctx.params if ctx.params[name] != ctx.params.spec(name).default]
        left = changed
        while left:
            refused = []
            for name in left:
                try:
                    ctx.params.set(name, ctx.params.spec(name).default)
                except ConfigError:
                    refused.append(name)
            if len(refused) == len(left):
                break
            left = refused
        for name in changed:
            if ctx.saving is not None:
                ctx.saving.save(ctx.t_us // TICK_US, name)
            for shown in (name, *self._stubs.followers(name)):
                ctx.broadcast(self.value(shown))
        return len(changed) - len(left)

    def _answer_hash(self, peer: MavlinkPeer) -> None:
        """_HASH_CHECK, where integers travel bytewise; silence means "no cache"."""
        if self._ctx.profile.param_encoding is ParamEncoding.BYTEWISE:
            (value,) = struct.unpack("<f", struct.pack("<I", self.hash()))
            uint32 = mav.MAV_PARAM_TYPE_UINT32
            message = mav.MAVLink_param_value_message(HASH_CHECK.encode(), value, uint32, len(self._names), 0xFFFF)
            self._ctx.send(peer, message)

    def _type_fits(self, spec: ParamSpec, wire_type: int) -> bool:
        if self._ctx.profile.param_encoding is ParamEncoding.C_CAST:
            return bool(mav.MAV_PARAM_TYPE_UINT8 <= wire_type <= mav.MAV_PARAM_TYPE_REAL64)
        return bool(wire_type == (_INT32 if spec.type is ParamType.INT32 else _REAL32))

    def _change(self, peer: MavlinkPeer, name: str, value: float) -> bool:
        ctx = self._ctx
        before = ctx.params[name]
        try:
            ctx.params.set(name, value)
        except ConfigError as error:
            self._refuse(peer, name, self._index[name], _OUT_OF_RANGE)
            ctx.say(notices.REFUSED(reason=str(error)), peer)
            return False
        if ctx.params[name] != before:
            ctx.log(notices.PARAMETER_SET(name=name, value=ctx.params[name], before=before))
            for follower in self._stubs.followers(name):
                ctx.broadcast(self.value(follower))
        return True

    def _refuse(self, peer: MavlinkPeer, name: str, index: int, error: int) -> None:
        self._ctx.send(
            peer,
            mav.MAVLink_param_error_message(
                peer.sysid, peer.compid, name.encode("ascii", errors="replace")[:16], index, error
            ),
        )

    def _report_saved(self) -> None:
        """Broadcast the values saved, and those whose saving failed."""
        ctx = self._ctx
        saved = None if ctx.saving is None else ctx.saving.saved(ctx.t_us // TICK_US)
        if saved is not None:
            done = [name for name, request in self._saving.items() if request.number <= saved.number]
            for name in done:
                del self._saving[name]
                ctx.broadcast(self.value(name))
            if not saved.failure and self._unsaved:
                self._unsaved = False
                ctx.say(notices.PARAMETERS_SAVED())
            if saved.failure and done:
                self._unsaved = True
                ctx.say(notices.PARAMETERS_NOT_SAVED(failure=saved.failure, names=", ".join(done)))
        for name, request in self._saving.items():
            if not request.reported and ctx.t_us - request.since_us > SLOW_DISK_US * ctx.patience:
                request.reported = True
                ctx.say(notices.PARAMETER_NOT_ON_DISK(name=name))

    @property
    def listing(self) -> bool:
        """Whether a client is being sent a list."""
        return bool(self._lists)

    def tick(self) -> None:
        """Report saved values, continue requested lists."""
        self._report_saved()
        if not self._lists:
            return
        for peer, start in tuple(self._lists.items()):
            stop = start
            while stop < min(start + PER_TICK, len(self._names)) and self._ctx.has_capacity(peer.link, LISTS):
                self._ctx.send(peer, self.value(self._names[stop]))
                stop += 1
            if stop < len(self._names):
                self._lists[peer] = stop
            else:
                del self._lists[peer]
