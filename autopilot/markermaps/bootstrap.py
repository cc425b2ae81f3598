"""Initial poses of views and markers from corners, printed sizes and the position of one marker.

Starting at the seed marker: a view of placed markers gets its pose from those that agree with each other; its other
markers are placed from that pose; repeated until no more views can be connected. Ids may repeat over the floor: a
marker is identified with a placed one only where the view's pose agrees, else it is another one. Positions drift by
some millimetres per metre, which the bundle adjustment corrects.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

import cv2
import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray
from autopilot.core.marker_files import AMBIGUITY_M, rotation_of
from autopilot.core.markers import CORNER_SIGNS, IntArray
from autopilot.markermaps.markermaps_tuning import BOOTSTRAP
from autopilot.markermaps.sightings import SheetView


@dataclass(slots=True, eq=False, kw_only=True)
class Placed:
    id: int
    center_ned_m: FloatArray
    r_ned_from_marker: FloatArray
    size_m: float
    """Side of the black square."""
    sights: int = 0
    """Views that placed it; its place is their mean."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TiedView:
    view: SheetView
    eye_ned_m: FloatArray
    r_ned_from_cam: FloatArray
    known: dict[int, int]
    """Marker of the view -> index of the placed one."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Bootstrap:
    """Views and markers with poses, and the number of views that could not be connected."""

    views: list[TiedView]
    markers: list[Placed]
    left_out: int
    """Views that show too little of the rest."""


def square(size_m: float) -> FloatArray:
    """(4, 3) corners in the marker's frame."""
    return np.column_stack((0.5 * size_m * CORNER_SIGNS, np.zeros(4)))


def tie_together(
    camera: CameraModel,
    views: Sequence[SheetView],
    seeds: Sequence[Placed],
    sizes_m: Mapping[int, float],
    level: bool,
    unique: Set[int],
    first: int | None = None,
) -> Bootstrap:
    """Poses of all views and markers connected with the seeds. With ``level`` all markers lie face up at the depth
    of the first seed; markers whose size is not in ``sizes_m`` are ignored. One marker alone connects a view if
    its id is in ``unique``, or if it is the view number ``first``.
    """
    world = _World(camera, list(seeds), sizes_m, level)
    tied: dict[int, TiedView] = {}
    if first is not None:
        start = world.tie(views[first], set(views[first].ids.tolist()))
        if start is not None:
            tied[first] = start
    for _ in range(BOOTSTRAP.max_passes):
        before = len(tied)
        for n, view in enumerate(views):
            if n not in tied:
                result = world.tie(view, unique)
                if result is not None:
                    tied[n] = result
        if len(tied) in (before, len(views)):
            break
    final = [world.join(tied[n]) for n in sorted(tied)]
    return Bootstrap(views=final, markers=world.markers, left_out=len(views) - len(tied))


def recognise(
    camera: CameraModel, views: Sequence[SheetView], rough: Sequence[Placed], sizes_m: Mapping[int, float], level: bool
) -> tuple[int, int] | None:
    """The view that shows most of a rough map in order, and a marker of the map that it surely shows: where to start
    when every id is there several times. None if no view shows three markers that fit together."""
    world = _World(camera, list(rough), sizes_m, level)
    best: tuple[int, int, int] | None = None
    for n in np.unique(
        np.linspace(0, len(views) - 1, min(BOOTSTRAP.recognised_views, len(views))).round().astype(int)
    ).tolist():
        _, known = world.agreeing(views[n], world.candidates(views[n]), set(), BOOTSTRAP.rough_slack)
        if len(known) >= 3 and (best is None or len(known) > best[0]):
            best = (len(known), n, known[min(known)])
    return None if best is None else best[1:]


