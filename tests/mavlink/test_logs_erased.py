"""Log download while logs are written, erased and come: what a client gets under a number is always the same log."""

import random
from contextlib import ExitStack
from pathlib import Path

import pytest
from mavlink_harness import Client, World, mav

from autopilot.core.background import BackgroundWorker
from autopilot.log.directory_reader import LogDirectoryReader
from autopilot.log.lock import lock_exclusive


class Reader:
    """A client that remembers which log each number was when it asked for the list."""

    def __init__(self, client: Client) -> None:
        self.client = client
        self.logs: dict[int, tuple[Path, bytes]] = {}

    def list(self, written: dict[Path, bytes]) -> None:
        entries = self.client.ask(mav.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF), "LOG_ENTRY", 0.1)
        by_size = {len(data): (path, data) for path, data in written.items()}
        self.logs = {entry.id: by_size[entry.size] for entry in entries if entry.num_logs}

    def read(self, rng: random.Random) -> None:
        number, offset = rng.randrange(6), rng.choice((0, 90, 180, rng.randrange(3000), 2**32 - 1))
        count = rng.choice((0, 1, 90, 500, 2**32 - 1))
        request = mav.MAVLink_log_request_data_message(1, 1, number, offset, count)
        wait_s = rng.choice((0.01, 0.1))
        got = self.client.ask(request, "LOG_DATA", wait_s)
        for data in got:
            _, log = self.logs[data.id]
            assert bytes(data.data)[: data.count] == log[data.ofs : data.ofs + data.count], "another log"
        path, log = self.logs.get(number, (None, b""))
        if path is not None and path.exists() and wait_s > 0.05:
            mine = [data for data in got if data.id == number]
            assert mine and any(
                data.ofs == offset and data.count == min(count, 90, max(len(log) - offset, 0)) for data in mine
            )


@pytest.mark.parametrize("seed", range(25))
def test_what_comes_under_a_number_is_the_log_of_the_list(tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    world = World(log_directory=LogDirectoryReader(tmp_path, BackgroundWorker()))
    world.show(armed=False)
    written: dict[Path, bytes] = {}
    readers = [Reader(world.client(sysid=250 + n, number=1 + n)) for n in range(2)]
    with ExitStack() as being_written:
        for step in range(40):
            reader, act = rng.choice(readers), rng.random()
            if step < 3 or (act < 0.1 and step > 4):
                path = tmp_path / "2026-11-22" / f"10_{step:02d}_00.mcap"
                path.parent.mkdir(exist_ok=True)
                written[path] = rng.randbytes(1000 + 137 * step)
                path.write_bytes(written[path])
                if rng.random() < 0.4:  # it goes on, and is not erased
                    assert lock_exclusive(being_written.enter_context(path.open("r+b")))
            elif act < 0.2 or step < 5:
                readers[step % 2 if step < 5 else rng.randrange(2)].list(written)
            elif act < 0.27:
                reader.client.send(mav.MAVLink_log_erase_message(1, 1))
                world.run(rng.choice((0.01, 0.1)))
            elif act < 0.32:
                reader.client.send(mav.MAVLink_log_request_end_message(1, 1))
            else:
                reader.read(rng)
