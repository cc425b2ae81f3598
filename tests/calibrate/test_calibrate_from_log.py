"""From a recorded log to a vehicle file: corners and dots of a camera that sits otherwise than the file says."""

import json
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from flights import FLOOR_M, Motion, make_flight

from autopilot.calibrate.recorded_flight import read_flight
from autopilot.cli.main import cli, run
from autopilot.core.camera import CameraModel
from autopilot.core.errors import LogError
from autopilot.core.frames import r_ned_from_frd
from autopilot.core.markers import grid_floor
from autopilot.core.params import ParamSet
from autopilot.core.samples import AhrsSample, MarkerSighting
from autopilot.core.vehicle import load_vehicle
from autopilot.log.packing import records
from autopilot.log.packing.records import pack_record
from autopilot.log.writer import LogWriter
from autopilot.record.estimator_setup import estimator_attachments

EPOCH_NS = 1_767_225_600_000_000_000
DURATION_S = 14.0
MOUNTING, LATE_S = (0.02, -0.015, 0.03), 0.030
BEAM_FRD = np.array([0.004, -0.006, 1.0])


class Level(Motion):
    """At one depth."""

    def pos(self, t: np.ndarray) -> np.ndarray:
        return super().pos(t) * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.6]


def record(path: Path, motion: Motion | None = None, *, markers: bool = True, sightings: bool = True) -> Path:
    """A log of a made-up flight over a floor of markers."""
    vehicle = load_vehicle("lbv150")
    square = np.array([[-1.2, -1.2], [1.2, -1.2], [1.2, 1.2], [-1.2, 1.2]])
    floor = grid_floor(polygon_m=square, depth_m=FLOOR_M, pitch_m=0.08, size_m=0.06, seed=7)
    motion, rng = motion or Motion(), np.random.default_rng(5)
    flight = make_flight(motion, duration_s=DURATION_S)
    true = CameraModel.of(
        msgspec.structs.replace(vehicle.camera, mounting_rpy_rad=MOUNTING),
        msgspec.structs.replace(vehicle.laser, direction_frd=tuple(BEAM_FRD.tolist())),
    )
    attachments = {"vehicle.json": msgspec.json.encode(vehicle)}
    if markers:
        attachments |= estimator_attachments("ekf", ParamSet(), floor, FLOOR_M)
    with LogWriter(
        path, epoch_ns=EPOCH_NS, metadata={"epoch_ns": str(EPOCH_NS)}, attachments=attachments, lossless=True
    ) as log:
        # The service's clock begins a second before the flight.
        for t_s, rpy, rate, force in zip(
            flight.ahrs.t_s + 1.0,
            flight.ahrs.rpy_rad,
            flight.ahrs.rate_frd_rad_s,
            flight.ahrs.accel_frd_m_s2,
            strict=True,
        ):
            t_us = round(t_s * 1e6)
            sample = AhrsSample(t_us=t_us, rpy_rad=rpy, rate_frd_rad_s=rate, accel_frd_m_s2=force)
            log.write("/in/ahrs_raw", t_us, pack_record("/in/ahrs_raw", EPOCH_NS + 1000 * t_us, sample))
        for t_s in np.arange(0.0, DURATION_S, 1.0 / 15.0):
            t_us = round((t_s + 1.0 + LATE_S) * 1e6)
            pos, rpy = motion.pos(np.array([t_s]))[0], motion.rpy(np.array([t_s]))[0]
            r = r_ned_from_frd(rpy)
            zero = np.zeros(3)
            state = SimpleNamespace(
                pos_ned_m=pos + 0.01, rpy_rad=rpy, vel_frd_m_s=zero, vel_water_frd_m_s=zero, rate_frd_rad_s=zero,
                current_ned_m_s=zero,
            )  # fmt: skip
            log.write("/nav/state", t_us, pack_record("/nav/state", EPOCH_NS + 1000 * t_us, state))
            if not sightings:
                continue
            seen = floor.visible(true, pos, r)[:24]
            corners = true.project(true.cam_from_ned(floor.corners_ned_m[seen], pos, r))
            start = pos + r @ (true.position_frd_m + true.r_frd_from_cam @ true.laser_offset_cam_m)
            along = r @ true.r_frd_from_cam @ true.laser_direction_cam
            sighting = MarkerSighting(
                t_us=t_us,
                ids=tuple(int(i) for i in floor.ids[seen]),
                corners_px=corners + 0.1 * rng.standard_normal(corners.shape),
                laser_px=true.laser_pixel((FLOOR_M - start[2]) / along[2]) + 0.3 * rng.standard_normal(2),
            )
            log.write("/in/markers", t_us, records.marker_sighting(EPOCH_NS + 1000 * t_us, sighting))
    return path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("log") / "flight.mcap")


