"""Links: floods, transfers, two clients with the same ids, strangers, devices that go."""

import os
import pty
import random
import socket
import sys
import time
import tty
from collections.abc import Callable

from pymavlink.dialects.v20 import development as mav

from autopilot.bench.live_service import LiveService, Station, download, live_service, upload
from autopilot.mavlink.vehicle_commands import FORCE_DISARM
from autopilot.run.children import LOCAL
from tests.bench.faults.finding import Finding, Measured

GAP_S = 1.2
"""Longest silence of HEARTBEAT that is promised."""
FLOOD_S = 5.0
ITEMS = 500


def _flood(send: Callable[[bytes], object], make: Callable[[], bytes], rate_hz: float) -> Callable[[float], None]:
    """Sends at a rate; what does not fit is lost."""
    sent = 0

    def meanwhile(passed_s: float) -> None:
        nonlocal sent
        while sent < passed_s * rate_hz:
            sent += 1
            try:
                send(make())
            except BlockingIOError:
                continue

    return meanwhile


def _small_frames() -> bytes:
    """Valid messages that have to be answered."""
    codec = mav.MAVLink(None, srcSystem=99, srcComponent=99)
    return b"".join(bytes(mav.MAVLink_ping_message(n, n, 0, 0).pack(codec)) for n in range(4))


def _floods() -> dict[str, tuple[Callable[[], bytes], float]]:
    """Name -> what is sent, datagrams per second."""
    rng, small = random.Random(1), _small_frames()
    return {
        "0xFE": (lambda: b"\xfe" * 2048, 60.0),
        "0xFD": (lambda: b"\xfd" * 2048, 60.0),
        "random bytes": (lambda: rng.randbytes(2048), 60.0),
        "valid messages": (lambda: small, 1500.0),
    }


def _flooded(names: tuple[str, ...], *, tcp: bool = False) -> Measured:
    """Flood from one socket, listen and upload on another one of the same port."""
    gap_s, unnamed, refused = 0.0, [], 0
    with live_service() as service:
        station = Station.udp(service.udp)
        station.meet(service)
        for name in names:
            make, rate_hz = _floods()[name]
            flooder = Station.tcp(service.tcp).socket if tcp else Station.udp(service.udp).socket
            flooder.setblocking(False)
            station.texts.clear()
            gap_s = max(gap_s, station.watch(FLOOD_S, _flood(flooder.send, make, rate_hz)))
            address = "{}:{}".format(*flooder.getsockname())
            if not any(text.startswith(address) for text in station.texts):
                unnamed.append(name)
            flooder.close()
            refused += upload(station, service, 20)[0] != 0
        station.close()
    named = f"not named: {', '.join(unnamed)}" if unnamed else "named"
    uploads = "uploads taken" if not refused else f"{refused} uploads refused"
    return Measured(
        text=f"longest gap between heartbeats {gap_s:.2f} s; flooder {named}; {uploads}",
        kept=gap_s <= GAP_S and not unnamed and not refused,
    )


def _transfer() -> Measured:
    with live_service() as service:
        station = Station.udp(service.udp)
        station.meet(service)
        ups, downs = [], []
        for _ in range(3):
            result, seconds = upload(station, service, ITEMS)
            ups.append(seconds if result == 0 else float("inf"))
            count, seconds = download(station, service)
            downs.append(seconds if count == ITEMS else float("inf"))
        station.close()
    best = max(min(ups), min(downs))
    return Measured(
        text=f"up {', '.join(f'{s:.2f}' for s in ups)} s, down {', '.join(f'{s:.2f}' for s in downs)} s",
        kept=best <= 1.0,
    )


def _mavsdk_transfer() -> Measured:
    import asyncio

    from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
    from mavsdk.asyncio.plugins.mission_raw import MissionItem, MissionRawAsync

    items = [
        MissionItem(n, 1, 16, int(n == 0), 1, 0.0, 0.3, 0.0, float("nan"), 2000 * (n % 7), 2000 * (n % 5), 0.5, 0)
        for n in range(ITEMS)
    ]

    async def transfer(port: int) -> tuple[list[float], list[float]]:
        ups, downs = [], []
        async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as sdk:
            await sdk.add_any_connection(f"udpout://{LOCAL}:{port}")
            vehicle = await sdk.first_autopilot(timeout_s=30.0)
            raw = MissionRawAsync(vehicle)
            for _ in range(3):
                begin_s = time.perf_counter()
                await raw.upload_mission(items)
                ups.append(time.perf_counter() - begin_s)
                begin_s = time.perf_counter()
                assert len(await raw.download_mission()) == ITEMS
                downs.append(time.perf_counter() - begin_s)
        return ups, downs

    with live_service() as service:
        station = Station.udp(service.udp)
        station.meet(service)  # MAVSDK gives an upload up after two seconds, and a service takes that long to load
        station.close()
        ups, downs = asyncio.run(transfer(service.udp))
    return Measured(
        text=f"up {', '.join(f'{s:.2f}' for s in ups)} s, down {', '.join(f'{s:.2f}' for s in downs)} s",
        kept=max(min(ups), min(downs)) <= 0.9,
    )


