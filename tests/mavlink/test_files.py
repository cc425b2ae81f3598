"""File transfer, logs and metadata over the real server, with pymavlink's packing and a real folder of logs."""

import binascii
import hashlib
import json
import lzma
import os
import random
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from mavlink_harness import Client, World, both_ways, mav

from autopilot.core.background import BackgroundWorker
from autopilot.core.crc import file_crc32
from autopilot.core.params import PARAMETERS, ParamType
from autopilot.log.directory_reader import LogDirectoryReader
from autopilot.mavlink.ftp import Error, Op
from autopilot.mavlink.stubs import STUBS
from tests.lossy_link import LinkConditions, LossyLink

HEADER = struct.Struct("<HBBBBBxI")


def crc32_of_the_specification(data: bytes) -> int:
    """Bit by bit, as the specification's table is made."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xEDB88320 if crc & 1 else 0)
    return crc


def a_log(folder: Path, name: str, size: int, seed: int = 1) -> bytes:
    """A file of random bytes at ``folder / name``."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    data = random.Random(seed).randbytes(size)
    path.write_bytes(data)
    return data


@pytest.fixture(name="folder")
def folder_fixture(tmp_path: Path) -> Path:
    folder = tmp_path / "logs"
    folder.mkdir()
    return folder


def world_with(folder: Path, profile: str = "px4", **kwargs: Any) -> World:
    return World(profile, log_directory=LogDirectoryReader(folder, BackgroundWorker()), **kwargs)


class Ftp:
    """A client of file transfer that repeats what is not answered, as the specification wants it to."""

    def __init__(self, client: Client) -> None:
        self.client, self.seq = client, 0

    def send(self, opcode: int, *, offset: int = 0, data: bytes = b"", size: int | None = None) -> None:
        payload = bytearray(251)
        HEADER.pack_into(payload, 0, self.seq, 0, opcode, len(data) if size is None else size, 0, 0, offset)
        payload[12 : 12 + len(data)] = data
        self.client.send(mav.MAVLink_file_transfer_protocol_message(0, 1, 1, list(payload)))

    def answers(self, to: int | None = None) -> list[tuple[int, int, int, bytes]]:
        """Opcode, end of burst, offset and data of what came, or of what came in answer to that request."""
        out = []
        for message in self.client.got("FILE_TRANSFER_PROTOCOL"):
            raw = bytes(message.payload)
            seq, _, opcode, size, asked, complete, offset = HEADER.unpack_from(raw)
            if to is None or (asked == to and seq == (self.seq + 1) & 0xFFFF):
                out.append((opcode, complete, offset, raw[12 : 12 + size]))
        return out

    def ask(self, opcode: int, *, offset: int = 0, data: bytes = b"", size: int | None = None) -> tuple[int, bytes]:
        """Opcode and data of the answer."""
        self.seq = (self.seq + 1) & 0xFFFF
        for _ in range(40):
            self.client.rx.clear()
            self.send(opcode, offset=offset, data=data, size=size)
            for _ in range(8):
                self.client.world.tick()
                if answers := self.answers(opcode):
                    return answers[0][0], answers[0][3]
        raise AssertionError("no answer")

    def get(self, path: str) -> bytes:
        """A whole file by bursts, its holes by single reads."""
        opcode, size = self.ask(Op.OPEN_READ, data=path.encode())
        assert opcode == Op.ACK, size
        total = int.from_bytes(size, "little")
        pieces: dict[int, bytes] = {}
        offset = 0
        while offset < total:
            self.seq, ended = (self.seq + 1000) & 0xFFFF, False
            self.client.rx.clear()
            self.send(Op.BURST, offset=offset, size=239)
            silent = 0
            while not ended and silent < 30:
                self.client.rx.clear()
                self.client.world.tick()
                answers = self.answers()
                silent = 0 if answers else silent + 1
                for code, complete, at, data in answers:
                    if code == Op.ACK:
                        pieces[at] = data
                    ended = ended or bool(complete) or code == Op.NAK
            offset = max((at + len(data) for at, data in pieces.items()), default=0)
        whole = bytearray()
        while len(whole) < total:
            piece = pieces.get(len(whole))
            if piece is None:
                code, piece = self.ask(Op.READ, offset=len(whole), size=239)
                assert code == Op.ACK
                piece = piece[: next((at for at in sorted(pieces) if at > len(whole)), total) - len(whole)]
            whole += piece
        return bytes(whole)


