"""Record of an estimator's construction: attachments of a log, and reading them.

Floats survive JSON and npz bit for bit, which the marker map file (rounded to micrometres) does not.
"""

import io
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from autopilot.core.errors import LogError
from autopilot.core.map_errors import error_arrays, errors_of_arrays
from autopilot.core.markers import MarkerMap
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.options import EstimatorOptions
from autopilot.log.reader import Log

ESTIMATOR_FILE = "estimator.json"
MARKERS_FILE = "markers.npz"
VEHICLE_FILE = "vehicle.json"


class EstimatorSetup(msgspec.Struct, frozen=True, kw_only=True):
    name: str
    floor_depth_m: float | None
    shadow: bool
    options: EstimatorOptions


def options_of(params: ParamSet) -> EstimatorOptions:
    """Options set by the parameters at the start of the service."""
    return EstimatorOptions(current_3d=params["EST_CURRENT_3D"] > 0.0, sigma_limit_m=params["EST_SIGMA_MAX"])


def estimator_attachments(
    name: str, params: ParamSet, markers: MarkerMap | None, floor_depth_m: float | None
) -> dict[str, bytes]:
    """Attachments from which :func:`read_setup` and :func:`read_markers` know the estimator again."""
    setup = EstimatorSetup(
        name=name, floor_depth_m=floor_depth_m, shadow=params["EST_SHADOW"] > 0.0, options=options_of(params)
    )
    result = {ESTIMATOR_FILE: msgspec.json.encode(setup)}
    if markers is not None:
        buffer = io.BytesIO()
        np.savez_compressed(
            buffer,
            dictionaries=np.array(markers.dictionaries),
            size_m=markers.size_m,
            ids=markers.ids,
            corners_ned_m=markers.corners_ned_m,
            depth_sigma_m=markers.depth_sigma_m,
            scale_sigma=markers.scale_sigma,
            **({} if markers.errors is None else error_arrays(markers.errors)),
        )
        result[MARKERS_FILE] = buffer.getvalue()
    return result


def read_setup(log: Log) -> EstimatorSetup:
    """Setup of a log's estimator. LogError if the log lacks it."""
    setup: EstimatorSetup = _decoded(log, ESTIMATOR_FILE, EstimatorSetup)
    return setup


def read_vehicle(log: Log) -> Vehicle:
    """The vehicle file of the run. LogError if the log does not hold it."""
    vehicle: Vehicle = _decoded(log, VEHICLE_FILE, Vehicle)
    return vehicle


def read_markers(attachments: Mapping[str, bytes]) -> MarkerMap | None:
    """The marker map of the run, None if it had none."""
    data = attachments.get(MARKERS_FILE)
    if data is None:
        return None
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        first, *more = (str(name) for name in file["dictionaries"])
        return MarkerMap(
            dictionary=first,
            size_m=float(file["size_m"]),
            ids=file["ids"],
            corners_ned_m=file["corners_ned_m"],
            more_dictionaries=tuple(more),
            errors=errors_of_arrays(file) if "sheet_sigma" in file else None,
            depth_sigma_m=float(file["depth_sigma_m"]) if "depth_sigma_m" in file else 0.0,
            scale_sigma=float(file["scale_sigma"]) if "scale_sigma" in file else 0.0,
        )


def _decoded(log: Log, name: str, kind: type) -> Any:
    data = log.attachments.get(name)
    if data is None:
        raise log.lacks(f"no attachment {name}", "replay needs a log of this version or later")
    try:
        return msgspec.json.decode(data, type=kind)
    except msgspec.ValidationError as error:
        raise LogError(
            f"{log.path}: attachment {name} is of another version ({error}); use the revision that made the log, which "
            "autopilot log info tells"
        ) from error
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise LogError(f"{log.path}: attachment {name} is damaged ({error}); the log cannot be replayed") from error
