"""A service of this process between a socket and MAVSDK, in real time."""

import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import mavsdk

Step = Callable[[Sequence[bytes]], Iterable[bytes]]
"""The datagrams of MAVSDK since the last step -> those for it."""


class Loop(threading.Thread):
    """Steps a service at 100 Hz, never quicker than the clock."""

    def __init__(self, step: Step, port: int) -> None:
        super().__init__(daemon=True)
        self._step, self._address, self._ending = step, ("127.0.0.1", port), threading.Event()

    def run(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.setblocking(False)
            due = time.monotonic()
            while not self._ending.is_set():
                due = max(due + 0.01, time.monotonic())
                time.sleep(max(0.0, due - time.monotonic()))
                received = []
                while True:
                    try:
                        received.append(sock.recv(4096))
                    except (BlockingIOError, ConnectionRefusedError):
                        break
                for data in self._step(received):
                    sock.sendto(data, self._address)

    def end(self) -> None:
        self._ending.set()
        self.join()


@contextmanager
def found(step: Step) -> Iterator[tuple[Any, Loop]]:
    """The vehicle as MAVSDK finds it, and the loop that steps it meanwhile."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    loop = Loop(step, port)
    mavsdk.log_subscribe(lambda *args: True)
    configuration = mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION)
    with mavsdk.Mavsdk(configuration) as sdk:
        sdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        loop.start()
        try:
            system = sdk.first_autopilot(600.0)
            assert system is not None, "MAVSDK did not find the vehicle"
            yield system, loop
        finally:
            loop.end()