def call(*arguments: str) -> int:
    return run(lambda: cli(["calibrate", *arguments], standalone_mode=False))


def test_one_after_the_other(recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(tmp_path / f"{n}.toml") for n in range(3)]
    assert call("latency", str(recorded), "--out", files[0]) == 0
    assert call("extrinsics", str(recorded), "--vehicle", files[0], "--out", files[1]) == 0
    assert call("laser", str(recorded), "--vehicle", files[1], "--out", files[2]) == 0
    capsys.readouterr()
    judge(files[2])


def judge(file: str) -> None:
    found = load_vehicle(file)
    assert found.camera.time_offset_s == pytest.approx(-LATE_S, abs=0.002)
    assert found.camera.mounting_rpy_rad == pytest.approx(MOUNTING, abs=0.004)
    assert found.laser.direction_frd == pytest.approx(tuple(BEAM_FRD.tolist()), abs=0.005)
    offset = np.subtract(found.laser.position_frd_m, found.camera.position_frd_m)
    assert offset == pytest.approx([0.0, 0.05, 0.0], abs=0.002)


def test_all_at_once(recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "new.toml")
    assert call("flight", str(recorded), "--out", out) == 0
    judge(out)
    told = capsys.readouterr().out
    assert all(word in told for word in ("camera time offset", "camera yaw", "beam towards x", "before"))
    sources = load_vehicle(out).sources
    for step, key in (("latency", "camera.time_offset_s"), ("laser", "laser.direction_sigma_rad")):
        assert sources[key] == f"autopilot calibrate flight, {step}: flight.mcap"
    # The new file on the same log finds that nothing is left.
    assert call("flight", str(recorded), "--vehicle", out, "--out", str(tmp_path / "again.toml"), "--json") == 0
    for row in json.loads(capsys.readouterr().out)["found"]:
        assert abs(row["value"] - row["before"]) < row["sigma"], row


def test_a_step_that_fails_leaves_its_keys(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, out = record(tmp_path / "level.mcap", Level(tilt=0.0)), tmp_path / "new.toml"
    assert call("flight", str(log), "--out", str(out), "--json") == 3
    facts = json.loads(capsys.readouterr().out)
    assert facts["failed"][-1]["step"] == "laser"
    assert "change the height by a quarter" in facts["failed"][-1]["reason"]
    assert load_vehicle(str(out)).laser == load_vehicle("lbv150").laser
    assert load_vehicle(str(out)).camera.time_offset_s == pytest.approx(-LATE_S, abs=0.002)


def test_nothing_is_written_if_nothing_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, out = record(tmp_path / "still.mcap", Level(yaw=0.0, tilt=0.0)), tmp_path / "new.toml"
    assert call("flight", str(log), "--out", str(out)) == 1
    told = capsys.readouterr()
    assert "the vehicle hardly turned" in " ".join(told.out.split())
    assert told.err == f"error: {log}: no step succeeded; nothing is written\n"
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ((), 2, "give either LOG, or --connect and --log"),
        (("no.mcap", "--connect", "udpout:127.0.0.1:1"), 2, "give either LOG, or --connect"),
        (("--connect", "udpout:127.0.0.1:1"), 2, "name by --log the file that the service logs to"),
        (("no-such.mcap",), 1, "cannot be read"),
    ],
)
def test_what_is_missing_is_named(
    arguments: tuple[str, ...], code: int, words: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert call("flight", *arguments, "--out", str(tmp_path / "new.toml")) == code
    assert words in capsys.readouterr().err


def test_logs_that_cannot_be_used(tmp_path: Path, recorded: Path) -> None:
    with pytest.raises(LogError, match="give the marker map with --map"):
        read_flight(record(tmp_path / "a.mcap", markers=False, sightings=False))
    with pytest.raises(LogError, match=r"holds no /in/markers; it needs a camera"):
        read_flight(record(tmp_path / "b.mcap", sightings=False))
    elsewhere = tmp_path / "far.toml"
    elsewhere.write_text(
        '[defaults]\ndictionary = "DICT_4X4_1000"\nsize_m = 0.06\n[[marker]]\nid = 1\ncenter_m = [50.0, 0.0, 1.5]\n'
    )
    with pytest.raises(LogError, match=r"0 of 210 sightings give a pose, .* check the marker map"):
        read_flight(recorded, markers=elsewhere)
