"""Tasks handed to an engine, and the stored result of a run."""

from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec

from autopilot.log.smoothness import BARS, Smoothness


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """One run, complete in itself: it may be flown in another process or on another machine."""

    run: int
    """Number in the campaign, from 0."""
    seed: int
    drawn: dict[str, float | str]
    """Values of ``[spread]`` for this run."""
    scenario_toml: str
    plan_name: str
    plan: bytes
    estimator: str
    sensors: str | None
    """None = the scenario's."""
    duration_s: float | None
    """None = the scenario's."""
    params: dict[str, float] = field(default_factory=dict)

    def fly(self, stop: Callable[[], bool] = lambda: False) -> "RunResult | None":
        """The result, None if ``stop`` ended the run. AutopilotError if it cannot be flown."""
        from autopilot.campaign.flight import fly  # the whole service

        return fly(self, stop)

    def failed(self, error: str) -> "RunResult":
        """The result of a run that could not be flown."""
        return RunResult(run=self.run, seed=self.seed, drawn=self.drawn, error=error)


NO_DISTANCES = frozenset(("planar speed", "heave", "yaw rate", "thrust"))
"""Margins that are no distances."""


class Margin(msgspec.Struct, frozen=True, kw_only=True):
    """Smallest margin of a run to one bound."""

    margin: float
    """Distance from the bound itself, without tolerance; negative = broken. SI."""
    at_s: float
    tolerance: float
    """By how much the bound may be broken before a bar is."""

    @property
    def beyond(self) -> bool:
        """Broken by more than the tolerance."""
        return not self.margin >= -self.tolerance


class RunResult(msgspec.Struct, frozen=True, kw_only=True):
    """One line of ``runs.jsonl``."""

    run: int
    seed: int
    drawn: dict[str, float | str]
    error: str | None = None
    """Why it was not flown to its end; everything below is empty then, and the same command flies it again."""
    simulated_s: float = 0.0
    cpu_s: float = 0.0
    judged: str = "bounds"
    """``accept.campaign`` of the scenario."""
    laps: int = 0
    laps_asked: int | None = None
    """None = the mission has no laps."""
    completed: bool = False
    """Whether the mission was completed."""
    margins: dict[str, Margin] = {}
    contacts: int = 0
    penetration_m: float = 0.0
    """Deepest."""
    energy_j: list[float] = []
    """Per lap, everything on board."""
    lap_s: list[float] = []
    pos_rms_m: float = 0.0
    """Estimate against truth, as the next five."""
    pos_max_m: float = 0.0
    yaw_rms_rad: float = 0.0
    current_rms_m_s: float = 0.0
    inside_share: float | None = None
    """Share of the time in which north, east, depth and yaw all were within three stated standard deviations."""
    nees: float | None = None
    """Mean square of these errors in standard deviations: 1 if the estimator knows how good it is."""
    steps: int = 0
    """Of the controller."""
    fallbacks: int = 0
    """Steps in which something else than the optimum commanded the thrusters."""
    slack_max: float = 0.0
    failsafes: list[str] = []
    events: list[str] = []
    """Warnings and worse, the first ones."""
    tube_shares: list[float] = []
    """Share of nodes inside the announced tube, by how far ahead they were
    (:data:`autopilot.campaign.tube_study.AHEAD_S`); empty if the controller announced none."""

    smoothness: Smoothness | None = None
    """Of the commands; None if there were too few of them."""

    @property
    def flown(self) -> bool:
        """Whether it was flown to its end."""
        return self.error is None

    @property
    def arrived(self) -> bool:
        """Whether it flew all laps, or completed a mission without laps."""
        return self.flown and not self.laps_missing

    @property
    def least_m(self) -> float | None:
        """Least distance beyond what has to be kept to a cylinder, a wall, the fence or the depth band."""
        return min((margin.margin for name, margin in self.margins.items() if name not in NO_DISTANCES), default=None)

    @property
    def rough(self) -> list[str]:
        """Bars of smooth commands that are not kept."""
        return [] if self.smoothness is None else BARS.broken(self.smoothness)

    @property
    def laps_missing(self) -> bool:
        """Fewer laps than the mission requires, or an incomplete mission without laps."""
        return not self.completed if self.laps_asked is None else self.laps < self.laps_asked

    @property
    def broken(self) -> list[str]:
        """Names of the bounds broken."""
        return [name for name, margin in self.margins.items() if not margin.margin >= 0.0]

    @property
    def beyond(self) -> list[str]:
        """Bounds broken by more than their tolerance."""
        return [name for name, margin in self.margins.items() if margin.beyond]

    @property
    def failed(self) -> bool:
        """Whether the run breaks an acceptance bound of the scenario."""
        if not self.flown or self.contacts > 0:
            return True
        return self.judged == "bounds" and (bool(self.beyond) or self.laps_missing)
