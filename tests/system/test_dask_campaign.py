"""A campaign on a real Dask cluster: scheduler and workers as processes of their own, on loopback TCP."""

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from autopilot.campaign.run_store import read_results
from autopilot.run.children import ROOT, autopilot_command, free_port
from tests.short_campaign import lines, scenario_in

pytest.importorskip("distributed")

RUNS = 8
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}


class Cluster:
    def __init__(self, folder: Path) -> None:
        port = free_port()
        self.address = f"tcp://127.0.0.1:{port}"
        self._folder = folder
        self.processes: list[subprocess.Popen[bytes]] = []
        self.scheduler = self._start("dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")

    def worker(self) -> subprocess.Popen[bytes]:
        return self._start(
            *("dask_worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard"),
            *("--local-directory", str(self._folder)),
        )

    def _start(self, program: str, *arguments: str) -> subprocess.Popen[bytes]:
        with (self._folder / f"{program}-{len(self.processes)}.txt").open("wb") as said:
            process = subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.{program}", *arguments],
                stdout=said,
                stderr=said,
                env=ENVIRONMENT,
                cwd=self._folder,
            )
        self.processes.append(process)
        return process

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    folder = tmp_path / "cluster"
    folder.mkdir()
    made = Cluster(folder)
    yield made
    made.close()


def begin(folder: Path, out: Path, engine: str, runs: int = RUNS) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [
            *autopilot_command("campaign", scenario_in(folder, seconds=1.5), "--runs", str(runs), "--out", str(out)),
            *("--engine", engine, "--no-figures", "--logs", "0"),
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT,
    )


def test_every_run_once_though_a_worker_is_killed(cluster: Cluster, tmp_path: Path) -> None:
    """Two workers, one killed in the middle of its runs: the results are those of this machine alone."""
    doomed, other = cluster.worker(), cluster.worker()
    out, alone = tmp_path / "out", tmp_path / "alone"
    with begin(tmp_path, out, f"dask+{cluster.address}") as flying:
        assert flying.stderr is not None
        said = [flying.stderr.readline() for _ in range(2)]
        doomed.send_signal(signal.SIGKILL)
        said += flying.stderr.readlines()
        code = flying.wait()
    assert code == 1, "nobody finishes laps in that time"
    assert doomed.wait() == -signal.SIGKILL and other.poll() is None
    told = Counter(line.split("run ")[1].split(",")[0] for line in said if ": run " in line)
    assert told == Counter({str(run): 1 for run in range(RUNS)}), "".join(said)
    raw = (out / "runs.jsonl").read_bytes()
    assert raw.count(b"\n") == RUNS
    found = lines(out)
    assert [each["run"] for each in found] == list(range(RUNS))
    assert all(each["error"] is None for each in found)
    with begin(tmp_path, alone, "local", runs=2) as here:
        here.communicate()
    assert lines(alone) == found[:2], "a run is the same wherever it is flown"


def test_a_scheduler_that_goes_ends_it_in_words_and_the_rest_is_flown_later(cluster: Cluster, tmp_path: Path) -> None:
    cluster.worker()
    out = tmp_path / "out"
    with begin(tmp_path, out, f"dask+{cluster.address}", runs=40) as flying:
        assert flying.stderr is not None
        flying.stderr.readline()
        for process in cluster.processes:
            process.kill()
        error = flying.stderr.readlines()
        assert flying.wait(timeout=120) == 1
    assert "does not answer any more; finished runs are kept" in error[-1]
    assert "Traceback" not in "".join(error)
    kept = read_results(out)
    assert 1 <= len(kept) < 40
    with begin(tmp_path, out, "local", runs=len(kept) + 1) as going_on:
        going_on.communicate()
    assert len(read_results(out)) == len(kept) + 1


def test_nobody_there_is_named(tmp_path: Path) -> None:
    begun_s = time.monotonic()
    with begin(tmp_path, tmp_path / "out", f"dask+tcp://127.0.0.1:{free_port()}") as flying:
        _, error = flying.communicate()
    assert flying.returncode == 1
    assert "no scheduler answers" in error and "check the address" in error
    assert error.count("\n") == 1, error
    assert time.monotonic() > begun_s


def test_a_cluster_of_its_own(tmp_path: Path) -> None:
    with begin(tmp_path, tmp_path / "out", "dask", runs=2) as flying:
        _, error = flying.communicate()
    assert len(read_results(tmp_path / "out")) == 2, error
    assert "Traceback" not in error