def test_the_checksum_is_the_specifications() -> None:
    data = random.Random(3).randbytes(5000)
    assert file_crc32(data) == crc32_of_the_specification(data) != binascii.crc32(data)
    assert file_crc32(data[700:], file_crc32(data[:700])) == file_crc32(data)


@pytest.mark.parametrize("profile", ["px4", "generic", "ardusub"])
def test_a_ground_station_learns_names_units_ranges_and_choices(client: Client, profile: str) -> None:
    described = {}
    client.on_message = lambda m: described.update({m.get_type(): m})
    assert client.command(512, 395.0) == 0
    assert client.command(512, 397.0) == 0
    found, older = described["COMPONENT_METADATA"], described["COMPONENT_INFORMATION"]
    assert (older.general_metadata_uri, older.general_metadata_file_crc) == (found.uri, found.file_crc)
    client.on_message = None

    def fetched(uri: str, crc: int) -> Any:
        data = Ftp(client).get(uri.removeprefix("mftp://[;comp=1]"))
        assert crc32_of_the_specification(data) == crc
        return json.loads(lzma.decompress(data))

    general = fetched(found.uri, found.file_crc)
    assert general["version"] == 1
    place, events = general["metadataTypes"]
    assert (place["type"], events["type"]) == (1, 4) and fetched(events["uri"], events["fileCrc"])["version"] == 2
    told = {entry["name"]: entry for entry in fetched(place["uri"], place["fileCrc"])["parameters"]}
    listed = client.ask(mav.MAVLink_param_request_list_message(1, 0), "PARAM_VALUE", 2.0)
    assert {m.param_id for m in listed} == set(told)
    assert len(told) == len(PARAMETERS) + (len(STUBS.get(profile, {})))
    for spec in PARAMETERS:
        entry = told[spec.name]
        assert (entry["type"] == "Int32") == (spec.type is ParamType.INT32)
        assert (entry["min"], entry["max"], entry["default"]) == (spec.minimum, spec.maximum, spec.default)
        assert entry.get("units", "") == spec.unit and entry["longDesc"] == spec.help and entry["group"] == spec.group
    assert told["FS_CRASH_CHECK"]["values"][4] == {"value": 4, "description": "surface"}
    assert told["EST_SHADOW"]["rebootRequired"] and not told["THR_LIMIT"]["rebootRequired"]


def test_choices_are_told_for_every_value_or_not_at_all() -> None:
    for spec in PARAMETERS:
        if spec.values:
            assert list(spec.values) == list(range(int(spec.minimum), int(spec.maximum) + 1)), spec.name
    told = {spec.name for spec in PARAMETERS if spec.values}
    assert {"FS_BATT_ACT", "MPC_TIGHTEN", "WP_STUCK_ACT", "EST_SHADOW"} <= told and "SYSID_THISMAV" not in told


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_logs_arrive_whole_by_file_transfer(folder: Path, loss: float) -> None:
    sent = a_log(folder, "2026-11-22/10_00_00.mcap", 150_000)
    world = world_with(folder)
    ftp = Ftp(world.client(**both_ways(1, loss, loss, 0.02 if loss else 0.0)))
    got = ftp.get("@MAV_LOG/2026-11-22/10_00_00.mcap")
    assert hashlib.sha256(got).digest() == hashlib.sha256(sent).digest()
    opcode, crc = ftp.ask(Op.CRC32, data=b"/@MAV_LOG/2026-11-22/10_00_00.mcap")
    assert opcode == Op.ACK and int.from_bytes(crc, "little") == crc32_of_the_specification(sent)


def listed(ftp: Ftp, path: str) -> list[bytes]:
    """All entries of a folder."""
    entries: list[bytes] = []
    while True:
        opcode, data = ftp.ask(Op.LIST, offset=len(entries), data=path.encode())
        if opcode == Op.NAK:
            assert data == bytes((Error.EOF,))
            return entries
        entries += data.rstrip(b"\0").split(b"\0")