def _two_clients() -> Measured:
    """Two scripts with the same ids begin an upload each; their items come in turns."""
    from autopilot.bench.live_service import waypoint

    with live_service() as service:
        stations = [Station.udp(service.udp, 245), Station.udp(service.udp, 245)]
        for station in stations:
            station.meet(service)
        counts = (40, 41)
        answers: list[int | None] = [None, None]
        for station, count in zip(stations, counts, strict=True):
            station.send(mav.MAVLink_mission_count_message(1, 1, count, 0))
        while None in answers and service.child.at_work():
            for n, station in enumerate(stations):
                for message in station.receive(0.02):
                    if message.get_type() == "MISSION_REQUEST_INT":
                        station.send(waypoint(message.seq, counts[n]))
                    elif message.get_type() == "MISSION_ACK":
                        answers[n] = int(message.type)
        winner = 0 if answers[0] == 0 else 1
        in_force = download(stations[winner], service)[0]
        for station in stations:
            station.close()
    names = {0: "ACCEPTED", 14: "DENIED"}
    said = " and ".join(names.get(answer, str(answer)) if answer is not None else "nothing" for answer in answers)
    return Measured(
        text=f"answered {said}; {in_force} items in force of the {counts[winner]} accepted",
        kept=sorted(answer or 0 for answer in answers) == [0, 14] and in_force == counts[winner],
    )


def _stranger() -> Measured:
    """A force disarm from another address to the socket of a udpout link."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as target:
        target.bind((LOCAL, 0))
        target.settimeout(60.0)
        with live_service(f"udpout:{LOCAL}:{target.getsockname()[1]}") as service:
            _, vehicle = target.recvfrom(4096)
            answered = _asks(service, vehicle, "127.0.0.9")
            own = _asks(service, vehicle, LOCAL)
            listening = _open_to_all(service)
    reach = "listens beyond the loopback" if listening else "bound to the loopback"
    heard = "answered" if answered else "not heard"
    return Measured(text=f"stranger {heard}, {reach}", kept=not answered and own and not listening)


def _asks(service: LiveService, vehicle: tuple[str, int], host: str) -> bool:
    """Whether a forced disarm from ``host`` is answered."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind((host, 0))
        end.connect(vehicle)
        station = Station(end)
        names = set()
        for _ in range(20):
            station.send(mav.MAVLink_command_long_message(1, 1, 400, 0, 0.0, FORCE_DISARM, 0, 0, 0, 0, 0))
            names |= {message.get_type() for message in station.receive(0.05)}
        return "COMMAND_ACK" in names


def _open_to_all(service: LiveService) -> bool:
    """Whether a socket of the service is bound to all addresses."""
    import psutil

    found = psutil.Process(service.child.process.pid).net_connections("inet")
    return any(entry.laddr and entry.laddr.ip not in (LOCAL,) for entry in found)


def _unplugged() -> Measured:
    """A serial link whose device goes and comes back under its name."""
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory(prefix="autopilot-") as folder:
        name = Path(folder) / "ttyROV"

        def plug() -> tuple[int, int]:
            device, line = pty.openpty()
            tty.setraw(device)
            name.unlink(missing_ok=True)
            name.symlink_to(os.ttyname(line))
            return device, line

        device, line = plug()
        with live_service(f"{name}:115200") as service:
            station = Station.udp(service.udp)
            station.meet(service)
            os.close(line)
            os.close(device)
            name.unlink()
            gap_s = station.watch(3.0)
            told = [text for text in station.texts if text.startswith(str(name)[:20])]
            device, line = plug()
            os.set_blocking(device, False)
            station.watch(3.0)
            try:
                back = len(os.read(device, 4096)) > 0
            except BlockingIOError:
                back = False
            alive = service.child.process.poll() is None
            station.close()
        os.close(line)
        os.close(device)
    return Measured(
        text=f"service {'goes on' if alive else 'ended'}, told {len(told)} times, device "
        f"{'used again' if back else 'not used again'}, longest gap between heartbeats {gap_s:.2f} s",
        kept=alive and back and len(told) == 1 and gap_s <= GAP_S,
    )


FINDINGS: tuple[Finding, ...] = (
    Finding(
        part="link",
        name="datagrams of 2,048 bytes 0xFE, 60 per second, from another address of the same port",
        before="one heartbeat in 8 s",
        promise="gap <= 1.2 s, flooder named, others served",
        measure=lambda: _flooded(("0xFE",)),
    ),
    Finding(
        part="link",
        name="floods of 0xFD, random bytes and valid messages on UDP",
        before="not measured",
        promise="gap <= 1.2 s, flooder named, others served",
        measure=lambda: _flooded(("0xFD", "random bytes", "valid messages")),
    ),
    Finding(
        part="link",
        name="floods of 0xFE and valid messages on TCP",
        before="not measured",
        promise="gap <= 1.2 s, flooder named, others served",
        measure=lambda: _flooded(("0xFE", "valid messages"), tcp=True),
    ),
    Finding(
        part="link",
        name=f"{ITEMS} items up and down, a client that answers at once, real time",
        before="5.3 to 5.8 s each way",
        promise="<= 1.0 s",
        measure=_transfer,
    ),
    Finding(
        part="link",
        name=f"{ITEMS} items up and down, MAVSDK, real time",
        before="5.3 to 5.8 s each way",
        promise="<= 0.9 s",
        measure=_mavsdk_transfer,
    ),
    Finding(
        part="link",
        name="two clients with the same ids upload 40 and 41 items on one port at once",
        before="both ACCEPTED, 17 + 23 items mixed",
        promise="one ACCEPTED, one DENIED, the accepted plan in force",
        measure=_two_clients,
    ),
    Finding(
        part="link",
        name="another address sends a forced disarm to the socket of udpout",
        before="disarmed a flying vehicle",
        promise="not heard; nothing open beyond the loopback",
        measure=_stranger,
    ),
    *(
        ()
        if sys.platform == "win32"
        else (
            Finding(
                part="link",
                name="the device of a serial link goes and comes back",
                before="link silent for good",
                promise="told once, used again, gap <= 1.2 s",
                measure=_unplugged,
            ),
        )
    ),
)
