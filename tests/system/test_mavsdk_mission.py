"""A mission flown by MAVSDK: a client that we did not write."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace

import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync, ActionError
from mavsdk.asyncio.plugins.mission_raw import MissionItem, MissionRawAsync, MissionRawError
from system_harness import RunningService

from autopilot.core.plan import PlanItem, PlanKind
from autopilot.mission.paper import paper_plan

LOOK_S = 1.0


def _raw(kind: PlanKind, items: Sequence[PlanItem]) -> list[MissionItem]:
    """Items as MAVSDK's raw plugin takes them."""
    return [
        MissionItem(
            item.seq,
            item.frame,
            item.command,
            1 if item.seq == 0 else 0,
            1,
            item.param1,
            item.param2,
            item.param3,
            item.param4,
            item.x,
            item.y,
            item.z,
            int(kind),
        )
        for item in items
    ]


def _key(item: MissionItem) -> tuple[float, ...]:
    return (item.seq, item.command, item.x, item.y, round(item.z, 3), round(item.param1, 3), round(item.param2, 3))


async def _fly(service: RunningService) -> None:
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as sdk:
        await sdk.add_any_connection(f"udpout://127.0.0.1:{service.port}")
        while (vehicle := await sdk.first_autopilot(timeout_s=5.0)) is None:
            service.keep_waiting()
        raw, action = MissionRawAsync(vehicle), ActionAsync(vehicle)
        plan = paper_plan(1)
        fence, items = _raw(PlanKind.FENCE, plan.fence), _raw(PlanKind.MISSION, plan.mission)
        await _patiently(service, lambda: raw.upload_geofence(fence))
        # A refusal that asks for the guilty item again, behind which the next upload goes as ever.
        with pytest.raises(MissionRawError):
            deep = replace(plan.mission[1], z=-3.0)
            await raw.upload_mission(_raw(PlanKind.MISSION, (plan.mission[0], deep, *plan.mission[2:])))
        await _patiently(service, lambda: raw.upload_mission(items))
        assert [_key(item) for item in await raw.download_geofence()] == [_key(item) for item in fence]
        assert [_key(item) for item in await raw.download_mission()] == [_key(item) for item in items]
        while True:
            try:
                await action.arm()
                break
            except ActionError:
                service.keep_waiting()
                await asyncio.sleep(0.25)
        await raw.start_mission()
        ended = asyncio.create_task(_end_of_mission(raw))
        while not (await asyncio.wait([ended], timeout=LOOK_S))[0]:
            service.keep_waiting(cpu_s=150.0)
        await ended


async def _patiently(service: RunningService, upload: Callable[[], Awaitable[None]]) -> None:
    """MAVSDK gives up after 2.5 s of wall time, which a service that starts on a busy machine may need."""
    while True:
        try:
            return await upload()
        except MissionRawError:
            service.keep_waiting()


async def _end_of_mission(raw: MissionRawAsync) -> None:
    async for progress in raw.subscribe_mission_progress():
        if progress.total and progress.current == progress.total:
            return


def test_mavsdk_flies_the_mission(service: Callable[..., RunningService]) -> None:
    asyncio.run(_fly(service("--param", "MPC_COST=0")))
