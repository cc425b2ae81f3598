"""Small services: PING, TIMESYNC, SYSTEM_TIME, and honest answers where there is nothing (file transfer, logs)."""

from pymavlink.dialects.v20 import development as mav

from autopilot.mavlink.context import Context, Peer
from autopilot.mavlink.wire import Message

FTP_NAK = 129
FTP_ACK = 128
"""MAVFTP reply opcodes (https://mavlink.io/en/services/ftp.html)."""
_FTP_TERMINATE, _FTP_LIST, _FTP_OPEN_READ, _FTP_RESET = 1, 3, 4, 2
_FTP_EOF, _FTP_UNKNOWN_COMMAND, _FTP_FILE_NOT_FOUND = 6, 7, 10
_FTP_HEADER_BYTES, _FTP_PAYLOAD_BYTES = 12, 251


class Utility:
    """Answers that need no state."""

    def __init__(self, ctx: Context) -> None:
        self._ctx = ctx
        self.utc_offset_us: int | None = None
        """Unix time minus the service's time [us], as a ground station gave it; None before."""

    def on_ping(self, peer: Peer, msg: Message) -> None:
        """PING: target 0/0 is a request; an addressed one is an answer and must not be answered."""
        if msg.target_system == 0 and msg.target_component == 0:
            self._ctx.send(peer, mav.MAVLink_ping_message(msg.time_usec, msg.seq, peer.sysid, peer.compid))

    def on_timesync(self, peer: Peer, msg: Message) -> None:
        """TIMESYNC: tc1 = 0 is a request, answered with our time in nanoseconds."""
        if msg.tc1 == 0:
            self._ctx.send(peer, mav.MAVLink_timesync_message(self._ctx.t_us * 1000, msg.ts1))

    def on_system_time(self, msg: Message) -> None:
        """SYSTEM_TIME of a ground station: kept for boards without a clock."""
        if msg.time_unix_usec:
            self.utc_offset_us = msg.time_unix_usec - self._ctx.t_us

    def system_time(self) -> Message | None:
        """SYSTEM_TIME: Unix time 0 while nobody has told it."""
        unix_us = 0 if self.utc_offset_us is None else max(self.utc_offset_us + self._ctx.t_us, 0)
        return mav.MAVLink_system_time_message(min(unix_us, 2**64 - 1), self._ctx.boot_ms)

    def on_file_transfer(self, peer: Peer, msg: Message) -> None:
        """FILE_TRANSFER_PROTOCOL: there are no files; a quick NAK lets clients fall back at once."""
        request = bytes(msg.payload)
        opcode = request[3]
        if opcode in (FTP_ACK, FTP_NAK):
            return
        errors = {_FTP_OPEN_READ: _FTP_FILE_NOT_FOUND, _FTP_LIST: _FTP_EOF}
        ok = opcode in (_FTP_TERMINATE, _FTP_RESET)
        reply = bytearray(_FTP_PAYLOAD_BYTES)
        reply[0:2] = ((int.from_bytes(request[0:2], "little") + 1) & 0xFFFF).to_bytes(2, "little")
        reply[2] = request[2]
        reply[3] = FTP_ACK if ok else FTP_NAK
        reply[5] = opcode
        if not ok:
            reply[4] = 1
            reply[_FTP_HEADER_BYTES] = errors.get(opcode, _FTP_UNKNOWN_COMMAND)
        self._ctx.send(peer, mav.MAVLink_file_transfer_protocol_message(0, peer.sysid, peer.compid, list(reply)))

    def on_log_request_list(self, peer: Peer) -> None:
        """LOG_REQUEST_LIST: no logs by this way."""
        self._ctx.send(peer, mav.MAVLink_log_entry_message(0, 0, 0, 0, 0))
