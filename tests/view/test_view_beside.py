"""The view changes nothing: the same log in lockstep, and a loop that leaves next to nothing while nobody looks."""

from pathlib import Path

from viewers import Stream, run

from autopilot.log.compare import compare_logs
from autopilot.log.reader import open_log


def test_a_run_that_is_looked_at_is_the_same_run(tmp_path: Path) -> None:
    given = ("paper-tank", "--speed", "0", "--duration", "6", "--start", "--sensors", "pose")
    logs = []
    for name in ("alone", "watched"):
        folder = tmp_path / name
        folder.mkdir()
        logs.append(folder / "run.mcap")
        with run(folder, *given, "--log", str(logs[-1])) as made:
            viewer = Stream(made.port) if name == "watched" else None
            if viewer is not None:
                seen = [data for kind, data in viewer.events() if kind == "frame"]
                assert seen and seen[-1]["t_s"] <= 6.0
            made.process.wait(300)
    assert compare_logs(*map(open_log, logs)) == []
