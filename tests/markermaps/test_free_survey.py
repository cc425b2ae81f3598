"""Surveys of markers on walls and boxes from pictures and films of any camera, and what is said of them."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from free_world import camera, draw, fitted, places, room, walk_round

from autopilot.cli.markers_command import markers as commands
from autopilot.core.camera import CameraModel
from autopilot.core.errors import ConfigError
from autopilot.core.marker_files import load_marker_map, make_map, placed_markers
from autopilot.core.markers import CORNER_SIGNS, MarkerMap
from autopilot.markermaps import sightings
from autopilot.markermaps.camera_files import load_camera
from autopilot.markermaps.scale import Length
from autopilot.markermaps.sightings import SheetView
from autopilot.markermaps.survey import Survey, survey_map

DICTIONARY, SIZE_M = "DICT_5X5_250", 0.08
CHARUCO = Path(__file__).parents[1] / "data" / "opencv_contrib" / "tutorial_camera_charuco.yml"


def nothing_known() -> MarkerMap:
    corners = np.zeros((250, 4, 3))
    corners[..., :2] = 0.5 * SIZE_M * CORNER_SIGNS
    return MarkerMap(dictionary=DICTIONARY, size_m=SIZE_M, ids=np.arange(250), corners_ned_m=corners)


def error_m(found: MarkerMap, true: MarkerMap) -> float:
    return fitted(found.centers_ned_m, true.centers_ned_m[found.ids])[1]


def surveyed(model: CameraModel, seed: int, *lengths: Length) -> tuple[MarkerMap, Survey]:
    true = room()
    views = walk_round(true, model, np.random.default_rng(seed))
    fixed = np.empty(0, dtype=np.int64)
    return true, survey_map(model, views, nothing_known(), fixed=fixed, level=False, lengths=lengths)


def command_of(sources: list[str], lens: Path, dictionary: str = DICTIONARY) -> list[str]:
    given = ["--dictionary", dictionary, "--size", str(SIZE_M), "--camera", str(lens), "--anywhere"]
    return ["survey", *sources, *given]


def camera_file(path: Path, model: CameraModel, *, ros: bool) -> Path:
    (fx, fy), (cx, cy) = model.focal_px, model.center_px
    matrix, distortion = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], list(model.distortion[: 4 if model.fisheye else 5])
    lines = [f"image_width: {model.width_px}", f"image_height: {model.height_px}"]
    if ros:
        lines += [f"distortion_model: {'equidistant' if model.fisheye else 'plumb_bob'}"]
        lines += ["camera_matrix:", "  rows: 3", "  cols: 3", f"  data: {matrix}"]
        lines += ["distortion_coefficients:", "  rows: 1", f"  cols: {len(distortion)}", f"  data: {distortion}"]
    else:
        lines = ["%YAML:1.0", "---", *lines, "camera_matrix: !!opencv-matrix", "   rows: 3", "   cols: 3", "   dt: d"]
        lines += [
            f"   data: {matrix}",
            "distortion_coefficients: !!opencv-matrix",
            "   dt: d",
            f"   data: {distortion}",
        ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(("fisheye", "seed"), [(False, 1), (True, 2)])
def test_walls_boxes_and_floor_from_a_walk_round(fisheye: bool, seed: int) -> None:
    """Nothing known but the printed size: places within a millimetre of each other, on all faces."""
    true, result = surveyed(camera(fisheye=fisheye), seed)
    assert len(result.rows) >= 32
    assert not result.markers.level
    assert error_m(result.markers, true) < 0.0015
    assert result.converged
    assert not result.scaled
    assert result.repeated == result.misread == []


def test_a_length_fixes_the_scale() -> None:
    """The printed size is 0.6 % off: the map is too, and not when somebody measured."""
    true = room()
    far = float(np.linalg.norm(true.centers_ned_m[0] - true.centers_ned_m[20]))
    _, result = surveyed(camera(), 3, Length(first=0, second=20, metres=1.006 * far))
    assert result.scaled
    assert result.scale == pytest.approx(1.006, abs=0.003)
    first, second = (result.markers.centers_ned_m[result.markers.ids == number][0] for number in (0, 20))
    assert np.linalg.norm(first - second) == pytest.approx(1.006 * far, rel=1e-6)
    assert result.markers.sizes_m[0] == pytest.approx(result.scale * SIZE_M, rel=1e-6)
    with pytest.raises(ConfigError, match="marker 200 is 0 times in the survey"):
        surveyed(camera(), 3, Length(first=0, second=200, metres=1.0))


class Walk:
    """The command, on corners of a walk round the room instead of pictures."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch, views: list[SheetView]) -> None:
        patch.setattr(sightings, "views_of_images", lambda *_: views)
        self.out = folder / "map.toml"
        picture = folder / "0.png"
        picture.write_bytes(b"")
        lens = camera_file(folder / "camera.yml", camera(), ros=False)
        self._command = [*command_of([str(picture)], lens), "--out", str(self.out)]

    def survey(self, *more: str) -> Any:
        self.out.unlink(missing_ok=True)
        return CliRunner().invoke(commands, [*self._command, *more])


