"""What the estimator tests share: the vehicle, and both estimators by name."""

from dataclasses import replace

import numpy as np
import pytest
from makers import Make

from autopilot.core.camera import CameraModel
from autopilot.core.markers import MarkerMap, grid_floor
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.complementary import create_complementary
from autopilot.estimator.ekf import create_ekf
from autopilot.estimator.engine import AidedEstimator
from autopilot.estimator.options import DEFAULT_OPTIONS, EstimatorOptions
from autopilot.estimator.vision import MarkerDetector
from autopilot.sitl.floor import Floor, build_floor
from autopilot.sitl.scenario import load_scenario
from tests.bench.calibrations import calibrated


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return calibrated()


@pytest.fixture(scope="session")
def floor() -> MarkerMap:
    """A tank floor with the layout of the shipped scenario."""
    polygon = np.array([[-2.5, -1.5], [2.5, -1.5], [2.5, 1.5], [-2.5, 1.5]])
    made = grid_floor(polygon_m=polygon, depth_m=1.5, pitch_m=0.08, size_m=0.06, seed=7)
    return replace(made, depth_sigma_m=0.0, scale_sigma=0.0)


@pytest.fixture(scope="session")
def tank() -> Floor:
    """The printed floor of the shipped scenario."""
    printed = build_floor(load_scenario("paper-tank"))
    assert printed is not None
    return printed


@pytest.fixture(scope="session")
def detector(tank: Floor, vehicle: Vehicle) -> MarkerDetector:
    return MarkerDetector(CameraModel.of_vehicle(vehicle), tank.markers)


@pytest.fixture
def make_ekf(vehicle: Vehicle) -> Make:
    def make(options: EstimatorOptions = DEFAULT_OPTIONS, markers: MarkerMap | None = None) -> AidedEstimator:
        return create_ekf(vehicle, markers, 1.5, options)

    return make


@pytest.fixture(params=["ekf", "complementary"])
def make(request: pytest.FixtureRequest, vehicle: Vehicle) -> Make:
    create = {"ekf": create_ekf, "complementary": create_complementary}[request.param]

    def make_one(options: EstimatorOptions = DEFAULT_OPTIONS, markers: MarkerMap | None = None) -> AidedEstimator:
        return create(vehicle, markers, 1.5, options)

    return make_one
