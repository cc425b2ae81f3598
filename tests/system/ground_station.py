"""A ground station that does what QGroundControl does, message by message, and keeps what its operator would see.

The order, the timers and the tries are QGroundControl's (its sources: InitialConnectStateMachine, MavCommandQueue,
PlanManager, ParameterManager, FTPManager, LogDownload). ``trouble`` collects what would be a popup, a line in red, a
"Communication lost", or an answer that never came. A timer has run out when both clocks say so, the wall's and the
vehicle's own, and the vehicle has answered a PING that was sent after that: a machine that is busy is not silence.
"""

import contextlib
import json
import lzma
import math
import re
import socket
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from system_harness import RunningService

from autopilot.core.crc import file_crc32
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.core.plan_wire import item_message
from autopilot.mavlink.dialect import mav

NAN = math.nan
COMMAND_S, GENERAL_S, ITEM_S, PARAM_S, FTP_S, LOG_S, LIST_S = 1.2, 1.5, 0.25, 1.0, 1.0, 5.0, 5.0
LOST_S = 3.5
"""Without a HEARTBEAT a link is lost: of the vehicle's time, for a busy machine sends late what it sends."""
SHOWN_CHARS = 100
"""Of a text in its list of messages."""
NEEDED = {
    "px4": """SYS_AUTOSTART SYS_HAS_MAG CAL_GYRO0_ID CAL_ACC0_ID CAL_MAG0_ID CAL_MAG1_ID CAL_MAG2_ID COM_RC_IN_MODE
        RC_MAP_ROLL RC_MAP_PITCH RC_MAP_YAW RC_MAP_THROTTLE RC_MAP_FLAPS RC_MAP_AUX1 RC_MAP_AUX2 SYS_AUTOCONFIG
        MAV_SYS_ID COM_FLTMODE1 COM_FLTMODE2 COM_FLTMODE3 COM_FLTMODE4 COM_FLTMODE5 COM_FLTMODE6 BAT1_N_CELLS
        BAT1_V_EMPTY BAT1_V_CHARGED RTL_LAND_DELAY RTL_DESCEND_ALT RTL_RETURN_ALT NAV_DLL_ACT COM_RC_LOSS_T
        NAV_RCL_ACT COM_LOW_BAT_ACT CAL_MAG0_ROT CAL_MAG1_ROT CAL_MAG2_ROT SENS_BOARD_ROT SENS_BOARD_X_OFF
        SENS_BOARD_Y_OFF SENS_BOARD_Z_OFF SENS_DPRES_OFF RC_MAP_FLTMODE RC_MAP_ARM_SW RC_MAP_GEAR_SW RC_MAP_KILL_SW
        RC_MAP_LOITER_SW RC_MAP_OFFB_SW RC_MAP_RETURN_SW RC_ARMSWITCH_TH RC_GEAR_TH RC_KILLSWITCH_TH RC_LOITER_TH
        RC_OFFB_TH RC_RETURN_TH BAT1_SOURCE BAT1_V_LOAD_DROP FRAME_CONFIG SDLOG_MODE GF_ACTION GF_MAX_HOR_DIST
        GF_MAX_VER_DIST COM_DISARM_LAND CP_DIST COM_OBS_AVOID BAT_LOW_THR BAT_CRIT_THR BAT_EMERGEN_THR COM_DL_LOSS_T """
    + " ".join(f"RC{channel}_{name}" for channel in range(1, 19) for name in ("MIN", "TRIM", "MAX", "REV")),
    "ardusub": """COMPASS_DEV_ID COMPASS_DEV_ID2 COMPASS_DEV_ID3 COMPASS_USE COMPASS_USE2 COMPASS_USE3 COMPASS_OFS_X
        COMPASS_OFS_Y COMPASS_OFS_Z COMPASS_OFS2_X COMPASS_OFS2_Y COMPASS_OFS2_Z COMPASS_OFS3_X COMPASS_OFS3_Y
        COMPASS_OFS3_Z COMPASS_DEC INS_ACCOFFS_X INS_ACCOFFS_Y INS_ACCOFFS_Z BATT_CAPACITY BATT_MONITOR BATT_FS_LOW_ACT
        BATT_LOW_VOLT BATT_LOW_MAH ARMING_CHECK FS_EKF_ACTION FS_EKF_THRESH FS_GCS_ENABLE FS_LEAK_ENABLE FS_PILOT_INPUT
        FS_PILOT_TIMEOUT FS_PRESS_ENABLE FS_PRESS_MAX FS_TEMP_ENABLE FS_TEMP_MAX LEAK1_PIN LEAK1_LOGIC FRAME_CONFIG
        MNT_RC_IN_TILT MNT_RC_IN_ROLL MNT_RC_IN_PAN SERVO5_FUNCTION SERVO14_FUNCTION""",
    "generic": "",
}
"""What the plug-in of a profile asks its setup and summary pages to show."""

