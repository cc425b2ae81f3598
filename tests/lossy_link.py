"""A link as it is: latency, jitter, loss (single or in bursts), reordering, duplicates, a rate, stalls; seeded.

:class:`LossyLink` is one direction and has no clock: tests that step the code put datagrams in and take them out.
``python tests/lossy_link.py --help`` is a proxy on sockets, UDP or TCP, with one link per direction.
"""

from __future__ import annotations

import argparse
import functools
import heapq
import json
import random
import select
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields

RESENT_US = 200_000
"""Linux's least retransmission timeout (TCP_RTO_MIN): a stream waits so long for a segment that was lost."""
MAX_DATAGRAM = 65_536
LOCAL, PATIENCE_S = "127.0.0.1", 0.005


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkConditions:
    """Of one direction. The defaults are those of a perfect link."""

    latency_s: float = 0.0
    jitter_s: float = 0.0
    """Mean of an exponentially distributed latency on top."""
    loss: float = 0.0
    """Fraction of datagrams."""
    burst: float = 1.0
    """Losses in a row are so many times as many as independent ones would be (Gilbert 1960)."""
    duplicate: float = 0.0
    """Fraction that comes twice."""
    reorder: float = 0.0
    """Fraction that others may overtake."""
    reorder_s: float = 0.03
    """So much later they come."""
    rate_bytes_s: float = 0.0
    """0 = unlimited."""
    stream: bool = False
    """As TCP: nothing is lost, duplicated or overtaken; all wait for what is sent again."""
    ordered: bool = True
    """Whether what is sent keeps its order when the latency falls."""


class LossyLink:
    def __init__(self, conditions: LinkConditions, seed: int) -> None:
        self.conditions = conditions
        """May be replaced at any time, for what is sent from then on."""
        self._rng = random.Random(seed)
        self._waiting: list[tuple[int, int, bytes]] = []
        self._order = 0
        self._last_us = self._free_us = 0
        self._lossy = False
        self._held_until_us = 0
        self.sent = self.lost = self.duplicated = self.overtaken = 0

    def stall(self, until_us: int) -> None:
        """Deliver nothing until then (the receiver's processor is busy, or the line stands)."""
        self._held_until_us = max(self._held_until_us, until_us)

    def put(self, t_us: int, data: bytes) -> None:
        """A datagram is sent."""
        now, rng = self.conditions, self._rng
        self.sent += 1
        lost = self._is_lost()
        if lost and not now.stream:
            self.lost += 1
            return
        begin_us = max(t_us, self._free_us)
        if now.rate_bytes_s:
            begin_us += round(1e6 * len(data) / now.rate_bytes_s)
            self._free_us = begin_us
        extra_s = rng.expovariate(1.0 / now.jitter_s) if now.jitter_s else 0.0
        at_us = begin_us + round(1e6 * (now.latency_s + extra_s))
        if lost:
            self.lost += 1
            at_us += RESENT_US
        if now.reorder and not now.stream and rng.random() < now.reorder:
            self.overtaken += 1
            at_us += round(1e6 * now.reorder_s)
        elif now.stream or now.ordered:
            at_us = self._last_us = max(at_us, self._last_us)
        self._queue(at_us, data)
        if now.duplicate and not now.stream and rng.random() < now.duplicate:
            self.duplicated += 1
            self._queue(at_us + round(1e6 * rng.uniform(0.0, now.reorder_s)), data)

    def _is_lost(self) -> bool:
        now = self.conditions
        to_good, to_bad = (1.0 - now.loss) / now.burst, now.loss / now.burst
        self._lossy = self._rng.random() >= to_good if self._lossy else self._rng.random() < to_bad
        return self._lossy

    def _queue(self, at_us: int, data: bytes) -> None:
        self._order += 1
        heapq.heappush(self._waiting, (at_us, self._order, data))

    def take(self, t_us: int) -> list[bytes]:
        """What has arrived by now, in the order of arrival."""
        if t_us < self._held_until_us:
            return []
        arrived = []
        while self._waiting and self._waiting[0][0] <= t_us:
            arrived.append(heapq.heappop(self._waiting)[2])
        return arrived

    @property
    def next_us(self) -> int | None:
        """When the next one arrives."""
        return max(self._waiting[0][0], self._held_until_us) if self._waiting else None


class _Path:
    """Both directions between a client and the target, with their sockets."""

    def __init__(self, client: Callable[[bytes], object], target: socket.socket, links: tuple[LossyLink, LossyLink]):
        self.to_client, self.target = client, target
        self.up, self.down = links
        """Towards the target, and back."""

    def deliver(self, t_us: int) -> None:
        try:
            for data in self.up.take(t_us):
                self.target.sendall(data)
            for data in self.down.take(t_us):
                self.to_client(data)
        except OSError:  # nobody listens there (any more): lost
            return


