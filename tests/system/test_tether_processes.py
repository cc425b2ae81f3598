"""`autopilot run` on `autopilot emulate` as processes, with a tether of 100 ms and 5 % loss between them."""

import signal
import subprocess
from pathlib import Path

from autopilot.mission.plan_files import write_plan
from autopilot.run.children import autopilot_command, free_port
from autopilot.run.demo import paper_plan
from autopilot.sitl.scenario import load_scenario
from tests.lossy_link import LinkConditions, proxied

TETHER = LinkConditions(latency_s=0.1, loss=0.05)
TRIES = 300
"""Until the service has read the flight controller's parameters and found its position: seconds on an idle machine."""
WRONG = ("Position reset", "another sender", "not confirmed")
"""What a link does, and a busy machine does not."""


def test_a_mission_begins_and_ends_in_order_by_a_tether(tmp_path: Path) -> None:
    below, tether, poses, ours = (free_port() for _ in range(4))
    origin, config, plan = load_scenario("paper-tank").origin, tmp_path / "rov.toml", tmp_path / "paper.plan"
    write_plan(plan, paper_plan(1))
    config.write_text(
        f'vehicle = "bluerov2"\n[service]\nstate_dir = "state"\nconnect = ["udpin:127.0.0.1:{ours}"]\n'
        f"[place]\norigin_lat_deg = {origin.lat_deg}\norigin_lon_deg = {origin.lon_deg}\n"
        f'[parameters]\nEST_EXT_DELAY = 0.1\n[devices.flight_controller]\ndriver = "ardusub"\nframe = "vectored"\n'
        f'connect = "udpin:127.0.0.1:{below}"\n'
    )
    emulated = autopilot_command(
        "emulate", "--link", f"udpout:127.0.0.1:{tether}", "--pose", f"udpout:127.0.0.1:{poses}"
    )
    service = autopilot_command("run", "--config", str(config), "--log", str(tmp_path / "run.mcap"))
    start = autopilot_command(
        "mission", "start", str(plan), "--connect", f"udpout:127.0.0.1:{ours}", "--patience", "60"
    )
    lines: list[str] = []
    with (
        proxied(tether, below, TETHER) as link,
        proxied(poses, ours, TETHER),
        subprocess.Popen(emulated, stdout=subprocess.DEVNULL) as vehicle,
        subprocess.Popen(service, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process,
    ):
        try:
            assert process.stdout is not None
            for _ in range(TRIES):
                done = subprocess.run(start, capture_output=True, text=True, check=False)
                if done.returncode == 0:
                    break
            assert done.returncode == 0, done.stderr
            for line in process.stdout:
                lines.append(line)
                if "Reached item 0" in line:
                    break
        finally:
            process.send_signal(signal.SIGTERM)
            lines += process.stdout or ()
            vehicle.send_signal(signal.SIGTERM)
    assert process.returncode == 0, lines
    assert any("Reached item 0" in line for line in lines), lines
    assert not [line for line in lines if any(word in line for word in WRONG)], lines
    assert link.report()["lost"] > 20