def lengths_of(true: MarkerMap, *given: tuple[int, int, float]) -> list[str]:
    """``--length`` of pairs, each off by a factor."""
    result = []
    for a, b, factor in given:
        metres = factor * float(np.linalg.norm(true.centers_ned_m[a] - true.centers_ned_m[b]))
        result += ["--length", str(a), str(b), f"{metres:.4f}"]
    return result


@pytest.mark.parametrize(
    ("given", "words", "seeds"),
    [
        ([(2, 14, 1.0)], "", 1),
        ([(2, 14, 1.005), (0, 20, 1.005)], "", 3),
        ([(2, 14, 0.995)], "", 3),
        (
            [(2, 14, 5.0 / 0.72)],
            r"--length 2 14 [\d.]+: markers of 80.\d mm are [\d.]+ m apart here.* 55\d.\d mm: measure",
            1,
        ),
        ([(2, 14, 1000.0)], "--length 2 14", 1),
        ([(2, 14, 1.03)], "--length 2 14", 3),
        ([(2, 14, 0.1)], "--length 2 14", 1),
        ([(0, 20, 1.0), (2, 14, 1.2)], "--length 2 14", 1),
        ([(0, 20, 1.007), (2, 14, 0.993)], r"--length 0 20 [\d.]+ and --length 2 14 [\d.]+ disagree by 1.\d%", 3),
    ],
)
def test_a_length_that_cannot_be_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: list[tuple[int, int, float]], words: str, seeds: int
) -> None:
    """5 m for 0.72 m made markers of 417 mm out of 60 mm, with exit 0. ``seeds``: what is near the limit is tried with
    several walks."""
    true = room()
    for seed in range(seeds):
        walk = Walk(tmp_path, monkeypatch, walk_round(true, camera(), np.random.default_rng(seed), count=20))
        done = walk.survey(*lengths_of(true, *given))
        if words:
            assert isinstance(done.exception, ConfigError) and re.search(words, str(done.exception)), done.exception
            assert not walk.out.exists()
        else:
            assert done.exit_code == 0 and walk.out.exists(), done.output


def test_a_length_of_one_marker_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    walk = Walk(tmp_path, monkeypatch, walk_round(room(), camera(), np.random.default_rng(1)))
    for given in (("2", f"{DICTIONARY}:2", "1.0"), ("2", "3", "nan"), ("2", "3", "-1")):
        done = walk.survey("--length", *given)
        assert done.exit_code == 2 and "give two markers and metres" in done.output and not walk.out.exists()


def test_markers_that_were_seen_and_left_out_are_listed_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    true, rng = room(), np.random.default_rng(2)
    views = walk_round(true, camera(), rng)
    often = [n for n in range(16) if sum(n in view.ids for view in views) >= 6]
    once, moving, hidden = often[:3]
    at = next(n for n, view in enumerate(views) if once in view.ids)
    changed = []
    for n, view in enumerate(views):
        corners, ids = view.corners_px.copy(), view.ids.copy()
        corners[ids == moving] += rng.uniform(60.0, 200.0, 2) * rng.choice([-1.0, 1.0], 2)
        if n % 3 == 0:
            ids[ids == hidden] = 240
        keep = (ids != once) | (n == at)
        changed.append(replace(view, ids=ids[keep], corners_px=corners[keep]))
    lengths = lengths_of(true, (20, 22, 1.0))
    done = Walk(tmp_path, monkeypatch, changed).survey("--json", *lengths)
    assert done.exit_code == 3, done.output
    dropped = {row["name"].split()[1]: row for row in json.loads(done.stdout)["dropped"]}
    assert dropped[str(once)]["views"] == 1 and "2 views are needed" in dropped[str(once)]["reason"]
    assert "disagree" in dropped[str(moving)]["reason"]
    assert dropped["240"]["reason"].startswith("lies on") and str(hidden) in dropped["240"]["reason"]
    assert "2 markers were seen and are not in the map" in done.stderr
    done = Walk(tmp_path, monkeypatch, changed).survey(*lengths)
    assert "Seen, but not in the map" in done.stdout