class _World:
    """Markers placed so far."""

    def __init__(self, camera: CameraModel, seeds: list[Placed], sizes_m: Mapping[int, float], level: bool) -> None:
        self.markers = seeds
        self._camera = camera
        self._sizes_m = sizes_m
        self._level = level
        self._fixed = len(seeds)
        self._floor_m = float(seeds[0].center_ned_m[2])
        self._by_id: dict[int, list[int]] = {}
        for index, seed in enumerate(seeds):
            self._by_id.setdefault(seed.id, []).append(index)

    def tie(self, view: SheetView, unique: Set[int]) -> TiedView | None:
        """Pose of a view of placed markers; places its other markers. None if it shows too few."""
        candidates = self.candidates(view)
        pose, known = self.agreeing(view, candidates, unique)
        if pose is None:
            return None
        tied = TiedView(view=view, eye_ned_m=pose[0], r_ned_from_cam=pose[1], known=known)
        self._place_others(tied)
        return tied

    def join(self, tied: TiedView) -> TiedView:
        """Connect the view, with its markers matched again now that all are placed."""
        known: dict[int, int] = {}
        for k, marker_id in enumerate(tied.view.ids.tolist()):
            options = self._by_id.get(marker_id, [])
            corners = [self._pixels(index, tied.eye_ned_m, tied.r_ned_from_cam) for index in options]
            errors = [float(np.abs(c - tied.view.corners_px[k]).max()) for c in corners]
            if errors and min(errors) < 3.0 * BOOTSTRAP.agree_px:
                known[k] = options[int(np.argmin(errors))]
        return TiedView(view=tied.view, eye_ned_m=tied.eye_ned_m, r_ned_from_cam=tied.r_ned_from_cam, known=known)

    def _corners_m(self, index: int) -> FloatArray:
        marker = self.markers[index]
        return marker.center_ned_m + square(marker.size_m) @ marker.r_ned_from_marker.T

    def _pixels(self, index: int, eye: FloatArray, r: FloatArray) -> FloatArray:
        """(4, 2), far outside where there is no projection."""
        pixels = self._camera.project((self._corners_m(index) - eye) @ r)
        return np.nan_to_num(pixels, nan=1e6)

    def candidates(self, view: SheetView) -> list[tuple[int, int]]:
        """Marker of the view, known marker with its id; all pairs."""
        return [(k, index) for k, i in enumerate(view.ids.tolist()) for index in self._by_id.get(i, ())]

    def agreeing(
        self, view: SheetView, candidates: list[tuple[int, int]], unique: Set[int], slack: float = 1.0
    ) -> tuple[tuple[FloatArray, FloatArray] | None, dict[int, int]]:
        """The pose on which most placed markers agree, and these markers (marker of the view -> index). ``slack``
        widens the tolerance.
        """
        best: dict[int, int] = {}
        if not candidates:
            return None, best
        corners = np.array([self._corners_m(index) for _, index in candidates])
        enough = BOOTSTRAP.enough_fraction * len({k for k, _ in candidates})
        for k, index in candidates[:: max(1, len(candidates) // BOOTSTRAP.most_hypotheses)]:
            # The pose that one marker alone gives is rough: ask the others in proportion to how far off they may be.
            pose = self._pose(view, {k: index})
            if pose is None:
                continue
            agree = self._supporters(view, candidates, corners, pose, 8.0 * slack * BOOTSTRAP.agree_px)
            if len(agree) >= 2:
                pose = self._pose(view, agree)
                agree = (
                    {}
                    if pose is None
                    else self._supporters(view, candidates, corners, pose, 2.0 * slack * BOOTSTRAP.agree_px)
                )
            if len(agree) > len(best):
                best = agree
            if len(best) >= enough:
                break
        # Markers of repeated ids may fit somewhere else by chance: on a grid, one more for each of them in a hundred.
        if len(best) < BOOTSTRAP.certain and not any(int(view.ids[k]) in unique for k in best):
            return None, {}
        pose = self._pose(view, best)
        if pose is not None:
            best = self._supporters(view, candidates, corners, pose, slack * BOOTSTRAP.agree_px)
            pose = self._pose(view, best) if best else None
        return pose, best

    def _supporters(
        self,
        view: SheetView,
        candidates: list[tuple[int, int]],
        corners_m: FloatArray,
        pose: tuple[FloatArray, FloatArray],
        limit_px: float,
    ) -> dict[int, int]:
        """Which candidates' corners (n, 4, 3) lie where the view shows them; the better one where ids repeat."""
        pixels = np.nan_to_num(self._camera.project((corners_m - pose[0]) @ pose[1]), nan=1e6)
        errors = np.abs(pixels - view.corners_px[[k for k, _ in candidates]]).max(axis=(1, 2))
        result: dict[int, tuple[float, int]] = {}
        for (k, index), error in zip(candidates, errors.tolist(), strict=True):
            if error < limit_px and error < result.get(k, (np.inf, 0))[0]:
                result[k] = (error, index)
        return {k: index for k, (_, index) in result.items()}

    def _pose(self, view: SheetView, known: Mapping[int, int]) -> tuple[FloatArray, FloatArray] | None:
        """Position and attitude of the camera from placed markers, None if there is no such pose."""
        points = np.concatenate([self._corners_m(index) for index in known.values()])
        pixels = view.corners_px[list(known)].reshape(-1, 2)
        ideal = self._camera.normalized(pixels)
        origins, directions = self._camera.rays(pixels)
        offset = origins[:, :2] - origins[:, 2:] * directions[:, :2]
        pose = None
        for step in range(1 if self._camera.port is None else BOOTSTRAP.bend_steps):
            if step > 0 and pose is not None:
                depth = ((points - pose[0]) @ pose[1])[:, 2]
                ideal = directions[:, :2] + offset / np.maximum(depth, 0.05)[:, None]
            pose = _pnp(points, ideal)
            if pose is None:
                return None
        return pose

    def _place_others(self, tied: TiedView) -> None:
        """Place the other markers of a view; those placed before move to the mean of their sightings."""
        for k, marker_id in enumerate(tied.view.ids.tolist()):
            index = tied.known.get(k)
            if marker_id not in self._sizes_m or (index is not None and index < self._fixed):
                continue
            seen = self._seen(tied, k, marker_id)
            if seen is None:
                continue
            if index is not None:
                _average(self.markers[index], seen)
            elif not self._near_known(seen):
                self._by_id.setdefault(marker_id, []).append(len(self.markers))
                tied.known[k] = len(self.markers)
                self.markers.append(seen)

    def _near_known(self, seen: Placed) -> bool:
        """Whether a marker of this id lies so close that the new one must be a mistake."""
        places = [self.markers[index].center_ned_m for index in self._by_id.get(seen.id, ())]
        return any(float(np.linalg.norm(p - seen.center_ned_m)) < BOOTSTRAP.same_fraction * AMBIGUITY_M for p in places)

    def _seen(self, tied: TiedView, k: int, marker_id: int) -> Placed | None:
        """Position of a marker from one view alone."""
        size_m = self._sizes_m[marker_id]
        if self._level:
            origins, directions = self._camera.rays(tied.view.corners_px[k])
            starts = tied.eye_ned_m + origins @ tied.r_ned_from_cam.T
            rays = directions @ tied.r_ned_from_cam.T
            if float(rays[:, 2].min()) < 0.1:
                return None
            corners = starts + rays * ((self._floor_m - starts[:, 2]) / rays[:, 2])[:, None]
            center, r = corners.mean(axis=0), rotation_of(corners)
            yaw = np.arctan2(r[1, 0] - r[0, 1], r[0, 0] + r[1, 1])
            c, s = np.cos(yaw), np.sin(yaw)
            r = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        else:
            ideal = self._camera.normalized(tied.view.corners_px[k])
            pose = _pnp(square(size_m), ideal)
            if pose is None:
                return None
            eye_marker, r_marker_from_cam = pose
            r = tied.r_ned_from_cam @ r_marker_from_cam.T
            center = tied.eye_ned_m - r @ eye_marker
        return Placed(id=marker_id, center_ned_m=center, r_ned_from_marker=r, size_m=size_m, sights=1)


def _average(marker: Placed, seen: Placed) -> None:
    """Move a marker to the mean of its sights, this one included."""
    weight = 1.0 / (marker.sights + 1)
    marker.center_ned_m = marker.center_ned_m + weight * (seen.center_ned_m - marker.center_ned_m)
    mean = (1.0 - weight) * marker.r_ned_from_marker + weight * seen.r_ned_from_marker
    u, _, vt = np.linalg.svd(mean)
    marker.r_ned_from_marker = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    marker.sights += 1


def _pnp(points: FloatArray, ideal: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Eye (3,) and attitude (3, 3) of a camera that sees points (n, 3) at ideal image points (n, 2)."""
    try:
        found, turn, shift = cv2.solvePnP(points, ideal, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
        if found:
            turn, shift = cv2.solvePnPRefineLM(points, ideal, np.eye(3), None, turn, shift)
    except cv2.error:
        return None
    if not found or not (np.isfinite(turn).all() and np.isfinite(shift).all()):
        return None
    r_cam_from_ned = np.asarray(cv2.Rodrigues(turn)[0], dtype=float)
    if float((points @ r_cam_from_ned.T + np.asarray(shift).ravel())[:, 2].min()) <= 0.0:
        return None
    return -r_cam_from_ned.T @ np.asarray(shift, dtype=float).ravel(), r_cam_from_ned.T


def network_indices(bootstrap: Bootstrap) -> tuple[IntArray, IntArray, FloatArray]:
    """View, marker (k,) and corners (k, 4, 2) of all observations."""
    rows = [
        (v, index, tied.view.corners_px[k]) for v, tied in enumerate(bootstrap.views) for k, index in tied.known.items()
    ]
    return (
        np.array([row[0] for row in rows], dtype=np.int64),
        np.array([row[1] for row in rows], dtype=np.int64),
        np.array([row[2] for row in rows]),
    )