@pytest.mark.parametrize("beyond", [-1, 0, 1, 500])
def test_of_a_log_beyond_32_bits_as_much_is_offered_as_they_reach(folder: Path, beyond: int) -> None:
    a_log(folder, "2026-11-22/10_00_00.mcap", 500)
    size = 2**32 + beyond
    with (folder / "2026-11-22/10_00_00.mcap").open("r+b") as file:
        file.truncate(size)
    client = world_with(folder).client()
    opcode, told = Ftp(client).ask(Op.OPEN_READ, data=b"@MAV_LOG/2026-11-22/10_00_00.mcap")
    assert (opcode, int.from_bytes(told, "little")) == (Op.ACK, min(size, 2**32 - 1))
    (entry,) = client.ask(mav.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF), "LOG_ENTRY", 0.2)
    assert entry.size == min(size, 2**32 - 1)


def test_folders_list_themselves(folder: Path) -> None:
    for n in range(40):
        a_log(folder, f"2026-11-22/10_00_{n:02}.mcap", n + 1)
    a_log(folder, "2026-11-23/10_00_00.tlog", 7)
    (folder / "2026-11-23" / "notes.txt").write_text("mine")
    ftp = Ftp(world_with(folder).client())
    root = listed(ftp, "/")
    assert root[0] == b"D@MAV_LOG" and any(line.startswith(b"Fgeneral.json.xz\t") for line in root)
    assert listed(ftp, "@MAV_LOG") == [b"D2026-11-22", b"D2026-11-23"]
    assert listed(ftp, "/@MAV_LOG/2026-11-22/") == [f"F10_00_{n:02}.mcap\t{n + 1}".encode() for n in range(40)]
    assert listed(ftp, "@MAV_LOG/2026-11-23") == [b"F10_00_00.tlog\t7"]
    assert ftp.ask(Op.LIST, data=b"@MAV_LOG/2026-11-24") == (Op.NAK, bytes((Error.NOT_FOUND,)))


def test_a_name_that_cannot_be_listed_hides_none_behind_it(folder: Path) -> None:
    names = (b"10_00_00.mcap", b"a" * 245 + b".mcap", b"b\tc.mcap", "\u00fc\u2603.mcap".encode(), b"\xff.mcap")
    (folder / "2026-11-22").mkdir()
    for name in names:
        Path(os.fsdecode(os.fsencode(folder / "2026-11-22") + b"/" + name)).write_bytes(b"log")
    client = world_with(folder).client()
    assert sorted(listed(Ftp(client), "@MAV_LOG/2026-11-22")) == sorted(
        [b"F10_00_00.mcap\t3", b"S", b"S", b"S", "F\u00fc\u2603.mcap\t3".encode()]
    )


def test_nothing_outside_of_the_folder_is_read_and_nothing_is_written(folder: Path) -> None:
    a_log(folder, "2026-11-22/10_00_00.mcap", 10)
    secret = a_log(folder.parent, "secret.mcap", 10, seed=2)
    (folder / "2026-11-22" / "link.mcap").symlink_to(folder.parent / "secret.mcap")
    (folder / "notes.txt").write_text("mine")
    ftp = Ftp(world_with(folder).client())
    for path in (
        *(
            "@MAV_LOG/../secret.mcap",
            "../secret.mcap",
            "@MAV_LOG/2026-11-22/../../../secret.mcap",
            "@MAV_LOG/notes.txt",
        ),
        *(str(folder.parent / "secret.mcap"), f"@MAV_LOG/{folder.parent}/secret.mcap", "@MAV_LOG/2026-11-22/link.mcap"),
        *("/etc/passwd", "@MAV_LOG", "@MAV_LOG/\0x", "", "/", "@PARAM/param.pck", "general.json.xz/x", "\udcff"),
    ):
        for opcode in (Op.OPEN_READ, Op.CRC32):
            data = path.encode("utf-8", errors="surrogateescape")
            assert ftp.ask(opcode, data=data) == (Op.NAK, bytes((Error.NOT_FOUND,))), path
    before = sorted(folder.rglob("*"))
    for opcode in (Op.CREATE, Op.WRITE, Op.REMOVE, Op.MAKE_FOLDER, Op.REMOVE_FOLDER, Op.OPEN_WRITE, Op.RENAME):
        assert ftp.ask(opcode, data=b"@MAV_LOG/2026-11-22/10_00_00.mcap") == (Op.NAK, bytes((Error.PROTECTED,)))
    assert ftp.ask(77)[0] == Op.NAK
    assert ftp.ask(Op.READ, size=10) == (Op.NAK, bytes((Error.INVALID_SESSION,)))
    assert sorted(folder.rglob("*")) == before and (folder.parent / "secret.mcap").read_bytes() == secret


