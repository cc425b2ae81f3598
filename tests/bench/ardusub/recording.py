"""What the cases saw with a real ArduSub, kept as figures, and how far the emulated one may differ from it."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

RECORDING = Path(__file__).resolve().parents[2] / "data" / "ardusub_suite.json"

SEND_S, READ_S, REPORT_S = 0.02, 0.02, 0.02
"""Our thrust is sent, channels are read and thrusters reported so often: a time that begins and ends at any phase."""
BEAT_S = 0.5
"""The operator's heartbeats: the last one before a silence is up to so old."""
RIVAL_PHASE_S = 1.0
"""Within it each phase between a rival's messages and ours occurs (see cases)."""
SHOWN_S = 1.0
"""ArduSub's heartbeat, where a state is shown by it only."""
STEPS_S = SEND_S + READ_S + REPORT_S
BUSY_S = 0.25
"""A computer that does other things: a process waits so long for its turn."""
SHARE = 0.15
"""Of a mission's time: other noise, other ways round."""
TOLERANCES: dict[str, float] = {
    "neutral after, s": STEPS_S,
    "told after, s": STEPS_S,
    "1700 us after, s": STEPS_S,
    "HOLD after, s": BEAT_S,
}
"""By figure, for a computer that does nothing else; what is not here is not compared."""
PARTICULAR: dict[str, float] = {
    "second sender": RIVAL_PHASE_S,
    "pilot disarms": SHOWN_S,
}
"""... by the beginning of the case's name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    must: str
    seen: str
    good: bool
    figures: dict[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    ardusub: str
    """Release and revision."""
    cases: dict[str, Outcome]


def read(path: Path = RECORDING) -> Recording:
    told = json.loads(path.read_text(encoding="utf-8"))
    return Recording(ardusub=told["ardusub"], cases={name: Outcome(**one) for name, one in told["cases"].items()})


def write(path: Path, recording: Recording) -> None:
    cases = {name: asdict(one) for name, one in recording.cases.items()}
    for one in cases.values():
        one["figures"] = {name: round(value, 4) for name, value in one["figures"].items()}
    path.write_text(json.dumps({"ardusub": recording.ardusub, "cases": cases}, indent=1) + "\n", encoding="utf-8")


def tolerance(case: str, figure: str, recorded: float, busy_s: float = BUSY_S) -> float | None:
    """None: not to be compared."""
    if figure == "mission, s":
        return SHARE * recorded
    if figure not in TOLERANCES:
        return None
    return busy_s + next((most for begin, most in PARTICULAR.items() if case.startswith(begin)), TOLERANCES[figure])


def differences(case: str, seen: Mapping[str, float], recording: Recording, busy_s: float = BUSY_S) -> list[str]:
    """Where the figures differ from the recorded ones of a case by more than they may."""
    found = []
    for name, recorded in recording.cases[case].figures.items():
        most = tolerance(case, name, recorded, busy_s)
        if most is None:
            continue
        if name not in seen:
            found.append(f"{case}: no {name}, recorded {recorded:.2f}")
        elif abs(seen[name] - recorded) > most:
            found.append(f"{case}: {name} {seen[name]:.2f}, recorded {recorded:.2f}, tolerance {most:.2f}")
    return found
