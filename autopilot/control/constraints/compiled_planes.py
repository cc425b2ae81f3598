"""Half-planes and margins of a fence by the compiled library, in the common case (``data/native/surroundings.c``).

Ten times as fast as :mod:`autopilot.control.constraints.chords`, which documents the quantities and handles the
remaining cases (forbidden areas, crossed walls).
"""

import ctypes
import math
from typing import Any

import numpy as np

from autopilot.control.constraints.chords import RECOVERY_M_S
from autopilot.control.constraints.constraints_tuning import FEATURES
from autopilot.control.constraints.features import PolygonEdges, Rounds
from autopilot.core import compiled
from autopilot.core.frames import FloatArray

_POINTERS = ("a", "ab", "along", "normal", "polygon", "center", "radius", "side")


class _Boundaries(compiled.Mirror):
    """ctypes layout of the struct in surroundings.c."""

    _fields_ = (
        ("edges", ctypes.c_long),
        ("rounds", ctypes.c_long),
        *((name, ctypes.c_void_p) for name in _POINTERS),
        ("tiny", ctypes.c_double),
        ("far", ctypes.c_double),
        ("recovery_m_s", ctypes.c_double),
    )


STRUCTS = (_Boundaries,)


class CompiledHalfPlanes:
    """The boundaries of a fence as the library takes them."""

    def __init__(self, library: Any, edges: PolygonEdges, rounds: Rounds) -> None:
        kinds: dict[str, Any] = dict.fromkeys(("a", "ab", "along", "normal", "center"), np.complex128)
        kinds |= {"polygon": np.dtype(ctypes.c_long), "radius": float, "side": float}
        own = {"center": rounds.center, "radius": rounds.radius, "side": rounds.side}
        values = {name: own[name] if name in own else getattr(edges, name) for name in kinds}
        self._arrays = {name: np.ascontiguousarray(values[name], dtype=kind) for name, kind in kinds.items()}
        addresses = {name: array.ctypes.data for name, array in self._arrays.items()}
        self._struct = _Boundaries(
            edges=len(edges.a),
            rounds=len(rounds.center),
            tiny=FEATURES.tiny_m,
            far=FEATURES.far_m,
            recovery_m_s=RECOVERY_M_S,
            **addresses,
        )
        self._reference, self._call = ctypes.byref(self._struct), library.half_planes
        self._seen: tuple[tuple[FloatArray | int | None, ...], tuple[int | None, ...]] = (None,) * 6, ()

    def margin_m(
        self,
        points_ned_m: FloatArray,
        t_s: FloatArray,
        radius_m: FloatArray | float,
        slots: int = 0,
        normals: FloatArray | None = None,
        offsets: FloatArray | None = None,
    ) -> float | None:
        """As :meth:`autopilot.control.constraints.obstacles.Features.half_planes`; without ``normals`` its margin
        alone. None where this is not a common case: the arrays are then undefined. ValueError: an array does not fit
        to the points."""
        m = len(points_ned_m) - 1
        keep_m = np.full(m, radius_m) if isinstance(radius_m, float) else radius_m
        seen, known = self._seen
        if all(a is b for a, b in zip(seen, (points_ned_m, t_s, keep_m, normals, offsets, slots), strict=True)):
            return self._margin_m(m, known, slots)
        tight = points_ned_m.strides[1] == t_s.itemsize and t_s.flags.c_contiguous and keep_m.flags.c_contiguous
        if m < 1 or not tight or not points_ned_m.dtype == t_s.dtype == keep_m.dtype == np.float64:
            return None
        stride = points_ned_m.strides[0] // points_ned_m.itemsize
        out: tuple[int | None, int | None] = None, None
        if normals is not None and offsets is not None:
            if not (normals.flags.c_contiguous and offsets.flags.c_contiguous):
                return None
            out = compiled.fitting("normals", normals, m, slots, 2), compiled.fitting("offsets", offsets, m, slots)
        # The optimiser's arrays are the same at every step; to ask for an address takes as long as the call.
        times = compiled.fitting("t_s", t_s, m + 1), compiled.fitting("radius_m", keep_m, m)
        known = (points_ned_m.ctypes.data, stride, *times, *out)
        self._seen = (points_ned_m, t_s, keep_m, normals, offsets, slots), known
        return self._margin_m(m, known, slots)

    def _margin_m(self, m: int, known: tuple[int | None, ...], slots: int) -> float | None:
        points, stride, t_s, keep_m, *out = known
        margin: float = self._call(self._reference, m, points, stride, t_s, keep_m, slots, *out)
        return None if math.isnan(margin) else margin
