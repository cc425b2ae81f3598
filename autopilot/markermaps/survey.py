"""Survey of a marker map: from views and a rough map to positions with standard deviations."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.dictionaries import dictionary_label
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.marker_files import AMBIGUITY_M, PlacedMarker, make_map, placed_markers
from autopilot.core.markers import ID_SPAN, IntArray, MarkerMap
from autopilot.markermaps.adjustment import Adjusted, Network, adjust
from autopilot.markermaps.bootstrap import Bootstrap, Placed, network_indices, recognise, tie_together
from autopilot.markermaps.markermaps_tuning import SURVEY
from autopilot.markermaps.scale import Length, apply_lengths
from autopilot.markermaps.sightings import SheetView


@dataclass(frozen=True, slots=True, kw_only=True)
class SurveyedMarker:
    id: int
    dictionary: str
    fixed: bool
    sights: int
    rms_px: float
    """Of its corners' residuals, outliers left out."""
    sigma_m: float
    """Larger one of the standard deviations of its place north and east (and down, if that was free)."""
    sigma_yaw_rad: float
    moved_m: float
    """Distance from where the rough map has it; NaN where that has none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DroppedMarker:
    """Seen, but not in the surveyed map."""

    name: str
    views: int
    """Views that show it."""
    reason: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Survey:
    markers: MarkerMap
    rows: list[SurveyedMarker]
    """One for each marker of the map."""
    views: int
    """Views that were used,"""
    left_out_views: int
    """and those that could not be tied to the rest."""
    unseen: list[str]
    """Markers of the rough map that no view shows,"""
    dropped: list[DroppedMarker]
    """and markers that were seen and are not in the map."""
    disbelieved: int
    """Rejected sightings of markers."""
    sights: int
    sigma_px: float
    shrink_px: float
    steps: int
    converged: bool
    repeated: list[str]
    """Markers whose id is there once in the rough map and several times in views or in the surveyed map,"""
    misread: list[str]
    """and those whose cells were wrong in a third of their sights."""
    scaled: bool
    """Whether a known length, two given poses or rough places fix the scale; else the markers' printed size does."""
    scale: float
    """By which factor the lengths changed it."""


def survey_map(
    camera: CameraModel,
    views: Sequence[SheetView],
    rough: MarkerMap,
    *,
    fixed: IntArray,
    rough_sigma: tuple[float, float] = (math.inf, math.inf),
    level: bool | None = None,
    lengths: Sequence[Length] = (),
) -> Survey:
    """Survey the markers of ``rough``, which has all ids and sizes that may be seen.

    ``fixed`` are the indices of markers whose poses are right as they stand there. The places of the others are known
    to ``rough_sigma`` (metres, radians); infinite: not at all. Without any fixed marker and without rough places the
    marker that most views show stays where it is. ``level``: whether all lie face up at one depth; None = as in the
    rough map. Everything is scaled to the ``lengths``. ConfigError if too little hangs together, or if they disagree.
    """
    level = rough.level if level is None else level
    ids, count = np.unique(rough.ids, return_counts=True)
    unique = set(ids[count == 1].tolist())
    sizes = {int(i): float(s) for i, s in zip(rough.ids[::-1], rough.sizes_m[::-1], strict=True)}
    of_map = [
        Placed(id=int(i), center_ned_m=p.center_ned_m, r_ned_from_marker=p.r_ned_from_marker, size_m=p.size_m)
        for i, p in zip(rough.ids, placed_markers(rough), strict=True)
    ]
    seeds, start = _seeds(views, rough, fixed, unique), None
    if not seeds:
        found = recognise(camera, views, of_map, sizes, level)
        if found is None:
            raise ConfigError(
                "all ids of the rough map are there several times and no view fits it anywhere; give a better map or"
                " fix two markers that one view shows"
            )
        start, seeds = found[0], [found[1]]
    first = [replace(of_map[n]) for n in seeds]
    bootstrap = tie_together(camera, views, first, sizes, level, unique, start)
    if len(bootstrap.views) < SURVEY.min_sights:
        raise ConfigError(
            f"only {len(bootstrap.views)} of {len(views)} views show marker {first[0].id % ID_SPAN} together with"
            " others; fix a marker that was seen, or record views that overlap"
        )
    network, result, nominal, anchors = _adjusted(camera, bootstrap, rough, fixed, list(seeds), rough_sigma, level)
    scale = apply_lengths(network, result, [marker.id for marker in bootstrap.markers], lengths)
    scaled = bool(lengths) or len(anchors) > 1 or math.isfinite(rough_sigma[0])
    return _report(network, result, bootstrap, rough, nominal, anchors, views, unique, scaled, scale)


