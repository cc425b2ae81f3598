"""The default estimator: extended Kalman filter (filterpy) with history."""

from autopilot.core.markers import MarkerMap
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.engine import AidedEstimator
from autopilot.estimator.kalman import KalmanCore
from autopilot.estimator.options import DEFAULT_OPTIONS, EstimatorOptions
from autopilot.estimator.protocol import Estimator, EstimatorContext


def create_ekf(
    vehicle: Vehicle,
    markers: MarkerMap | None,
    floor_depth_m: float | None,
    options: EstimatorOptions = DEFAULT_OPTIONS,
) -> AidedEstimator:
    """The extended Kalman filter behind :class:`autopilot.estimator.protocol.Estimator`."""
    sheets = 0 if markers is None or markers.errors is None else len(markers.errors.names)
    core = KalmanCore(current_3d=options.current_3d, sheets=sheets)
    return AidedEstimator(core, vehicle, markers, floor_depth_m, options)


def of_context(context: EstimatorContext) -> Estimator:
    """The EKF by name ("ekf")."""
    return create_ekf(context.vehicle, context.markers, context.floor_depth_m, context.options)