def test_a_request_that_comes_again_gets_the_same_answer(folder: Path) -> None:
    a_log(folder, "2026-11-22/10_00_00.mcap", 1000)
    world = world_with(folder)
    client = world.client()
    ftp = Ftp(client)
    ftp.ask(Op.OPEN_READ, data=b"@MAV_LOG/2026-11-22/10_00_00.mcap")
    ftp.ask(Op.READ, offset=239, size=239)
    client.rx.clear()
    for _ in range(3):
        ftp.send(Op.READ, offset=239, size=239)
    world.run(0.1)
    assert len(set(ftp.answers())) == 1 and len(ftp.answers()) == 3
    assert ftp.ask(Op.READ, offset=1000, size=239) == (Op.NAK, bytes((Error.EOF,)))
    anew = Ftp(client)  # a client that is started again counts from the same number
    for path, answer in ((b"/", Op.ACK), (b"/nowhere", Op.NAK)):
        anew.seq = 0
        assert anew.ask(Op.LIST, data=path)[0] == answer
    assert ftp.ask(Op.RESET)[0] == Op.ACK
    assert ftp.ask(Op.READ, offset=0, size=239) == (Op.NAK, bytes((Error.INVALID_SESSION,)))


def test_a_log_that_goes_while_it_is_read_is_told(folder: Path) -> None:
    a_log(folder, "2026-11-22/10_00_00.mcap", 200_000)
    ftp = Ftp(world_with(folder).client())
    assert ftp.ask(Op.OPEN_READ, data=b"@MAV_LOG/2026-11-22/10_00_00.mcap")[0] == Op.ACK
    (folder / "2026-11-22" / "10_00_00.mcap").unlink()
    assert ftp.ask(Op.READ, offset=150_000, size=239) == (Op.NAK, bytes((Error.FAIL,)))


def test_a_narrow_link_is_not_filled_beyond_what_it_takes(folder: Path) -> None:
    """57,600 baud: telemetry, a burst and a log at once; commands are answered all the same."""
    a_log(folder, "2026-11-22/10_00_00.mcap", 400_000)
    rate = 5184.0
    world = world_with(folder, rates={0: rate})
    client = world.client()
    ftp = Ftp(client)
    ftp.ask(Op.OPEN_READ, data=b"@MAV_LOG/2026-11-22/10_00_00.mcap")
    ftp.send(Op.BURST, size=239)
    client.send(mav.MAVLink_log_request_data_message(1, 1, 0, 0, 400_000))
    client.send(mav.MAVLink_param_request_list_message(1, 1))
    client.rx.clear()
    sent = 0
    names: dict[str, int] = {}
    for n in range(2000):
        if n % 100 == 50:
            client.send(mav.MAVLink_command_long_message(1, 1, 512, 0, 148, *(0.0,) * 6))
        for frame in world.tick():
            sent += len(frame.data)
    for message in client.rx:
        names[message.get_type()] = names.get(message.get_type(), 0) + 1
    assert sent <= rate * 20.0 * 1.1
    assert names["COMMAND_ACK"] == 20 and names["HEARTBEAT"] >= 19 and names["ATTITUDE"] >= 20, names
    assert names["SYS_STATUS"] >= 10 and names["LOG_DATA"] > 50 and names["FILE_TRANSFER_PROTOCOL"] > 20, names


