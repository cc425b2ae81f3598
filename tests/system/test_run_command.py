"""`autopilot run` and `autopilot doctor` as processes, and what is wrong with a vehicle's configuration."""

import json
import re
import signal
import socket
import subprocess
from pathlib import Path

import pytest

from autopilot.core.errors import ConfigError
from autopilot.log.reader import open_log
from autopilot.mission.plan_files import write_plan
from autopilot.run.children import autopilot_command, free_port
from autopilot.run.demo import paper_plan
from autopilot.run.vehicle_config import load_config
from autopilot.sitl.scenario import load_scenario

ARDUSUB = '[devices.flight_controller]\ndriver = "ardusub"\nframe = "vectored"\nconnect = "udpin:127.0.0.1:{port}"\n'


def _file(folder: Path, text: str) -> Path:
    path = folder / "rov.toml"
    path.write_text(text)
    return path


def _rov(folder: Path) -> Path:
    text = 'vehicle = "bluerov2"\n[service]\nstate_dir = "state"\nlog_dir = "logs"\n'
    return _file(folder, text + f'connect = ["udpin:127.0.0.1:{free_port()}"]\n' + ARDUSUB.format(port=free_port()))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_run_with_a_whole_log(tmp_path: Path, number: int) -> None:
    log = tmp_path / "run.mcap"
    command = autopilot_command("run", "--config", str(_rov(tmp_path)), "--log", str(log))
    ours = signal.signal(number, signal.SIG_DFL)  # ignored, it would be in the child, too: these tests may run by nohup
    try:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    finally:
        signal.signal(number, ours)
    with process:
        assert process.stdout is not None
        for line in process.stdout:
            if "MAVLink on" in line:
                break
        process.send_signal(number)
        rest = process.stdout.read()
    assert process.returncode == 0, rest
    assert "overruns" in rest
    assert open_log(log).topics  # closed, not recovered


