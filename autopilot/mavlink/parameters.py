"""Parameter protocol: list, read, set. Integers travel as the profile says (bytewise union or C cast)."""

import math
import struct

from pymavlink.dialects.v20 import development as mav

from autopilot.core.errors import ConfigError
from autopilot.core.messages import Severity
from autopilot.core.params import ParamSpec, ParamType
from autopilot.mavlink.context import Context, Peer
from autopilot.mavlink.profiles import ParamEncoding
from autopilot.mavlink.wire import Message

PER_TICK = 4
"""PARAM_VALUEs of a list that go out per tick and client: 400/s, 13 kB/s."""
MAX_LISTS = 8
"""Clients that read the list at the same time; one more has to ask again."""

HASH_CHECK = "_HASH_CHECK"
"""PX4's cache check, asked by QGroundControl. Silence means "no cache" (parameter protocol)."""

_INT32, _REAL32 = mav.MAV_PARAM_TYPE_INT32, mav.MAV_PARAM_TYPE_REAL32
_MISSING, _OUT_OF_RANGE = mav.MAV_PARAM_ERROR_DOES_NOT_EXIST, mav.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE
_TYPE_MISMATCH = 7
"""MAV_PARAM_ERROR_TYPE_MISMATCH (common.xml; newer than the packaged dialect)."""


def shortest_decimal(value: float) -> float:
    """The shortest decimal number that is this float32: 0.3 and not 0.30000001192092896."""
    if not math.isfinite(value):
        return value
    wire = struct.pack("<f", value)
    for digits in range(6, 9):
        short = float(f"{value:.{digits}g}")
        if abs(short) < 3.4e38 and struct.pack("<f", short) == wire:
            return short
    return value


def encode(value: float, kind: ParamType, encoding: ParamEncoding) -> float:
    """A value as it stands in param_value."""
    if kind is ParamType.INT32 and encoding is ParamEncoding.BYTEWISE:
        (as_float,) = struct.unpack("<f", struct.pack("<i", int(value)))
        return float(as_float)
    return value


def decode(param_value: float, kind: ParamType, encoding: ParamEncoding) -> float:
    """A value out of param_value."""
    if kind is ParamType.INT32 and encoding is ParamEncoding.BYTEWISE:
        (as_int,) = struct.unpack("<i", struct.pack("<f", param_value))
        return float(as_int)
    return shortest_decimal(param_value)


class Parameters:
    """The parameter microservice."""

    def __init__(self, ctx: Context) -> None:
        self._ctx = ctx
        self._names = tuple(ctx.params)
        self._index = {name: i for i, name in enumerate(self._names)}
        self._lists: dict[Peer, int] = {}
        self.changed = False
        """A client has changed a value; the runtime saves the set and clears the flag."""

    def value(self, name: str) -> Message:
        """PARAM_VALUE of a parameter that exists."""
        ctx = self._ctx
        kind = ctx.params.spec(name).type
        return mav.MAVLink_param_value_message(
            name.encode("ascii"),
            encode(ctx.params[name], kind, ctx.profile.param_encoding),
            _INT32 if kind is ParamType.INT32 else _REAL32,
            len(self._names),
            self._index[name],
        )

    def on_request_list(self, peer: Peer) -> None:
        """PARAM_REQUEST_LIST: the list goes out over the next ticks."""
        if peer in self._lists or len(self._lists) < MAX_LISTS:
            self._lists[peer] = 0

    def on_request_read(self, peer: Peer, msg: Message) -> None:
        """PARAM_REQUEST_READ by index, or by name when the index is -1."""
        if msg.param_index == -1:
            name = msg.param_id
            if name == HASH_CHECK:
                return
        elif 0 <= msg.param_index < len(self._names):
            name = self._names[msg.param_index]
        else:
            name = ""
        if name not in self._index:
            self._refuse(peer, msg.param_id, msg.param_index, _MISSING)
            return
        self._ctx.send(peer, self.value(name))

    def on_set(self, peer: Peer, msg: Message) -> None:
        """PARAM_SET: the value in force goes to everyone, a refusal also says why."""
        ctx, name = self._ctx, msg.param_id
        if name == HASH_CHECK:
            return
        if name not in self._index:
            self._refuse(peer, name, -1, _MISSING)
            return
        spec = ctx.params.spec(name)
        if not self._type_fits(spec, msg.param_type):
            self._refuse(peer, name, self._index[name], _TYPE_MISMATCH)
            ctx.say(Severity.WARNING, f"parameter {name} is {spec.type.value}: other types are refused", peer)
        else:
            self._change(peer, name, decode(msg.param_value, spec.type, ctx.profile.param_encoding))
        ctx.broadcast(self.value(name))

    def _type_fits(self, spec: ParamSpec, wire_type: int) -> bool:
        if self._ctx.profile.param_encoding is ParamEncoding.C_CAST:
            return bool(mav.MAV_PARAM_TYPE_UINT8 <= wire_type <= mav.MAV_PARAM_TYPE_REAL64)
        return bool(wire_type == (_INT32 if spec.type is ParamType.INT32 else _REAL32))

    def _change(self, peer: Peer, name: str, value: float) -> None:
        ctx = self._ctx
        before = ctx.params[name]
        try:
            ctx.params.set(name, value)
        except ConfigError as error:
            self._refuse(peer, name, self._index[name], _OUT_OF_RANGE)
            ctx.say(Severity.WARNING, str(error), peer)
            return
        if ctx.params[name] != before:
            self.changed = True
            ctx.log(Severity.INFO, f"parameter {name} = {ctx.params[name]:g} (was {before:g})")

    def _refuse(self, peer: Peer, name: str, index: int, error: int) -> None:
        self._ctx.send(
            peer,
            mav.MAVLink_param_error_message(
                peer.sysid, peer.compid, name.encode("ascii", errors="replace")[:16], index, error
            ),
        )

    def tick(self) -> None:
        """Go on with lists that were asked for."""
        if not self._lists:
            return
        for peer, start in tuple(self._lists.items()):
            stop = min(start + PER_TICK, len(self._names))
            for name in self._names[start:stop]:
                self._ctx.send(peer, self.value(name))
            if stop < len(self._names):
                self._lists[peer] = stop
            else:
                del self._lists[peer]
