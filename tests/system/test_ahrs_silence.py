"""An AHRS that is silent for seconds: where fixes agree with the estimate the vehicle holds; surfacing comes last."""

from typing import Any

import numpy as np
import pytest
from system_harness import ROOT, OpenSession

from autopilot.core.messages import Failsafe, Outputs
from autopilot.mavlink.api import FlightMode
from autopilot.sitl.ahrs import Ig500Emulator

AT_S = 4.0
SCENARIOS = ROOT / "sitl" / "scenarios"


class Flight:
    """The paper's mission; from AT_S on the AHRS sends nothing for a while, or repeats itself."""

    def __init__(
        self, session: OpenSession, patch: pytest.MonkeyPatch, lasts_s: float, *, fault: str = "silent", **given: Any
    ) -> None:
        self.modes: list[tuple[float, FlightMode]] = []
        self.texts: list[str] = []
        self.error_m: list[float] = []
        self.resets = self.bits = 0
        scenario = (SCENARIOS / "paper-tank.toml").read_text(encoding="utf-8").replace('plan = "paper.plan"', "")
        if fault == "silent":
            send = Ig500Emulator._send

            def silent(emulator: Ig500Emulator, t_us: int, normal: float, message: bytes) -> None:
                if not AT_S <= 1e-6 * t_us < AT_S + lasts_s:
                    send(emulator, t_us, normal, message)

            patch.setattr(Ig500Emulator, "_send", silent)
        else:
            kinds = ("ahrs_freeze", "camera_blackout") if fault == "no fix either" else ("ahrs_freeze",)
            for kind in kinds:
                scenario += f'\n[[fault]]\nkind = "{kind}"\nat_s = {AT_S}\nduration_s = {lasts_s}\n'
        path = given.pop("folder") / "silence.toml"
        path.write_text(scenario, encoding="utf-8")
        plan = str(SCENARIOS / "paper.plan")
        given = {"sensors": "pose", "plan": plan, "start": True, "duration": AT_S + lasts_s + 1.0, **given}
        self.session = session(str(path), on_tick=self._tick, **given)
        self.session.run()

    def _tick(self, outputs: Outputs) -> None:
        if outputs.nav is None or outputs.t_us * 1e-6 < AT_S:
            return
        mode = self.session.parts.commander.mode
        if not self.modes or self.modes[-1][1] is not mode:
            self.modes.append((outputs.t_us * 1e-6 - AT_S, mode))
        self.bits |= outputs.mode.failsafes
        self.resets = outputs.nav.reset_count
        self.texts += [event.text for event in outputs.events]
        self.error_m.append(float(np.linalg.norm(outputs.nav.pos_ned_m - self.session.device.truth.pos_ned_m)))


@pytest.mark.parametrize(
    ("lasts_s", "fault", "sensors", "seed"),
    [
        (1.0, "silent", "pose", 1),
        (4.0, "frozen", "pose", 5),
        (3.0, "silent", "camera", 7),
    ],
)
def test_fixes_that_agree_hold_the_vehicle_where_it_is(
    session: OpenSession,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Any,
    lasts_s: float,
    fault: str,
    sensors: str,
    seed: int,
) -> None:
    """It surfaced after 0.52 s of silence, known to 10 mm."""
    flight = Flight(session, monkeypatch, lasts_s, fault=fault, folder=tmp_path, sensors=sensors, seed=seed)
    assert [mode for _, mode in flight.modes] == [FlightMode.MISSION, FlightMode.HOLD]
    assert flight.modes[1][0] == pytest.approx(0.52 if fault == "silent" else 0.72, abs=0.05)
    assert flight.bits == 1 << Failsafe.AHRS_STALE and flight.resets == 0
    assert max(flight.error_m) < 0.03
    assert flight.session.device.truth.contact_count == 0
    assert not [text for text in flight.texts if "no position fix" in text], "there were fixes"
    assert "Failsafe over: AHRS silent or frozen" in flight.texts


def test_a_silence_that_lasts_surfaces(session: OpenSession, monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    flight = Flight(session, monkeypatch, 7.0, folder=tmp_path, seed=9)
    (_, first), (hold_s, second), (surface_s, third), *_ = flight.modes
    assert (first, second, third) == (FlightMode.MISSION, FlightMode.HOLD, FlightMode.SURFACE)
    assert surface_s - hold_s == pytest.approx(5.0, abs=0.02)


def test_a_silence_without_fixes_surfaces_as_soon_as_it_is_dead_reckoning(
    session: OpenSession, monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    flight = Flight(session, monkeypatch, 4.0, fault="no fix either", folder=tmp_path, seed=10)
    surfaced_s = [t_s for t_s, mode in flight.modes if mode is FlightMode.SURFACE]
    assert surfaced_s and 0.5 < surfaced_s[0] < 1.1
