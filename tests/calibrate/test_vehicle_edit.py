"""New values in a copy of a vehicle file."""

import tomllib
from pathlib import Path

import pytest

from autopilot.calibrate.vehicle_edit import edited, snippet, write_updated
from autopilot.core.errors import ConfigError
from autopilot.core.vehicle import load_vehicle

CHANGES = {
    "camera.focal_px": [700.25, 701.5],
    "camera.mounting_rpy_rad": [0.01, 0.0, -0.02],
    "laser.direction_frd": [0.001, 0.002, 1.0],
    "camera.latency_s": 0.085,
}


def test_values_change_and_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "new.toml"
    write_updated("lbv150", CHANGES, 'autopilot calibrate "x"', target)
    vehicle, before = load_vehicle(str(target)), load_vehicle("lbv150")
    assert vehicle.camera.focal_px == (700.25, 701.5)
    assert vehicle.camera.mounting_rpy_rad == (0.01, 0.0, -0.02)
    assert vehicle.laser.direction_frd == (0.001, 0.002, 1.0)
    assert vehicle.camera.latency_s == 0.085
    assert vehicle.sources["camera.mounting_rpy_rad"] == 'autopilot calibrate "x"'
    assert vehicle.body == before.body
    assert vehicle.camera.center_px == before.camera.center_px
    text = target.read_text()
    assert "[camera] # PS Eye in its housing" in text
    assert "[[thruster]]" in text
    again = tmp_path / "again.toml"
    write_updated(str(target), {"camera.focal_px": [701.0, 702.0]}, "again", again)
    assert load_vehicle(str(again)).camera.focal_px == (701.0, 702.0)
    assert len(again.read_text().splitlines()) == len(text.splitlines())


def test_arrays_over_several_lines_and_comments_are_kept(tmp_path: Path) -> None:
    lines = (Path(__file__).parents[2] / "autopilot" / "data" / "vehicles" / "lbv150.toml").read_text()
    spread = lines.replace("focal_px = [986.10, 986.22]", "focal_px = [\n    986.10, # x\n    986.22,\n] # both")
    result = tomllib.loads(edited(spread, {"camera.focal_px": [701.5, 702.5]}, "s", "test"))
    assert result["camera"]["focal_px"] == [701.5, 702.5]
    assert result["camera"]["center_px"] == [351.17, 227.82]


def test_snippet_is_toml() -> None:
    assert tomllib.loads(snippet(CHANGES)) == {
        "camera": {"focal_px": [700.25, 701.5], "mounting_rpy_rad": [0.01, 0.0, -0.02], "latency_s": 0.085},
        "laser": {"direction_frd": [0.001, 0.002, 1.0]},
    }


def test_what_cannot_be_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="focal_px"):
        write_updated("lbv150", {"camera.focal_px": [-1.0, 2.0]}, "s", tmp_path / "x.toml")
    with pytest.raises(ConfigError, match="another place"):
        write_updated("lbv150", CHANGES, "s", tmp_path / "none" / "x.toml")
    with pytest.raises(ConfigError, match=r"missing\.toml: No such file or directory; name its file by --vehicle"):
        write_updated(str(tmp_path / "missing.toml"), CHANGES, "s", tmp_path / "x.toml")


def test_tables_in_one_line_and_signs_within_strings_are_edited_too() -> None:
    """What a parser by lines takes for a comment, a table or the end of an array."""
    text = (Path(__file__).parents[2] / "autopilot" / "data" / "vehicles" / "lbv150.toml").read_text()
    where = tomllib.loads(text)["laser"]["position_frd_m"]
    lines = text.splitlines()
    begin = lines.index(next(line for line in lines if line.startswith("[laser]")))
    end = next(n for n in range(begin + 1, len(lines)) if lines[n].startswith("["))
    inline = f"laser = {{ position_frd_m = {where}, direction_frd = [0.0, 0.0, 1.0] }}"
    lines = [inline, 'description = "a # b [x] = y"', *lines[:begin], *lines[end:]]
    lines = [line for n, line in enumerate(lines) if n < 2 or not line.startswith("description")]
    result = tomllib.loads(edited("\n".join(lines), CHANGES, "s", "test"))
    assert result["laser"]["direction_frd"] == CHANGES["laser.direction_frd"]
    assert result["description"] == "a # b [x] = y"


def test_what_is_no_vehicle_file_is_not_written_over(tmp_path: Path) -> None:
    film = tmp_path / "film.avi"
    film.write_bytes(b"film")
    with pytest.raises(ConfigError, match=r"film\.avi: vehicle files end in \.toml"):
        write_updated("lbv150", CHANGES, "s", film)
    assert film.read_bytes() == b"film"