_CHUNK_CHARS = 50
Message = Any


class GroundStation:
    """One vehicle, as one ground station sees it. ``speed``: how much faster than real time the service runs."""

    def __init__(self, service: RunningService, port: int, profile: str, speed: float = 1.0) -> None:
        self.service, self.profile, self.speed = service, profile, speed
        self.trouble: list[str] = []
        self.texts: list[tuple[int, str]] = []
        self.allowed = ["reduce the CPU load"]
        """Patterns of texts that the operator is meant to see in red."""
        self.params: dict[str, tuple[float, int]] = {}
        self.count = 0
        self.modes: dict[str, int] = {}
        self.been: set[int] = set()
        """Modes that were told since it was cleared: one may be over before anybody looks."""
        self.metadata: dict[str, dict[str, Any]] = {}
        self.last: dict[str, Message] = {}
        self.hears = True
        self.beating = True
        self._parts: dict[int, str] = {}
        self._open(port)
        self._beat_s = 0.0
        self.heartbeat_s: float | None = None
        """When the last one came, by the vehicle's clock."""
        self._listeners: list[Callable[[Message], None]] = []

    def _open(self, port: int) -> None:
        self._codec = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))

    def close(self) -> None:
        self._socket.close()

    # The wire

    def send(self, message: Message) -> None:
        data = message.pack(self._codec)
        self._codec.seq = (self._codec.seq + 1) & 0xFF
        with contextlib.suppress(ConnectionError):
            self._socket.send(data)

    def poll(self, seconds: float = 0.02) -> None:
        """Hear what has come, HEARTBEAT every second."""
        now_s = time.monotonic()
        if self.beating and now_s - self._beat_s > 1.0 / max(self.speed, 1.0):
            self._beat_s = now_s
            self.send(mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3))
        self._socket.settimeout(seconds)
        try:
            data = self._socket.recv(65_535)
            self._socket.settimeout(0.0)
            while True:
                self._take(data)
                data = self._socket.recv(65_535)
        except (TimeoutError, BlockingIOError, ConnectionError):
            return

    def _take(self, data: bytes) -> None:
        if not self.hears:
            return
        for message in self._codec.parse_buffer(data) or ():
            name = message.get_type()
            if name == "BAD_DATA":
                self.trouble.append(f"damaged data from the vehicle: {message}")
                continue
            if name == "HEARTBEAT":
                self._on_heartbeat()
            self.last[name] = message
            if name in ("HEARTBEAT", "CURRENT_MODE"):
                self.been.add(message.custom_mode)
            if name == "STATUSTEXT":
                self._on_text(message)
            elif name == "PARAM_VALUE" and message.param_index != 0xFFFF:
                self.params[message.param_id] = (message.param_value, message.param_type)
                self.count = message.param_count
            for listener in tuple(self._listeners):
                listener(message)

    def _on_heartbeat(self) -> None:
        now_s, before_s = self.vehicle_s, self.heartbeat_s
        if before_s is not None and now_s - before_s > LOST_S * self.speed and self.hears:
            self.trouble.append(f"communication lost at {before_s:.1f} s")
        self.heartbeat_s = now_s

    def _on_text(self, message: Message) -> None:
        text = message.text
        if message.id:
            self._parts[message.id] = self._parts.get(message.id, "") + text
            if len(text) == _CHUNK_CHARS:
                return
            text = self._parts.pop(message.id)
        self.texts.append((message.severity, text))
        red = message.severity <= mav.MAV_SEVERITY_NOTICE
        if red and not any(re.search(pattern, text) for pattern in self.allowed):
            self.trouble.append(f"red: {text}")
        if red and len(text) > SHOWN_CHARS:
            self.trouble.append(f"cut: {text}")

    @property
    def vehicle_s(self) -> float:
        """The vehicle's own clock, as last heard."""
        newest = [m.time_boot_ms for m in self.last.values() if m.get_type() in ("ATTITUDE", "SYSTEM_TIME")]
        return max(newest, default=0) / 1e3

    # Questions

    def hear(
        self, message: Message | None, wanted: Callable[[Message], bool], timer_s: float, tries: int
    ) -> Message | None:
        """What answers; None when it has not come after so many tries, each with its timer."""
        found: list[Message] = []

        def listen(message: Message) -> None:
            if wanted(message):
                found.append(message)

        self._listeners.append(listen)
        try:
            for _ in range(tries):
                if message is not None:
                    self.send(message)
                self._wait(found, timer_s)
                if found:
                    return found[0]
        finally:
            self._listeners.remove(listen)
        return None

    def _wait(self, found: list[Message], timer_s: float) -> None:
        """Until something has been found, or the timer has run out for certain."""
        begin_s, vehicle_s = time.monotonic(), self.vehicle_s
        pinged = False
        answered: list[Message] = []
        self._listeners.append(lambda m: answered.append(m) if pinged and m.get_type() == "PING" else None)
        try:
            while not found:
                self.poll()
                self.service.keep_waiting(240.0)
                over = time.monotonic() - begin_s > timer_s and self.vehicle_s - vehicle_s > timer_s * self.speed
                if over and not pinged:
                    pinged = True
                    self.send(mav.MAVLink_ping_message(0, 77, 0, 0))
                elif pinged and answered:
                    return
        finally:
            self._listeners.pop()

    def until(self, done: Callable[[], bool], what: str, vehicle_s: float = 60.0) -> None:
        """Let time pass; trouble when it has not come true in so much of the vehicle's time."""
        begin_s = self.vehicle_s
        while not done():
            self.poll()
            self.service.keep_waiting(240.0)
            if self.vehicle_s - begin_s > vehicle_s:
                self.trouble.append(f"never: {what}")
                return

    def rest(self, vehicle_s: float) -> None:
        """So much of the vehicle's time."""
        begin_s = self.vehicle_s
        self.until(lambda: self.vehicle_s - begin_s >= vehicle_s, "time goes on", math.inf)

    def command(
        self,
        command: int,
        *params: float,
        frame: int | None = None,
        place: tuple[int, int, float] | None = None,
        tries: int = 1,
        silent: bool = False,
    ) -> int | None:
        """COMMAND_LONG (COMMAND_INT with ``place``), and its result; a refusal is a popup unless ``silent``."""
        filled = (*params, *(0.0,) * (7 - len(params)))
        if place is None:
            message = mav.MAVLink_command_long_message(1, 1, command, 0, *filled)
        else:
            message = mav.MAVLink_command_int_message(1, 1, frame, command, 0, 0, *filled[:4], *place)
        ack = self.hear(
            message,
            lambda m: m.get_type() == "COMMAND_ACK" and m.command == command and m.result != 5,
            COMMAND_S,
            tries,
        )
        if ack is None:
            self.trouble.append(f"popup: no response to command {command}")
            return None
        if ack.result != mav.MAV_RESULT_ACCEPTED and not silent:
            self.trouble.append(f"popup: command {command} result {ack.result}")
        if (ack.target_system, ack.target_component) != (255, 190):
            self.trouble.append(f"answer to somebody else: {ack}")
        return int(ack.result)

    def request(self, msg_id: int, name: str, number: float = 0.0, *, silent: bool = False) -> Message | None:
        """REQUEST_MESSAGE: the acknowledgement, then the message within a second of it."""
        got: list[Message] = []
        self._listeners.append(lambda m: got.append(m) if m.get_type() == name else None)
        try:
            result = self.command(512, msg_id, number, tries=3, silent=silent)
            if result == mav.MAV_RESULT_ACCEPTED and not got:
                self._wait(got, PARAM_S)
                if not got:
                    self.trouble.append(f"silent: {name} was promised and did not come")
        finally:
            self._listeners.pop()
        return got[0] if got else None

    # Connecting

    def connect(self) -> None:
        """What QGroundControl does with a vehicle that it sees for the first time."""
        self.meet()
        version = self.request(148, "AUTOPILOT_VERSION")
        self.request(300, "UNKNOWN_300")
        assert version is not None
        for bit in ("MISSION_FENCE", "MISSION_RALLY", "COMMAND_INT", "FTP"):
            if not version.capabilities & getattr(mav, f"MAV_PROTOCOL_CAPABILITY_{bit}"):
                self.trouble.append(f"page missing: capability {bit}")
        if self.profile == "px4" and version.flight_sw_version >> 8 < 0x010401:
            self.trouble.append("popup: firmware older than 1.4.1")
        if self.profile == "ardusub" and version.flight_sw_version >> 8 < 0x030503:
            self.trouble.append("red: pages of ArduSub before 3.5.3")
        self._read_modes()
        self._read_metadata()
        self.read_params()
        for kind in PlanKind:
            self.download(kind)
        self.send(mav.MAVLink_system_time_message(1_800_000_000_000_000, 0))
        self.send(mav.MAVLink_system_time_message(1_800_000_000_000_000, 0))
        if self.profile == "ardusub":
            self.send(mav.MAVLink_request_data_stream_message(1, 1, 0, 4, 1))
            for msg_id in (242, 245):
                self.command(511, msg_id, 1e6)
        # A gimbal manager and a camera are asked after without a popup when there is none.
        self.request(280, "GIMBAL_MANAGER_INFORMATION", silent=True)

    def meet(self) -> None:
        """Until the vehicle is there and has started."""
        self._beat_s = 0.0
        while "HEARTBEAT" not in self.last or self.last["HEARTBEAT"].system_status == mav.MAV_STATE_BOOT:
            self.poll()
            self.service.keep_waiting(240.0)
        while not self.vehicle_s:
            self.poll()
            self.service.keep_waiting(240.0)

    def _read_modes(self) -> None:
        index, total = 1, 1
        while index <= total:
            mode = self.request(435, "AVAILABLE_MODES", float(index))
            if mode is None:
                self.trouble.append(f"silent: mode {index}")
                return
            total, index = mode.number_modes, index + 1
            self.modes[mode.mode_name] = mode.custom_mode
            if mode.mode_name == "Hold" and mode.standard_mode != 0:
                self.trouble.append("Hold is shown as a standard mode with sticks")

    def _read_metadata(self) -> None:
        found = self.request(397, "COMPONENT_METADATA", silent=True)
        if found is None:
            found = self.request(395, "COMPONENT_INFORMATION", silent=True)
        if found is None:
            self.trouble.append("parameters without units")
            return
        uri, crc = (
            (found.uri, found.file_crc)
            if found.get_type() == "COMPONENT_METADATA"
            else (found.general_metadata_uri, found.general_metadata_file_crc)
        )
        general = self._metadata_file(uri, crc)
        for entry in general["metadataTypes"]:
            content = self._metadata_file(entry["uri"], entry["fileCrc"])
            if entry["type"] == 1:
                assert content["version"] == 1
                self.metadata = {parameter["name"]: parameter for parameter in content["parameters"]}

    def _metadata_file(self, uri: str, crc: int) -> dict[str, Any]:
        match = re.fullmatch(r"mftp://\[;comp=1\]/(.+)", uri.rstrip("\0"))
        assert match, uri
        data = self.fetch(match[1])
        if file_crc32(data) != crc:
            self.trouble.append(f"{match[1]}: the checksum is another one")
        unpacked = lzma.decompress(data) if match[1].endswith(".xz") else data
        content = json.loads(unpacked)
        assert isinstance(content, dict)
        return content

    def read_params(self) -> None:
        """The list, in the way of the profile's plug-in."""
        self.params.clear()
        if self.profile == "ardusub":
            self._read_packed()
        if self.profile == "px4":
            self.hear(
                mav.MAVLink_param_request_read_message(1, 0, b"_HASH_CHECK", -1),
                lambda m: m.get_type() == "PARAM_VALUE" and m.param_id == "_HASH_CHECK",
                PARAM_S,
                1,
            )
        if not self.params:
            first = self.hear(
                mav.MAVLink_param_request_list_message(1, 0), lambda m: m.get_type() == "PARAM_VALUE", LIST_S, 4
            )
            if first is None:
                self.trouble.append("popup: the vehicle does not give its parameters")
                return
            self.hear(None, lambda m: len(self.params) == self.count, 3.0, 5)
            if len(self.params) != self.count:
                self.trouble.append(f"popup: {self.count - len(self.params)} parameters did not come")
        missing = [name for name in NEEDED[self.profile].split() if name not in self.params]
        if missing:
            self.trouble.append(f"popup: parameters are missing from firmware: {', '.join(missing)}")
        bare = [name for name in self.params if name not in self.metadata]
        if bare:
            self.trouble.append(f"parameters without text or unit: {', '.join(bare[:5])}")

    def _read_packed(self) -> None:
        """ArduPilot's packed file of all parameters with their defaults."""
        data = self.fetch("@PARAM/param.pck?withdefaults=1")
        magic, count, total = struct.unpack_from("<HHH", data)
        assert magic == 0x671C and count == total, (magic, count, total)
        at, last = 6, b""
        sizes = {1: "b", 2: "h", 3: "i", 4: "f"}
        while at < len(data):
            if not data[at]:
                at += 1
                continue
            kind, flags = data[at] & 0xF, data[at] >> 4
            common, rest = data[at + 1] & 0xF, (data[at + 1] >> 4) + 1
            name = last[:common] + data[at + 2 : at + 2 + rest]
            at += 2 + rest
            (value,) = struct.unpack_from("<" + sizes[kind], data, at)
            at += struct.calcsize(sizes[kind]) * (2 if flags & 1 else 1)
            self.params[name.decode()], last = (float(value), {3: 6, 4: 9}.get(kind, kind)), name
        self.count = total
        assert len(self.params) == total

    # Files

    def fetch(self, path: str) -> bytes:
        """A file by MAVFTP: open, bursts, the holes by single reads, terminate."""
        opened = self._ftp(4, path.encode())
        if opened is None:
            self.trouble.append(f"popup: {path} cannot be opened")
            return b""
        (size,) = struct.unpack("<I", bytes(opened[12:16]))
        content: dict[int, bytes] = {}
        ended: list[bool] = []

        def listen(message: Message) -> None:
            if message.get_type() != "FILE_TRANSFER_PROTOCOL" or message.payload[5] != 15:
                return
            payload = bytes(message.payload)
            if payload[3] == 128:
                (offset,) = struct.unpack_from("<I", payload, 8)
                content[offset] = payload[12 : 12 + payload[4]]
                if payload[6]:
                    ended.append(False)
            else:
                ended.append(True)

        def have() -> int:
            at = 0
            while at in content:
                at += len(content[at])
            return at

        self._listeners.append(listen)
        try:
            silent = 0
            while have() < size and silent < 4:
                before = have()
                ended.clear()
                self._ftp_send(15, b"", before, 239)
                self._wait_progress(ended, content)
                silent = silent + 1 if have() == before else 0
        finally:
            self._listeners.remove(listen)
        if have() < size:
            self.trouble.append(f"popup: {path} did not come whole")
        self._ftp(1, b"")
        return b"".join(content[at] for at in sorted(content))[:size]

    def _wait_progress(self, ended: list[bool], content: dict[int, bytes]) -> None:
        """A burst: it goes on while something comes within the timer."""
        while not ended:
            count = len(content)
            came: list[Message] = []
            self._listeners.append(lambda m, count=count, came=came: came.append(m) if len(content) > count else None)
            try:
                self._wait(came if not ended else [ended], FTP_S)
            finally:
                self._listeners.pop()
            if not came:
                return

    def _ftp_send(self, opcode: int, data: bytes, offset: int = 0, size: int | None = None) -> int:
        self._ftp_seq = (getattr(self, "_ftp_seq", 0) + 1) & 0xFFFF
        payload = bytearray(251)
        struct.pack_into("<HBBBBBxI", payload, 0, self._ftp_seq, 0, opcode, size or len(data), 0, 0, offset)
        payload[12 : 12 + len(data)] = data
        self.send(mav.MAVLink_file_transfer_protocol_message(0, 1, 1, list(payload)))
        return self._ftp_seq

    def _ftp(self, opcode: int, data: bytes, offset: int = 0) -> bytes | None:
        """A request that is answered at once; None when it is refused."""
        for _ in range(3):
            seq = self._ftp_send(opcode, data, offset)

            def mine(message: Message, seq: int = seq) -> bool:
                return message.get_type() == "FILE_TRANSFER_PROTOCOL" and (
                    bytes(message.payload[:2]) == struct.pack("<H", (seq + 1) & 0xFFFF)
                )

            answer = self.hear(None, mine, FTP_S, 1)
            if answer is not None:
                return bytes(answer.payload) if answer.payload[3] == 128 else None
        self.trouble.append(f"silent: MAVFTP request {opcode} {data!r}")
        return None

    def folder(self, path: str) -> list[str]:
        names: list[str] = []
        while True:
            answer = self._ftp(3, path.encode(), len(names))
            if answer is None:
                return names
            names += [part.decode() for part in answer[12 : 12 + answer[4]].split(b"\0") if part]

    # Plans

    def download(self, kind: PlanKind) -> list[Message]:
        """A plan, and the closing ACK."""
        message = mav.MAVLink_mission_request_list_message(1, 1, int(kind))
        count = self.hear(message, lambda m: m.get_type() == "MISSION_COUNT" and m.mission_type == kind, GENERAL_S, 6)
        if count is None:
            self.trouble.append(f"popup: {kind.name} download: no response")
            return []
        items = []
        for seq in range(count.count):
            item = self.hear(
                mav.MAVLink_mission_request_int_message(1, 1, seq, int(kind)),
                lambda m, seq=seq: m.get_type() == "MISSION_ITEM_INT" and (m.seq, m.mission_type) == (seq, kind),
                ITEM_S,
                6,
            )
            if item is None:
                self.trouble.append(f"popup: {kind.name} download: item {seq} did not come")
                return items
            items.append(item)
        self.send(mav.MAVLink_mission_ack_message(1, 1, 0, int(kind)))
        return items

    def upload(self, kind: PlanKind, items: Sequence[PlanItem], home: PlanItem | None = None) -> int | None:
        """A plan; QGroundControl puts home before it for ArduPilot. The result, and a popup for what is not 0."""
        if kind is PlanKind.MISSION and self.profile == "ardusub" and items:
            home = home or PlanItem(seq=0, frame=0, command=16, x=379_755_000, y=237_790_000, z=0.0)
            jump = mav.MAV_CMD_DO_JUMP  # counts home too
            moved = (replace(item, param1=item.param1 + 1.0) if item.command == jump else item for item in items)
            items = (home, *moved)
        sent = [0]
        requested: list[int] = []
        done: list[int] = []

        def listen(message: Message) -> None:
            name = message.get_type()
            if name in ("MISSION_REQUEST_INT", "MISSION_REQUEST") and message.mission_type == kind:
                requested.append(message.seq)
                item = items[message.seq]
                current = kind is PlanKind.MISSION and message.seq == 0
                self.send(item_message(replace(item, seq=message.seq), kind, current=current))
                sent[0] += 1
            elif name == "MISSION_ACK" and message.mission_type == kind:
                done.append(message.type)

        self._listeners.append(listen)
        try:
            for _ in range(6):
                self.send(mav.MAVLink_mission_count_message(1, 1, len(items), int(kind)))
                before = -1
                while not done and sent[0] != before:
                    before = sent[0]
                    self._wait_for(lambda before=before: bool(done) or sent[0] > before, GENERAL_S)
                if done or requested:
                    break
        finally:
            self._listeners.remove(listen)
        if not done:
            self.trouble.append(f"popup: {kind.name} upload: the vehicle did not request all items")
            return None
        if done[0] != mav.MAV_MISSION_ACCEPTED:
            guilty = requested[-1] if requested else -1
            self.trouble.append(f"popup: {kind.name} transfer failed: {done[0]}, blamed on item {guilty}")
        elif set(requested) != set(range(len(items))):
            self.trouble.append(f"popup: {kind.name} accepted before its last item")
        return done[0]

    def _wait_for(self, done: Callable[[], bool], timer_s: float) -> None:
        came: list[Message] = []
        self._listeners.append(lambda m: came.append(m) if done() else None)
        try:
            self._wait(came, timer_s)
        finally:
            self._listeners.pop()

    # Flying

    @property
    def armed(self) -> bool:
        return bool(self.last["HEARTBEAT"].base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def mode(self) -> str:
        number = self.last["HEARTBEAT"].custom_mode
        return next((name for name, custom in self.modes.items() if custom == number), f"Custom:{number:#x}")

    @property
    def flying(self) -> bool:
        """Decides which buttons there are."""
        if self.profile == "ardusub":
            return bool(self.last["HEARTBEAT"].system_status in (4, 5, 6))
        state = self.last["EXTENDED_SYS_STATE"].landed_state
        return bool(state in (mav.MAV_LANDED_STATE_IN_AIR, mav.MAV_LANDED_STATE_TAKEOFF, mav.MAV_LANDED_STATE_LANDING))

    def ready(self) -> None:
        """Until the arm button works: the PREARM_CHECK bit of SYS_STATUS, and nothing in red beside it."""

        def good() -> bool:
            status = self.last.get("SYS_STATUS")
            return status is not None and bool(status.onboard_control_sensors_health & mav.MAV_SYS_STATUS_PREARM_CHECK)

        self.until(good, "ready to arm")
        status = self.last["SYS_STATUS"]
        sick = status.onboard_control_sensors_enabled & ~status.onboard_control_sensors_health
        if sick:
            self.trouble.append(f"red: sensors {sick:#x} in the list of sensors")

    def arm(self) -> None:
        """The arm slider: sent once."""
        if self.flying and not self.armed:
            self.trouble.append("a disarmed vehicle counts as flying: no arm button")
        self.command(400, 1.0)
        self.until(lambda: self.armed, "armed", 5.0)

    def set_mode(self, name: str) -> None:
        """The mode menu: SET_MODE to PX4, DO_SET_MODE to ArduPilot; generic has none."""
        number = self.modes[name]
        if self.profile == "px4":
            for _ in range(3):
                self.send(mav.MAVLink_set_mode_message(1, 1, number))
                self._wait_for(lambda: self.last["HEARTBEAT"].custom_mode == number, 1.3)
                if self.last["HEARTBEAT"].custom_mode == number:
                    return
            self.trouble.append(f"popup: vehicle failed to change to mode {name}")
            return
        self.command(176, 1.0, number)
        self.until(lambda: self.last["HEARTBEAT"].custom_mode == number, f"mode {name}", 3.0)

    def start_mission(self) -> None:
        """The start slider of each plug-in; generic has the action that is shipped."""
        if self.profile == "px4":
            self.set_mode("Mission")
            if not self.armed:
                self.arm()
        elif self.profile == "ardusub":
            self.set_mode("Guided")
            if not self.armed:
                self.arm()
            self.command(300)
        else:
            if not self.armed:
                self.arm()
            self.command(300)

    def pause(self) -> None:
        """PX4's: go-to without a place. ArduPilot's has no mode to go to; the operator takes the menu."""
        if self.profile == "px4":
            self.command(192, -1.0, 1.0, 0.0, NAN, NAN, NAN, NAN)
        elif self.profile == "ardusub":
            self.set_mode("Guided")
        else:
            self.command(193, 0.0)

    def go_to(self, lat_deg: float, lon_deg: float) -> None:
        """At the present altitude, as a float; to an ArduSub by an item of a mission."""
        position = self.last["GLOBAL_POSITION_INT"]
        if self.profile == "ardusub":
            place = lat_deg, lon_deg, position.relative_alt / 1e3
            item = mav.MAVLink_mission_item_message(1, 1, 0, 3, 16, 2, 1, 0, 0, 0, 0, *place)
            if self.hear(item, lambda m: m.get_type() == "MISSION_ACK", GENERAL_S, 1).type:
                self.trouble.append("popup: mission transfer failed")
            return
        (alt_m,) = struct.unpack("<f", struct.pack("<f", position.alt / 1e3))
        self.command(192, -1.0, 1.0, 0.0, NAN, frame=0, place=(round(lat_deg * 1e7), round(lon_deg * 1e7), alt_m))

    def change_altitude(self, by_m: float) -> None:
        if self.profile == "ardusub":
            self.send(
                mav.MAVLink_set_position_target_local_ned_message(
                    0, 1, 1, mav.MAV_FRAME_LOCAL_OFFSET_NED, 0xFFF8, 0.0, 0.0, -by_m, *(0.0,) * 8
                )
            )
            return
        alt_m = self.last["GLOBAL_POSITION_INT"].alt / 1e3 + by_m
        self.command(192, -1.0, 1.0, 0.0, NAN, NAN, NAN, alt_m)

    # Parameters

    def edit(self, name: str, value: float) -> bool:
        """The parameter editor: the value comes back, equal, within a second; two more tries. Whether it did."""
        _, kind = self.params[name]
        whole = kind != mav.MAV_PARAM_TYPE_REAL32
        wire = struct.unpack("<f", struct.pack("<i", int(value)))[0] if whole and self.profile != "ardusub" else value
        refused: list[Message] = []

        def answers(message: Message) -> bool:
            if message.get_type() == "PARAM_ERROR" and message.param_id == name:
                refused.append(message)
                return True
            return message.get_type() == "PARAM_VALUE" and message.param_id == name

        message = mav.MAVLink_param_set_message(1, 1, name.encode(), wire, kind)
        answer = self.hear(message, answers, PARAM_S, 3)
        self.poll()
        if answer is None:
            self.trouble.append(f"popup: parameter write failed: {name}")
            return False
        return not refused and struct.pack("<f", answer.param_value) == struct.pack("<f", wire)

    def read(self, name: str) -> Message:
        """The value in force."""
        message = mav.MAVLink_param_request_read_message(1, 1, name.encode(), -1)
        return self.hear(message, lambda m: m.get_type() == "PARAM_VALUE" and m.param_id == name, PARAM_S, 3)

    def value(self, name: str) -> float:
        """The value in force as its pages show it."""
        message = self.read(name)
        if message.param_type == mav.MAV_PARAM_TYPE_REAL32 or self.profile == "ardusub":
            return float(message.param_value)
        (whole,) = struct.unpack("<i", struct.pack("<f", message.param_value))
        return float(whole)

    # Logs

    def logs(self) -> list[Message]:
        """The log page: one entry for each log."""
        entries: dict[int, Message] = {}
        self._listeners.append(lambda m: entries.update({m.id: m}) if m.get_type() == "LOG_ENTRY" else None)
        try:
            self.send(mav.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
            self._wait_for(lambda: bool(entries) and len(entries) >= next(iter(entries.values())).num_logs, LOG_S)
        finally:
            self._listeners.pop()
        if not entries:
            self.trouble.append("silent: list of logs")
        return [entry for entry in entries.values() if entry.num_logs]

    def log_data(self, number: int, size: int) -> bytes:
        """A part of a log, holes asked for again after half a second."""
        parts: dict[int, bytes] = {}
        self._listeners.append(
            lambda m: (
                parts.update({m.ofs: bytes(m.data[: m.count])})
                if m.get_type() == "LOG_DATA" and m.id == number
                else None
            )
        )
        try:
            for _ in range(20):
                at = 0
                while parts.get(at):
                    at += len(parts[at])
                if at >= size:
                    break
                self.send(mav.MAVLink_log_request_data_message(1, 1, number, at, size - at))
                self._wait_for(lambda: sum(map(len, parts.values())) >= size, 0.5)
        finally:
            self._listeners.pop()
        self.send(mav.MAVLink_log_request_end_message(1, 1))
        return b"".join(parts[at] for at in sorted(parts))[:size]