@pytest.mark.parametrize(("profile", "first"), [("px4", 0), ("generic", 0), ("ardusub", 1)])
@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_logs_arrive_whole_by_log_messages(folder: Path, profile: str, first: int, loss: float) -> None:
    sent = [a_log(folder, f"2026-11-22/10_00_0{n}.mcap", 9000 * n + 90, seed=n) for n in range(3)]
    world = world_with(folder, profile)
    link = LossyLink(LinkConditions(loss=loss, duplicate=loss, reorder=loss, reorder_s=0.01), seed=1)
    client = world.client(from_vehicle=link)
    entries: dict[int, Any] = {}
    while len(entries) < 3:
        for m in client.ask(mav.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF), "LOG_ENTRY", 0.2):
            entries[m.id] = m
    assert sorted(entries) == [first, first + 1, first + 2]
    assert {(m.num_logs, m.last_log_num) for m in entries.values()} == {(3, first + 2)}
    for number, entry in entries.items():
        data, have = bytearray(entry.size), set()
        while len(have) < (entry.size + 89) // 90:
            hole = next(n for n in range(entry.size) if n not in have)
            count = min(entry.size - 90 * hole, 90 * 512)
            asked = mav.MAVLink_log_request_data_message(1, 1, number, 90 * hole, count)
            for m in client.ask(asked, "LOG_DATA", 0.4):
                data[m.ofs : m.ofs + m.count] = bytes(m.data)[: m.count]
                have.add(m.ofs // 90)
        assert bytes(data) == sent[number - first]
    client.send(mav.MAVLink_log_request_end_message(1, 1))


def test_numbers_of_logs_do_not_follow_the_times_of_files(folder: Path) -> None:
    """Copied or touched files changed places, and a client that went on by number got another log."""
    names = ["2026-11-22/10_00_00.mcap", *(f"2026-11-22/10_00_00_{n}.mcap" for n in (2, 9, 10)), "2026-12-01/09.mcap"]
    for size, name in enumerate(names, start=1):
        a_log(folder, name, size)
        os.utime(folder / name, (2_000_000_000 - size, 2_000_000_000 - size))
    client = world_with(folder).client()
    entries = client.ask(mav.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF), "LOG_ENTRY", 0.2)
    assert [(m.id, m.size) for m in entries] == [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5)]


@pytest.mark.parametrize("folder_there", [True, False])
def test_before_the_first_flight_the_list_is_one_entry_of_no_logs(tmp_path: Path, folder_there: bool) -> None:
    world = world_with(tmp_path / "logs") if folder_there else World()
    client = world.client()
    assert not client.ask(mav.MAVLink_log_request_data_message(1, 1, 0, 0, 90), "LOG_DATA", 0.2)
    assert "There is no log 0" in client.texts()
    assert not world.server.busy
    (none,) = client.ask(mav.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF), "LOG_ENTRY", 0.2)
    assert (none.id, none.num_logs, none.size) == (0, 0, 0)


def test_a_log_beyond_the_last_is_refused_once(folder: Path) -> None:
    a_log(folder, "2026-11-22/10_00_00.mcap", 10)
    client = world_with(folder).client()
    assert not client.ask(mav.MAVLink_log_request_list_message(1, 1, 99, 99), "LOG_ENTRY", 2.0)
    client.ask(mav.MAVLink_log_request_data_message(1, 1, 99, 0, 10), "LOG_DATA", 1.0)
    assert client.texts().count("There is no log 99") == 1


def test_logs_are_erased_when_disarmed_only(folder: Path) -> None:
    a_log(folder, "2026-11-22/10_00_00.mcap", 10)
    (folder / "2026-11-22" / "mine.txt").write_text("mine")
    world = world_with(folder)
    client = world.client()
    client.ask(mav.MAVLink_log_erase_message(1, 1), "STATUSTEXT", 0.1)
    assert "disarm first" in client.texts() and (folder / "2026-11-22" / "10_00_00.mcap").exists()
    world.show(armed=False)
    client.ask(mav.MAVLink_log_erase_message(1, 1), "STATUSTEXT", 0.1)
    assert "Logs erased: 1" in client.texts()
    assert [path.name for path in folder.rglob("*") if path.is_file()] == ["mine.txt"]


