"""Gaps in the fixes in moving water, through the whole service: the estimate is honest and blames no sound sensor."""

import numpy as np
import pytest

from autopilot.core.messages import NavDoubt
from tests.bench.gaps import FAULTS, fly_gaps
from tests.bench.sensor_faults import FaultFlight, fly_fault


@pytest.mark.parametrize("seed", [92001, pytest.param(92002, marks=pytest.mark.long)])
def test_the_jet_carries_the_vehicle_within_3_sigma(seed: int) -> None:
    result = fly_fault(FaultFlight(gap_s=5.0, seed=seed, at_s=10.0, duration_s=17.0))
    assert result.inside >= 0.95 and result.unflagged_s <= 1.0
    assert not [text for text in result.texts if "wrong" in text], "the water explains it"


@pytest.mark.parametrize("fault", ["gyro", pytest.param("accel", marks=pytest.mark.long)])
def test_a_sensor_that_goes_wrong_in_a_gap_is_covered_and_named_after_it(fault: str) -> None:
    (gap,) = fly_gaps("jet", 92002, (3.0,), fault)
    assert np.mean(gap.inside) >= 0.95 and gap.unflagged_s <= 1.0
    assert gap.named_s <= 2.0
    assert gap.doubts <= {FAULTS[fault][0], NavDoubt.GYRO}