def _seeds(views: Sequence[SheetView], rough: MarkerMap, fixed: IntArray, unique: set[int]) -> list[int]:
    """Indices of the markers to start from: the fixed ones that were seen, else the one that was seen most among those
    whose id is there once; empty if all ids are there several times."""
    ids, times = np.unique(np.concatenate([view.ids for view in views]), return_counts=True)
    seen = dict(zip(ids.tolist(), times.tolist(), strict=True))
    chosen = [int(n) for n in fixed if int(rough.ids[n]) in seen]
    if chosen:  # ids that occur several times do not determine the position of a view
        return [n for n in chosen if int(rough.ids[n]) in unique]
    if len(fixed):
        names = ", ".join(str(int(rough.ids[n]) % ID_SPAN) for n in fixed)
        raise ConfigError(f"no view shows a fixed marker ({names}); fix one that was seen")
    if not any(int(i) in seen for i in rough.ids):
        raise ConfigError("no view shows a marker of the map; check dictionary and sizes")
    options = [(seen[int(i)], -n) for n, i in enumerate(rough.ids) if int(i) in unique and int(i) in seen]
    return [-max(options)[1]] if options else []


def _adjusted(
    camera: CameraModel,
    bootstrap: Bootstrap,
    rough: MarkerMap,
    fixed: IntArray,
    seeds: list[int],
    rough_sigma: tuple[float, float],
    level: bool,
) -> tuple[Network, Adjusted, IntArray, set[int]]:
    """Bundle adjustment of the connected part; marker of the rough map for each one, and the given ones."""
    placed = bootstrap.markers
    centers = np.array([m.center_ned_m for m in placed])
    nominal = _match(rough, placed, centers, fixed, seeds)
    of_rough = placed_markers(rough)
    prior = [of_rough[n] if n >= 0 else m for n, m in zip(nominal, placed, strict=True)]
    known = nominal >= 0
    view, marker, corners = network_indices(bootstrap)
    network = Network(
        camera=camera,
        level=level,
        eyes_ned_m=np.array([v.eye_ned_m for v in bootstrap.views]),
        r_ned_from_cam=np.array([v.r_ned_from_cam for v in bootstrap.views]),
        centers_ned_m=centers,
        r_ned_from_marker=np.array([m.r_ned_from_marker for m in placed]),
        sizes_m=np.array([m.size_m for m in placed]),
        view=view,
        marker=marker,
        corners_px=corners,
        prior_centers_ned_m=np.array([p.center_ned_m for p in prior]),
        prior_r_ned_from_marker=np.array([p.r_ned_from_marker for p in prior]),
        prior_sigma=np.where(known[:, None], rough_sigma, np.inf),
    )
    if len(fixed):
        anchors = np.flatnonzero(np.isin(nominal, fixed)).tolist()
    else:
        anchors = [] if math.isfinite(rough_sigma[0]) else list(range(len(seeds)))
    network.prior_sigma[anchors] = SURVEY.fixed_sigma
    if level and not anchors:
        _align(network, known)
    return network, adjust(network), nominal, set(anchors)


