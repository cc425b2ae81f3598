"""An AHRS that lies grossly while nothing corrects it: the service goes on, whatever becomes of the estimate."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from autopilot.core.samples import AhrsSample, PoseSample, Sample
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import open_sitl

FAULT_US, GAP_US, END_S = 8_000_000, 4_000_000, 14.0


class Lying:
    """The simulated vehicle with an offset on its accelerometer and, at first, no fixes."""

    def __init__(self, inner: Any, offset_m_s2: float) -> None:
        self._inner, self._offset = inner, np.array([offset_m_s2, 0.0, 0.0])

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def poll(self, t_us: int) -> Sequence[Sample]:
        samples = self._inner.poll(t_us)
        if t_us < FAULT_US:
            return samples  # type: ignore[no-any-return]
        kept = [s for s in samples if not (isinstance(s, PoseSample) and t_us < FAULT_US + GAP_US)]
        return [
            replace(s, accel_frd_m_s2=s.accel_frd_m_s2 + self._offset) if isinstance(s, AhrsSample) else s for s in kept
        ]


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("offset_m_s2", [10.0])
def test_a_gross_offset_in_a_gap_ends_nothing(tmp_path: Path, offset_m_s2: float) -> None:
    given = {"scenario": "paper-tank", "speed": 0.0, "sensors": "pose", "start": True}
    settings = flight_settings(tmp_path, given)
    session = open_sitl(settings, {}, log=False)
    session.runtime._device = Lying(session.device, offset_m_s2)  # type: ignore[assignment]
    beats, armed = [], []
    try:
        for n in range(1, round(END_S * 100)):
            outputs = session.runtime.tick(n * 10_000)
            armed.append(outputs.mode.armed)
            beats += [n] * any(frame.data[7] == 0 for frame in outputs.mavlink_tx)
            pulses = outputs.command.pwm_us[:4]
            assert all(1000 <= pulse <= 2000 for pulse in pulses)
    finally:
        session.runtime.close()
    assert any(armed)
    assert max(np.diff(beats)) <= 120