def test_a_state_folder_is_one_services_even_after_it_was_killed(tmp_path: Path) -> None:
    command = autopilot_command("run", "--config", str(_rov(tmp_path)))
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if "MAVLink on" in line:
                break
        again = subprocess.run(command, capture_output=True, text=True, check=False)
        assert again.returncode == 1 and again.stderr.count("\n") == 1
        assert f"{tmp_path / 'state' / 'bluerov2-0'}: another service" in again.stderr
        assert "another --instance or state_dir" in again.stderr
        process.kill()
    done = subprocess.run((*command, "--duration", "0.2"), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.long
def test_the_doctor_says_what_is_not_there_and_what_to_do(tmp_path: Path) -> None:
    command = autopilot_command("doctor", "--config", str(_rov(tmp_path)), "--seconds", "1", "--json")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    findings = json.loads(done.stdout)
    failed = {line["what"]: line for line in findings if line["verdict"] == "fail"}
    assert failed["attitude"]["found"].startswith("0.0 Hz")
    assert any("cable and link" in line["remedy"] for line in failed.values())
    assert all(line["remedy"] for line in failed.values())


TRIES = 5
"""On a machine that has other work an emulated sensor may be too slow for a moment."""


@pytest.mark.long
def test_the_doctor_on_an_emulated_vehicle_says_that_it_would_arm(tmp_path: Path) -> None:
    """Both as processes, in real time; then the service has the ports, and the doctor says so."""
    config, plan = _rov(tmp_path), tmp_path / "paper.plan"
    write_plan(plan, paper_plan(1))
    origin = load_scenario("paper-tank").origin
    text = config.read_text().replace("[service]", f"[place]\norigin_lat_deg = {origin.lat_deg}\n[service]")
    config.write_text(text.replace("[service]", f"origin_lon_deg = {origin.lon_deg}\n[service]"))
    ours, below = re.findall(r"udpin:([\d.:]+)", config.read_text())
    emulated = autopilot_command("emulate", "--link", f"udpout:{below}", "--pose", f"udpout:{ours}")
    doctor = autopilot_command("doctor", "--config", str(config), "--plan", str(plan), "--json")
    with subprocess.Popen(emulated, stdout=subprocess.DEVNULL) as process:
        try:
            for _ in range(TRIES):
                done = subprocess.run(doctor, capture_output=True, text=True, check=False)
                verdicts = {line["verdict"] for line in json.loads(done.stdout)}
                assert done.returncode == (1 if "fail" in verdicts else 3 if "warn" in verdicts else 0)
                if done.returncode == 0:
                    break
            assert done.returncode == 0, done.stdout
            host, _, port = ours.rpartition(":")
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
                taken.bind((host, int(port)))
                done = subprocess.run(doctor, capture_output=True, text=True, check=False)
            failed = {line["what"]: line for line in json.loads(done.stdout) if line["verdict"] == "fail"}
            assert done.returncode == 1 and "already in use" in failed["link"]["found"]
        finally:
            process.send_signal(signal.SIGTERM)


def test_the_doctor_says_what_is_wrong_with_the_file(tmp_path: Path) -> None:
    path = _file(tmp_path, 'vehicle = "bluerov2"\n[devices.sonar]\ndriver = "x"\n')
    done = subprocess.run(
        autopilot_command("doctor", "--config", str(path), "--json"), capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert "$.devices.sonar" in json.loads(done.stdout)[0]["found"]


def test_a_file_with_a_byte_order_mark_and_links_beside_each_other_is_sound(tmp_path: Path) -> None:
    text = 'vehicle = "bluerov2"\n[service]\nconnect = ["udpin:127.0.0.1:14556", "udpout:127.0.0.1:14555"]\n'
    path = _file(tmp_path, "")
    path.write_text(text + ARDUSUB.replace("{port}", "14555"), encoding="utf-8-sig")
    assert load_config(str(path)).vehicle.name == "bluerov2"


def test_a_state_folder_that_is_a_file_is_named_with_a_remedy(tmp_path: Path) -> None:
    config = _rov(tmp_path)
    (tmp_path / "state").write_text("")
    done = subprocess.run(
        autopilot_command("run", "--config", str(config)), capture_output=True, text=True, check=False
    )
    assert done.returncode == 1 and f"{tmp_path / 'state'}: is not a folder; set state_dir to one" in done.stderr


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ('vehicle = "bluerov2"\n[devices]\n', "neither `thrusters` nor `flight_controller`"),
        ('vehicle = "bluerov2"\nspeed = 1\n' + ARDUSUB, "unknown field `speed`"),
        ('vehicle = "lbv150"\n' + ARDUSUB, "give as many thrusters"),
        ('vehicle = "bluerov2-heavy"\n' + ARDUSUB, "has motors 1 to 6"),
        ('vehicle = "nautilus.toml"\n' + ARDUSUB, "nautilus.toml"),
        ('vehicle = "bluerov2"\n[parameters]\nNO_SUCH = 1\n' + ARDUSUB, "NO_SUCH"),
        ('vehicle = "bluerov2"\n[parameters]\nFS_LEAK_ACT = 7\n' + ARDUSUB, "FS_LEAK_ACT"),
        ('vehicle = "bluerov2"\n[place]\nmarkers = "floor.toml"\n' + ARDUSUB, "without `$.devices.camera`"),
        ('vehicle = "bluerov2"\n[place]\norigin_lat_deg = 1\n' + ARDUSUB, "give both or neither"),
        ('vehicle = "bluerov2"\n[place]\nfloor_depth_m = "deep"\n' + ARDUSUB, "$.place.floor_depth_m"),
        (
            'vehicle = "bluerov2"\n' + ARDUSUB.replace('"vectored"', '"vectored"\nsurface_pa = -5'),
            "$.devices.flight_controller.surface_pa",
        ),
        (
            'vehicle = "bluerov2"\n' + ARDUSUB.replace('"vectored"', '"vectored"\nsurface_pa = 1013.25'),
            "`surface_pa` = 1013.25 Pa; use 50000 to 120000 Pa",
        ),
        ('vehicle = "bluerov2"\n[service]\nconnect = []\n' + ARDUSUB, "`connect` is empty"),
        (
            'vehicle = "bluerov2"\n[service]\nconnect = ["udpin:0.0.0.0:14555"]\n' + ARDUSUB,
            "`$.service.connect` and `$.devices.flight_controller.connect` both listen on UDP port 14555",
        ),
        *(
            (
                'vehicle = "bluerov2"\n' + ARDUSUB.replace("udpin:127.0.0.1:{port}", wrong),
                "flight_controller`: connection",
            )
            for wrong in ("0.0.0.0:21555", "udpin:0.0.0.0", "udpout::21555", "")
        ),
        ('vehicle = "bluerov2"\n' + ARDUSUB.replace('"ardusub"', '"ardupilot"'), "$.devices.flight_controller.driver"),
        ('vehicle = "bluerov2"\n[devices.flight_controller]\nframe = "vectored"\n', "names no `driver`"),
        (
            'vehicle = "lbv150"\n[devices.ahrs]\ndriver = "ig500"\nport = "/dev/ttyUSB0"\n'
            '[devices.thrusters]\ndriver = "sabertooth"\nport = "/dev/../dev/ttyUSB0"\n',
            "`$.devices.ahrs.port` and `$.devices.thrusters.port` = '/dev/../dev/ttyUSB0' are one line",
        ),
    ],
)
def test_a_wrong_configuration_is_named_with_its_key(tmp_path: Path, text: str, wrong: str) -> None:
    path = _file(tmp_path, text.replace("{port}", "14555"))
    with pytest.raises(ConfigError) as refusal:
        load_config(str(path))
    assert wrong in str(refusal.value)
    assert any(word in str(refusal.value) for word in ("; ", "correct", "use "))