def _match(
    rough: MarkerMap, placed: Sequence[Placed], centers: FloatArray, fixed: IntArray, seeds: list[int]
) -> IntArray:
    """Marker of the rough map (-1 none) that each placed one is: the nearest of its id, within half the ambiguity."""
    result = np.full(len(placed), -1, dtype=np.int64)
    result[: len(seeds)] = seeds
    by_id: dict[int, list[int]] = {}
    for n, i in enumerate(rough.ids.tolist()):
        by_id.setdefault(i, []).append(n)
    for k in range(len(seeds), len(placed)):
        options = by_id.get(placed[k].id, [])
        apart = [float(np.linalg.norm(rough.centers_ned_m[n] - centers[k])) for n in options]
        if apart and min(apart) < 0.5 * AMBIGUITY_M:
            result[k] = options[int(np.argmin(apart))]
    return result


def _align(network: Network, known: np.ndarray) -> None:
    """Turn and move everything in the plane to where the rough map has it: the seed's own heading was a guess."""
    have = network.centers_ned_m[known, 0] + 1j * network.centers_ned_m[known, 1]
    want = network.prior_centers_ned_m[known, 0] + 1j * network.prior_centers_ned_m[known, 1]
    if len(have) < 3:
        return
    turn = np.vdot(have - have.mean(), want - want.mean())
    turn /= max(abs(turn), 1e-12)
    shift = want.mean() - turn * have.mean()
    r = np.array([[turn.real, -turn.imag, 0.0], [turn.imag, turn.real, 0.0], [0.0, 0.0, 1.0]])
    move = np.array([shift.real, shift.imag, 0.0])
    network.eyes_ned_m = network.eyes_ned_m @ r.T + move
    network.centers_ned_m = network.centers_ned_m @ r.T + move
    network.r_ned_from_cam = r @ network.r_ned_from_cam
    network.r_ned_from_marker = r @ network.r_ned_from_marker


def _report(
    network: Network,
    result: Adjusted,
    bootstrap: Bootstrap,
    rough: MarkerMap,
    nominal: IntArray,
    anchors: set[int],
    views: Sequence[SheetView],
    unique: set[int],
    scaled: bool,
    scale: float,
) -> Survey:
    placed = bootstrap.markers
    trust = result.weight.mean(axis=1) >= SURVEY.used_weight
    sights = np.bincount(network.marker[trust], minlength=len(placed))
    contradicted = [_name(rough, placed[k].id) for k in sorted(anchors) if sights[k] < SURVEY.min_sights]
    if len(anchors) > 1 and contradicted:
        raise ConfigError(
            f"--fix: views do not show {', '.join(contradicted)} where the rough map has it; correct its pose there, or"
            " fix another one"
        )
    square = np.where(trust, (result.residual_px**2).mean(axis=(1, 2)), 0.0)
    rms = np.sqrt(np.bincount(network.marker, square, len(placed)) / np.maximum(sights, 1))
    rows, kept = [], []
    chosen, hidden = _without_conflicts(network, placed, sights)
    order = sorted(chosen, key=lambda k: (int(nominal[k]) < 0, int(nominal[k]), k))
    for k in order:
        kind, marker_id = divmod(placed[k].id, ID_SPAN)
        one = PlacedMarker(
            place="",
            dictionary=rough.dictionaries[kind],
            id=marker_id,
            size_m=float(network.sizes_m[k]),
            center_ned_m=network.centers_ned_m[k],
            r_ned_from_marker=network.r_ned_from_marker[k],
        )
        kept.append(one)
        moved = math.nan
        if nominal[k] >= 0:
            moved = float(np.linalg.norm(rough.centers_ned_m[nominal[k]] - network.centers_ned_m[k]))
        rows.append(
            SurveyedMarker(
                id=marker_id,
                dictionary=one.dictionary,
                fixed=k in anchors,
                sights=int(sights[k]),
                rms_px=float(rms[k]),
                sigma_m=float(result.sigma_m[k].max()),
                sigma_yaw_rad=float(result.sigma_turn_rad[k]),
                moved_m=moved,
            )
        )
    shown = Counter(marker_id for view in views for marker_id in (*view.ids.tolist(), *view.repeated))
    over = {placed[k].id: _name(rough, placed[c].id) for k, c in hidden.items()}
    in_map = {placed[k].id for k in chosen}
    tied = Counter(marker_id for one in bootstrap.views for marker_id in one.view.ids.tolist())
    return Survey(
        markers=make_map(kept, "survey"),
        rows=rows,
        views=len(bootstrap.views),
        left_out_views=bootstrap.left_out,
        unseen=[_name(rough, marker_id) for marker_id in rough.ids.tolist() if marker_id not in shown],
        dropped=[
            DroppedMarker(
                name=_name(rough, marker_id), views=count, reason=_why_dropped(rough, marker_id, count, tied, over)
            )
            for marker_id, count in sorted(shown.items())
            if marker_id not in in_map
        ],
        disbelieved=int((~trust).sum()),
        sights=len(trust),
        sigma_px=result.sigma_px,
        shrink_px=network.shrink_px,
        steps=result.steps,
        converged=result.converged,
        repeated=_repeated(
            rough, views, [m.id for m, n in zip(placed, sights, strict=True) if n >= SURVEY.min_sights], unique
        ),
        misread=_misread(rough, views),
        scaled=scaled,
        scale=scale,
    )