class Proxy:
    """Accepts clients at one address and connects each to another, over two links of its own."""

    def __init__(self, listen: tuple[str, int], to: tuple[str, int], conditions: LinkConditions, seed: int) -> None:
        self._conditions, self._to, self._seed = conditions, to, seed
        kind = socket.SOCK_STREAM if conditions.stream else socket.SOCK_DGRAM
        self._server = socket.socket(socket.AF_INET, kind)
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._server.bind(listen)
        if conditions.stream:
            self._server.listen()
        self.paths: dict[object, _Path] = {}
        self._reads: dict[socket.socket, tuple[_Path, LossyLink]] = {}

    def _path(self, key: object, client: Callable[[bytes], object]) -> _Path:
        path = self.paths.get(key)
        if path is None:
            kind = socket.SOCK_STREAM if self._conditions.stream else socket.SOCK_DGRAM
            target = socket.socket(socket.AF_INET, kind)
            target.connect(self._to)
            seed = self._seed + 2 * len(self.paths)
            links = (LossyLink(self._conditions, seed), LossyLink(self._conditions, seed + 1))
            path = self.paths[key] = _Path(client, target, links)
            self._reads[target] = (path, path.down)
        return path

    def step(self, t_us: int, patience_s: float) -> None:
        """Take what has come, at most so late, and deliver what is due."""
        for ready in select.select([self._server, *self._reads], [], [], patience_s)[0]:
            if ready is not self._server:
                self._take(t_us, ready)
            elif self._conditions.stream:
                client, _ = self._server.accept()
                path = self._path(client, client.sendall)
                self._reads[client] = (path, path.up)
            else:
                data, address = self._server.recvfrom(MAX_DATAGRAM)
                self._path(address, functools.partial(self._answer, address)).up.put(t_us, data)
        for path in self.paths.values():
            path.deliver(t_us)

    def _answer(self, address: tuple[str, int], data: bytes) -> None:
        self._server.sendto(data, address)

    def _take(self, t_us: int, ready: socket.socket) -> None:
        path, link = self._reads[ready]
        try:
            data = ready.recv(MAX_DATAGRAM)
        except ConnectionError:  # an earlier datagram found nobody
            return
        if data or not self._conditions.stream:
            link.put(t_us, data)
            return
        for ended in [other for other, (owner, _) in self._reads.items() if owner is path]:
            del self._reads[ended]
            ended.close()

    def close(self) -> None:
        for end in (self._server, *self._reads):
            end.close()

    def report(self) -> dict[str, int]:
        links = [link for path in self.paths.values() for link in (path.up, path.down)]
        names = ("sent", "lost", "duplicated", "overtaken")
        return {name: sum(getattr(link, name) for link in links) for name in names}


@contextmanager
def proxied(listen: int, to: int, conditions: LinkConditions) -> Iterator[Proxy]:
    """A bad link between two ports of this machine, served by a thread."""
    proxy, ended = Proxy((LOCAL, listen), (LOCAL, to), conditions, seed=listen), threading.Event()

    def serve() -> None:
        while not ended.is_set():
            proxy.step(time.monotonic_ns() // 1000, PATIENCE_S)

    server = threading.Thread(target=serve)
    server.start()
    try:
        yield proxy
    finally:
        ended.set()
        server.join()
        proxy.close()


def main() -> None:
    parser = argparse.ArgumentParser(description="A bad link between LISTEN and TO, both ways, until SIGTERM.")
    parser.add_argument("listen")
    parser.add_argument("to")
    parser.add_argument("--seed", type=int, default=0)
    for each in fields(LinkConditions):
        name = "--" + each.name.replace("_", "-")
        if isinstance(each.default, bool):
            parser.add_argument(name, action=argparse.BooleanOptionalAction, default=each.default)
        else:
            parser.add_argument(name, type=float, default=each.default)
    given = vars(parser.parse_args())
    listen, to, seed = given.pop("listen"), given.pop("to"), given.pop("seed")
    host, _, port = listen.rpartition(":")
    far, _, far_port = to.rpartition(":")
    proxy = Proxy((host, int(port)), (far, int(far_port)), LinkConditions(**given), seed)
    going = [True]
    signal.signal(signal.SIGTERM, lambda *_: going.clear())
    print("ready", flush=True)
    while going:
        proxy.step(time.monotonic_ns() // 1000, 0.002)
    print(json.dumps(proxy.report()), flush=True)


if __name__ == "__main__":
    main()