@pytest.mark.parametrize(("fisheye", "film"), [(False, False), (True, True)])
def test_pictures_and_films_by_the_command(tmp_path: Path, fisheye: bool, film: bool) -> None:
    """Rendered pictures of a pinhole camera, a film of a fisheye; the scale is warned of, and --length ends that."""
    true, model, rng = room(), camera(fisheye=fisheye), np.random.default_rng(4)
    pictures = [draw(true, model, eye, r, rng) for eye, r in places(rng, 14)]
    sources = [str(tmp_path / ("walk.avi" if film else f"{n:02d}.png")) for n in range(1 if film else len(pictures))]
    if film:
        writer = cv2.VideoWriter(sources[0], cv2.VideoWriter.fourcc(*"MJPG"), 5.0, (1280, 960))
        for picture in pictures:
            writer.write(picture)
        writer.release()
    else:
        for source, picture in zip(sources, pictures, strict=True):
            cv2.imwrite(source, picture)
    lens = camera_file(tmp_path / "camera.yml", model, ros=film)
    out = tmp_path / "map.toml"
    length = float(np.linalg.norm(true.centers_ned_m[2] - true.centers_ned_m[14]))
    given = [] if film else ["--length", "2", "14", f"{length:.4f}"]
    result = CliRunner().invoke(
        commands,
        [*command_of(sources, lens), "--out", str(out), "--json", *given],
    )
    assert result.exit_code == (3 if film else 0), result.stderr
    assert json.loads(result.stdout)["scaled"] is not film
    assert ("the scale is that of the printed size alone" in result.stderr) is film
    assert "same id" not in result.stderr
    found = load_marker_map(out)
    assert len(found.ids) >= 24
    places_m, true_m = found.centers_ned_m, true.centers_ned_m[found.ids]
    spread = np.linalg.norm(true_m - true_m.mean(axis=0)) / np.linalg.norm(places_m - places_m.mean(axis=0))
    assert spread == pytest.approx(1.0, abs=0.02 if film else 0.003)
    assert fitted(spread * places_m, true_m)[1] < 0.002


def test_repeated_ids_and_wrong_cells_are_named(tmp_path: Path) -> None:
    """One id is there twice on the wall, and two cells of another marker are wrong: read all the same, and told."""
    true, model, rng = room(dictionary="DICT_6X6_50"), camera(), np.random.default_rng(5)
    placed = placed_markers(true)
    twice = make_map([*placed[:22], replace(placed[22], id=16), *placed[23:]], "test")
    sources = []
    for n, (eye, r) in enumerate(places(rng, 10)):
        sources.append(str(tmp_path / f"{n:02d}.png"))
        cv2.imwrite(sources[-1], draw(twice, model, eye, r, rng, wrong={6: ((2, 3), (4, 5)), 7: ((3, 3),)}))
    lens = camera_file(tmp_path / "camera.yml", model, ros=False)
    result = CliRunner().invoke(commands, command_of(sources, lens, "DICT_6X6_50"))
    assert result.exit_code == 3, result.output
    assert "several markers have the same id: DICT_6X6_50 16;" in result.stderr
    (told,) = re.findall("cells of these are wrong: (.*);", result.stderr)
    assert "DICT_6X6_50 6" in told.split(", ")
    assert "DICT_6X6_50 7" not in told, "one cell is no news"


def test_camera_files(tmp_path: Path) -> None:
    lens = load_camera(CHARUCO)
    assert (lens.width_px, lens.height_px, lens.fisheye) == (640, 480, False)
    assert lens.focal_px == pytest.approx((452.511, 456.767), abs=1e-3)
    assert lens.distortion[4] == pytest.approx(2.9542589)
    for fisheye in (False, True):
        written = camera_file(tmp_path / "ros.yaml", camera(fisheye=fisheye), ros=True)
        again = load_camera(written)
        assert again.fisheye is fisheye
        assert again.distortion == pytest.approx(camera(fisheye=fisheye).distortion)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("image_width", "breadth"), "has no `image_width`"),
        (("camera_matrix", "matrix"), "has no `camera_matrix`"),
        (("distortion_coefficients", "bend"), "has no `distortion_coefficients`"),
        (("plumb_bob", "rational_polynomial"), "'rational_polynomial' cannot be used"),
        (("1050.0", "0.0"), "is not 3 x 3 with focal lengths above 0"),
        (("-0.0005, 0.0]", "-0.0005, 0.0, 0.3]"), "has 6 distortion coefficients; a pinhole camera can have 5"),
    ],
)
def test_camera_files_that_cannot_be_used(tmp_path: Path, change: tuple[str, str], says: str) -> None:
    path = camera_file(tmp_path / "ros.yaml", camera(), ros=True)
    path.write_text(path.read_text(encoding="utf-8").replace(*change), encoding="utf-8")
    with pytest.raises(ConfigError, match=says):
        load_camera(path)
