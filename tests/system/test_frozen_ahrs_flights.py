"""An AHRS that hangs without repeating itself to the last bit, or only in part, just before and within a gap in the
fixes: the vehicle does not follow it, and the operator is told which device it is."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from autopilot.core.samples import AhrsSample, Sample
from tests.bench.sensor_faults import Change, FaultFlight, fly_fault

GAP_S = 4.0
FLICKER = {"rpy_rad": 1e-7, "rate_frd_rad_s": 1e-6, "accel_frd_m_s2": 1e-5}


def hanging(at_s: float, held: Sequence[str], flickers: float, axes: Sequence[int] = (0, 1, 2)) -> Change:
    """The named values stay as they were at that time, but for their last bit; ``flickers``: share that change."""
    last: list[AhrsSample] = []
    rng = np.random.default_rng(1)

    def changed(sample: AhrsSample) -> AhrsSample:
        values = {}
        for name in held:
            value = getattr(sample, name).copy()
            value[list(axes)] = getattr(last[0], name)[list(axes)]
            values[name] = value + FLICKER[name] * rng.integers(-1, 2, 3) * (rng.random(3) < flickers)
        return replace(sample, **values)

    def change(t_us: int, samples: Sequence[Sample]) -> Sequence[Sample]:
        if t_us < 1e6 * at_s:
            last[:] = [sample for sample in samples if isinstance(sample, AhrsSample)] or last
            return samples
        return [changed(sample) if isinstance(sample, AhrsSample) else sample for sample in samples]

    return change


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("late_s", [-0.5, 1.0])
@pytest.mark.parametrize("flickers", [0.1, 1.0])
def test_an_ahrs_whose_last_bits_flicker_is_frozen(flickers: float, late_s: float, seed: int) -> None:
    at_s = 10.0 + 0.7 * seed
    flight = FaultFlight(gap_s=GAP_S, at_s=at_s, seed=seed, duration_s=at_s + 7.0)
    result = fly_fault(flight, hanging(at_s + late_s, tuple(FLICKER), flickers))
    said = dict(zip(result.texts, result.said_s, strict=True))
    assert said["Failsafe SURFACE: AHRS silent or frozen"] < max(late_s, 0.0) + 2.0, "the last fix counts for 1 s"
    assert result.contacts == 0 and result.inside >= 0.95 and result.worst_yaw_rad < 0.2


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
@pytest.mark.parametrize("axes", [(0, 1, 2), (2,)])
def test_gyros_give_the_attitude_of_an_ahrs_whose_own_stands_still(axes: Sequence[int], seed: int) -> None:
    """It was the gyro that was blamed, and the vehicle turned by more than 90 degrees."""
    at_s = 10.0 + 0.7 * seed
    flight = FaultFlight(gap_s=GAP_S, at_s=at_s, seed=seed, duration_s=at_s + 7.0)
    result = fly_fault(flight, hanging(at_s + 1.0, ("rpy_rad",), 0.0, axes))
    assert "AHRS attitude frozen: its gyros are used, check it" in result.texts
    assert not [text for text in result.texts if text.startswith(("Gyro", "Accelerometer"))]
    assert result.contacts == 0 and result.inside >= 0.95 and result.worst_yaw_rad < 0.03
