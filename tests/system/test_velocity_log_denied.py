"""A velocity log that fixes deny is reported, and not used when they are gone; it is used again once they agree."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from autopilot.core.frames import FloatArray
from autopilot.core.samples import Sample, VelocitySample
from tests.bench.sensor_faults import FaultFlight, FaultResult, fly_fault

SAID = "Velocity log disagrees with fixes: check mounting"
WRONG: dict[str, Callable[[FloatArray], FloatArray]] = {
    "turned round": lambda v: -v,
    "turned by 90 deg": lambda v: v[[1, 0, 2]] * (1.0, -1.0, 1.0),
    "off by 0.15 m/s": lambda v: v + np.array((0.15, 0.0, 0.0)),
    "half as much again": lambda v: 1.5 * v,
    "zero": lambda v: 0.001 * v,
}


def fly(seed: int, wrong: Callable[[FloatArray], FloatArray] | None, until_s: float = 1e9) -> FaultResult:
    """A gap in the fixes, 6 s after the log has gone wrong."""

    def change(t_us: int, samples: Sequence[Sample]) -> Sequence[Sample]:
        if wrong is None or not at_s <= 1e-6 * t_us < until_s:
            return samples
        return [
            replace(s, vel_frd_m_s=wrong(np.array(s.vel_frd_m_s))) if isinstance(s, VelocitySample) else s
            for s in samples
        ]

    at_s = 8.0 + 0.7 * seed
    gap = {"kind": "camera_blackout", "at_s": at_s + 6.0, "duration_s": 6.0}
    sensors = {"depth": {}, "dvl": {}}
    flight = FaultFlight(
        at_s=at_s, seed=seed, scenario="pool", duration_s=at_s + 15.0, changes={"sensors": sensors, "fault": [gap]}
    )
    return fly_fault(flight, change)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", WRONG)
def test_a_log_that_fixes_deny_is_told_and_not_used_without_them(name: str, seed: int) -> None:
    """Nothing was told, and in the gap the log was believed: 1 to 2 m off with 3 sigma of 0.15 m, into the walls."""
    result = fly(seed, WRONG[name])
    assert SAID in result.texts
    assert result.contacts == 0 and result.inside >= 0.95 and result.worst_m < 0.3


def test_a_log_that_agrees_again_is_used_again_and_a_sound_one_never_told() -> None:
    mended, sound = fly(3, WRONG["turned round"], until_s=8.0 + 2.1 + 3.0), fly(3, None)
    assert SAID in mended.texts and SAID not in sound.texts
    for result in (mended, sound):
        assert result.contacts == 0 and result.inside >= 0.95 and result.worst_m < 0.1