def _why_dropped(rough: MarkerMap, marker_id: int, views: int, tied: Counter[int], over: dict[int, str]) -> str:
    """Why a marker that was seen is not in the map. ``tied``: in how many connected views it is; ``over``: who is seen
    more often where it lies."""
    if marker_id not in rough.ids:
        return "not in the rough map: its size is not known"
    if marker_id in over:
        return f"lies on {over[marker_id]}, which more views show"
    if views < SURVEY.min_sights:
        return f"{SURVEY.min_sights} views are needed"
    if tied[marker_id] < SURVEY.min_sights:
        return f"{tied[marker_id]} of these views show enough of the rest; {SURVEY.min_sights} are needed"
    return "its views disagree about its place or shape: has it moved, is it flat?"


def _name(rough: MarkerMap, marker_id: int) -> str:
    kind, number = divmod(marker_id, ID_SPAN)
    known = kind < len(rough.dictionaries)
    return f"{dictionary_label(rough.dictionaries[kind]) if known else 'dictionary ' + str(kind)} {number}"


def _repeated(rough: MarkerMap, views: Sequence[SheetView], in_map: list[int], unique: set[int]) -> list[str]:
    """Ids that should be unique and are seen twice in a view, or at two positions."""
    twice = {marker_id for view in views for marker_id in view.repeated if marker_id in unique}
    twice |= {marker_id for marker_id in in_map if marker_id in unique and in_map.count(marker_id) > 1}
    return [_name(rough, marker_id) for marker_id in sorted(twice)]


def _misread(rough: MarkerMap, views: Sequence[SheetView]) -> list[str]:
    """Markers that are misread in a good share of the views that show them."""
    shown = Counter(marker_id for view in views for marker_id in view.ids.tolist())
    wrong = Counter(marker_id for view in views for marker_id in view.misread)
    often = sorted(
        marker_id for marker_id, count in wrong.items() if count >= SURVEY.misread_fraction * max(shown[marker_id], 1)
    )
    return [_name(rough, marker_id) for marker_id in often]


def _without_conflicts(
    network: Network, placed: Sequence[Placed], sights: IntArray
) -> tuple[list[int], dict[int, int]]:
    """Markers seen often enough; of two at one position the one in more views. And who was left out for which."""
    chosen: list[int] = []
    hidden: dict[int, int] = {}
    for k in np.argsort(-sights, kind="stable").tolist():
        if sights[k] < SURVEY.min_sights:
            break
        if chosen:
            apart = np.linalg.norm(network.centers_ned_m[chosen] - network.centers_ned_m[k], axis=1)
            same = np.array([placed[c].id == placed[k].id for c in chosen])
            reach = np.where(same, AMBIGUITY_M, 0.5 * (network.sizes_m[chosen] + network.sizes_m[k]))
            if (apart < reach).any():
                hidden[k] = chosen[int(np.argmin(apart - reach))]
                continue
        chosen.append(k)
    return chosen, hidden
