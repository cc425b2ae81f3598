"""What a run of the fuzzer has found."""

import math
from collections import Counter
from dataclasses import dataclass, field, fields, replace
from typing import Any


@dataclass(slots=True)
class Result:
    """What a run of the fuzzer found."""

    seed: int
    messages: int = 0
    ticks: int = 0
    samples: int = 0
    armed_ticks: int = 0
    accepted: Counter[str] = field(default_factory=Counter)
    """Answers by kind: what was really taken and refused."""
    seconds: float = 0.0
    rss_start_mb: float = 0.0
    rss_end_mb: float = 0.0
    handled: Counter[str] = field(default_factory=Counter)
    """Messages that reached their handler, by what is special about them."""
    moods: Counter[str] = field(default_factory=Counter)
    """Ticks of each mood."""
    least_m: float = math.inf
    """Least distance of the hull from the fence in flights that have to keep it."""
    failures: list[str] = field(default_factory=list)
    """Exceptions and broken rules, one line each."""

    @property
    def per_second(self) -> float:
        """Messages per second of wall time."""
        return self.messages / self.seconds if self.seconds > 0.0 else 0.0

    def figures(self) -> dict[str, Any]:
        """Every figure by its name, counts as plain dictionaries: ``asdict`` makes a Counter one of pairs."""
        counts = {name: dict(getattr(self, name)) for name in ("accepted", "handled", "moods")}
        plain = {each.name: getattr(self, each.name) for each in fields(self)}
        return {**plain, **counts, "per_second": self.per_second}

    def rows(self) -> list[tuple[str, str]]:
        """Name and value of every figure."""
        answers = ", ".join(f"{name} {count}" for name, count in sorted(self.accepted.items()))
        return [
            ("messages", f"{self.messages}, {self.per_second:.0f} per second of wall time"),
            ("ticks", f"{self.ticks}, armed on {self.armed_ticks}; {self.samples} samples"),
            ("handled", ", ".join(f"{name} {count}" for name, count in sorted(self.handled.items()))),
            ("ticks by mood", ", ".join(f"{name} {count}" for name, count in sorted(self.moods.items()))),
            ("answers", answers),
            ("hull from the fence at least", f"{self.least_m:.3f} m"),
            ("exceptions and broken rules", str(len(self.failures))),
            ("memory", f"{self.rss_start_mb:.0f} MB warm, {self.rss_end_mb - self.rss_start_mb:+.0f} MB at the end"),
            *(("found", line) for line in dict.fromkeys(self.failures)),
        ]

    def copy(self) -> "Result":
        """The counts as they are now."""
        return replace(
            self,
            accepted=Counter(self.accepted),
            handled=Counter(self.handled),
            moods=Counter(self.moods),
            failures=list(self.failures),
        )

    def put_together(self, before: "Result", now: "Result") -> None:
        """What was there ``before`` a service and what has come of it until ``now``."""
        self.messages = before.messages + now.messages
        self.ticks = before.ticks + now.ticks
        self.samples = before.samples + now.samples
        self.armed_ticks = before.armed_ticks + now.armed_ticks
        self.accepted = before.accepted + now.accepted
        self.handled, self.moods = before.handled + now.handled, before.moods + now.moods
        self.least_m = min(before.least_m, now.least_m)
