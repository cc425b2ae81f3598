"""Several campaigns flown as one, interleaved: run 0 of every set first."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from autopilot.campaign.definition import Campaign
from autopilot.campaign.engines import CampaignEngine
from autopilot.campaign.results import RunResult, Task
from autopilot.campaign.run_store import Shard, Store

SETS = ("r1", "r2", "r3", "r4")
"""The robustness sets that are judged by all bounds."""
WHOLE = Shard()


@dataclass(frozen=True, slots=True, kw_only=True)
class SetTask:
    """A run and the set that it belongs to."""

    name: str
    task: Task

    def fly(self, stop: Callable[[], bool] = lambda: False) -> tuple[str, RunResult] | None:
        result = self.task.fly(stop)
        return None if result is None else (self.name, result)

    def failed(self, error: str) -> tuple[str, RunResult]:
        return self.name, self.task.failed(error)


def fly_sets(
    sets: Mapping[str, tuple[Campaign, Path]],
    engine: CampaignEngine,
    runs: int,
    stop: Callable[[], bool],
    shard: Shard = WHOLE,
) -> Iterator[tuple[str, RunResult]]:
    """Fly the missing runs, each set into its folder; results are stored before they are yielded. ConfigError,
    LogError: a folder holds another campaign, is locked or cannot be written.
    """
    stores: dict[str, Store] = {}
    try:
        for name, (campaign, folder) in sets.items():
            stores[name] = Store(folder, campaign, shard)
        finished = {name: store.results() for name, store in stores.items()}
        tasks = [
            SetTask(name=name, task=campaign.task(run))
            for run in range(runs)
            if shard.holds(run)
            for name, (campaign, _) in sets.items()
            if run not in finished[name] or not finished[name][run].flown
        ]
        for each in tasks:
            stores[each.name].begin(each.task)
        for name, result in engine.run(tasks, stop):
            stores[name].append(result)
            yield name, result
    finally:
        for store in stores.values():
            store.close()
