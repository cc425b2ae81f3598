"""Description of a marker map, and warnings before it is used."""

import math

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.dictionaries import CUSTOM, dictionary_label
from autopilot.core.marker_files import close_pairs, placed_markers
from autopilot.core.markers import ID_SPAN, MarkerMap
from autopilot.markermaps.markermaps_tuning import CHECK


def describe_markers(markers: MarkerMap) -> list[tuple[str, object]]:
    """Rows of a description of the map."""
    kinds = markers.ids // ID_SPAN
    rows: list[tuple[str, object]] = [("markers", len(markers.ids))]
    for kind in np.unique(kinds):
        sizes_mm = 1e3 * markers.sizes_m[kinds == kind]
        ids = np.unique(markers.ids[kinds == kind])
        span = f"{sizes_mm.min():.1f}" if np.ptp(sizes_mm) < 0.05 else f"{sizes_mm.min():.1f} to {sizes_mm.max():.1f}"
        rows.append(
            (
                dictionary_label(markers.dictionaries[kind]),
                f"{int((kinds == kind).sum())} markers, {len(ids)} ids, {span} mm",
            )
        )
    corners = markers.corners_ned_m.reshape(-1, 3)
    for axis, name in enumerate(("north", "east", "down")):
        rows.append((f"{name} [m]", f"{corners[:, axis].min():.3f} to {corners[:, axis].max():.3f}"))
    rows.append(("attitude", "face up on one level" if markers.level else "any"))
    return rows


def view_fractions(markers: MarkerMap, camera: CameraModel) -> list[tuple[float, float, float]]:
    """Visibility by height of the camera over a level floor: height [m], share of positions over the floor with
    one whole marker in view, share with two. Level vehicle, any heading.
    """
    rng = np.random.default_rng(1)
    low, high = markers.centers_ned_m[:, :2].min(axis=0), markers.centers_ned_m[:, :2].max(axis=0)
    rows = []
    for height_m in CHECK.heights_m:
        counts = []
        for _ in range(CHECK.poses):
            place = rng.uniform(low, high)
            yaw = rng.uniform(-math.pi, math.pi)
            r = np.array([[math.cos(yaw), -math.sin(yaw), 0.0], [math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
            eye = np.array([place[0], place[1], markers.floor_m - height_m])
            counts.append(len(markers.visible(camera, eye - r @ camera.position_frd_m, r, 2.0)))
        counted = np.array(counts)
        rows.append((height_m, float((counted >= 1).mean()), float((counted >= 2).mean())))
    return rows


def map_warnings(markers: MarkerMap) -> list[str]:
    """Warnings about permitted but unfavourable properties, one line each."""
    placed = placed_markers(markers)
    result = []
    tight: list[tuple[float, str]] = []
    widest_cell = float(markers.sizes_m.max()) / 6.0
    for i, j in close_pairs(markers, CHECK.quiet_cells * widest_cell):
        gap_m = _gap(placed[i].corners_ned_m, placed[j].corners_ned_m)
        cells = min(_cells(markers.dictionaries[int(markers.ids[n]) // ID_SPAN]) for n in (i, j))
        cell_m = max(placed[i].size_m, placed[j].size_m) / cells
        if gap_m < CHECK.quiet_cells * cell_m - 1e-6:
            tight.append((gap_m, f"ids {placed[i].id} and {placed[j].id}"))
    if tight:
        gap_m, who = min(tight)
        result.append(
            f"{len(tight)} pairs of markers have less than one cell of white between them, least {1e3 * gap_m:.1f} mm"
            f" ({who}); leave a wider gap"
        )
    families = {_cells(name) for name in markers.dictionaries}
    if len(families) < len(markers.dictionaries):
        result.append(
            "dictionaries with the same number of cells are mixed; a marker of one may be misread as one of the other"
        )
    if markers.floor_m < -CHECK.above_m:
        result.append(
            f"the markers lie {-markers.floor_m:.3f} m above the water on average; down is positive: turn the sign of"
            " the third number of center_m"
        )
    weak = [name for name in markers.dictionaries if name in ("DICT_APRILTAG_16h5", "DICT_ARUCO_ORIGINAL")]
    if weak:
        result.append(f"{', '.join(weak)} is read by mistake more often than others; prefer DICT_APRILTAG_36h11 or 4x4")
    return result


def _gap(a: np.ndarray, b: np.ndarray) -> float:
    """Distance of two squares (4, 3): the least one from a corner of one to an edge of the other."""
    best = math.inf
    for corners, other in ((a, b), (b, a)):
        for p in corners:
            for q0, q1 in zip(other, np.roll(other, -1, axis=0), strict=True):
                along = np.clip((p - q0) @ (q1 - q0) / ((q1 - q0) @ (q1 - q0)), 0.0, 1.0)
                best = min(best, float(np.linalg.norm(p - q0 - along * (q1 - q0))))
    return best


def _cells(dictionary: str) -> int:
    """Cells along a marker's side, border included."""
    if dictionary.startswith(CUSTOM):
        return int(dictionary.split(":")[1]) + 2
    for part, cells in (("16h5", 6), ("25h9", 7), ("36h1", 8), ("ORIGINAL", 7), ("4X4", 6), ("5X5", 7), ("6X6", 8)):
        if part in dictionary:
            return cells
    return 9