def test_a_burst_grows_with_what_arrives_and_leaves_the_ticks_of_an_armed_vehicle(folder: Path) -> None:
    sent = a_log(folder, "2026-11-22/10_00_00.mcap", 1_500_000)
    world = world_with(folder)
    world.view = replace(world.view, armed=False, cpu_load=0.3)
    client = world.client()
    path = b"@MAV_LOG/2026-11-22/10_00_00.mcap"

    def read(start: int, ticks: int) -> tuple[int, int, int]:
        """Where the client is after so many ticks, the most packets of one, and bytes that were not the file's."""
        assert Ftp(client).ask(Op.OPEN_READ, data=path)[0] == Op.ACK
        ftp, at, most, wrong = Ftp(client), start, 0, 0
        client.rx.clear()
        ftp.send(Op.BURST, offset=at, size=239)
        for _ in range(ticks):
            world.tick()
            answers = ftp.answers()
            client.rx.clear()
            most = max(most, len(answers))
            for opcode, complete, offset, data in answers:
                assert (opcode, offset) == (Op.ACK, at)
                wrong += data != sent[offset : offset + len(data)]
                at += len(data)
                if complete:
                    ftp.seq += 1000
                    ftp.send(Op.BURST, offset=at, size=239)
        return at, most, wrong

    at, most, wrong = read(0, 60)
    assert (most, wrong) == (112, 0) and at > 700_000, (at, most)
    begun = at
    world.view = replace(world.view, armed=True)
    at, most, wrong = read(begun, 30)
    assert most == 16 and at > begun and wrong == 0
    world.view = replace(world.view, armed=False)
    world.view = replace(world.view, cpu_load=0.9)
    assert read(at, 40)[1] == 16, "the loop is busy"
    world.view = replace(world.view, cpu_load=0.3)
    at, most, wrong = read(0, 10)
    assert most == 16, "from another place: what it has been sent has not all arrived"


def test_log_data_grow_with_what_arrives_and_leave_the_ticks_of_an_armed_vehicle(folder: Path) -> None:
    sent = a_log(folder, "2026-11-22/10_00_00.mcap", 900_000)
    world = world_with(folder)
    world.view = replace(world.view, armed=False, cpu_load=0.3)
    client = world.client()

    def read(start: int, ticks: int, chunk: int) -> tuple[int, int]:
        """Where a client is that asks for the next chunk when it has one, and the most packets of a tick."""
        at, end, most = start, start, 0
        client.rx.clear()
        for _ in range(ticks):
            if at == end:
                end = min(end + chunk, len(sent))
                client.send(mav.MAVLink_log_request_data_message(1, 1, 0, at, end - at))
            world.tick()
            came = client.got("LOG_DATA")
            client.rx.clear()
            most = max(most, len(came))
            for message in came:
                assert message.ofs == at and bytes(message.data)[: message.count] == sent[at : at + message.count]
                at += message.count
        return at, most

    at, most = read(0, 80, 512 * 90)
    assert most == 112 and at > 300_000, (at, most)
    world.view = replace(world.view, armed=True)
    at, most = read(at, 20, len(sent))
    assert most == 16
    world.view = replace(world.view, armed=False)
    at, most = read(at - at % 90, 10, 512 * 90)
    assert most == 16, "asked again: it has not all arrived"
    _, most = read(0, 60, 512 * 90)
    assert most == 112
    world.view = replace(world.view, cpu_load=0.9)
    assert read(0, 100, 512 * 90)[1] == 16, "the loop is busy"


def test_all_parameters_come_in_one_file_where_clients_of_ardupilot_ask_for_it(folder: Path) -> None:
    world = world_with(folder, "ardusub")
    world.params.set("SPD_CRUISE", 0.25)
    ftp = Ftp(world.client())
    for wish, magic in (("", 0x671B), ("?withdefaults=1", 0x671C)):
        data = ftp.get(f"@PARAM/param.pck{wish}")
        found, name = {}, b""
        assert struct.unpack_from("<HHH", data) == (magic, *(len(PARAMETERS) + len(STUBS["ardusub"]),) * 2)
        at = 6
        while at < len(data):
            flags, kind = divmod(data[at], 16)
            rest, common = divmod(data[at + 1], 16)
            name = name[:common] + data[at + 2 : at + 3 + rest]
            at += 3 + rest
            form = "<" + {3: "i", 4: "f"}[kind] * (1 + flags)
            found[name.decode()] = struct.unpack_from(form, data, at)
            at += struct.calcsize(form)
        assert list(found) == sorted({*(spec.name for spec in PARAMETERS), *STUBS["ardusub"]})
        assert found["SPD_CRUISE"] == pytest.approx((0.25, 0.35) if wish else (0.25,))
        assert found["FS_SOLVER_N"] == (40,)
    other = World("px4").client()
    assert Ftp(other).ask(Op.OPEN_READ, data=b"@PARAM/param.pck") == (Op.NAK, bytes((Error.NOT_FOUND,)))
    assert "only under profile ardusub" in other.texts()
    assert ftp.ask(Op.OPEN_READ, data=b"@PARAM/../param.pck") == (Op.NAK, bytes((Error.NOT_FOUND,)))
