"""A mission sent, read back and begun over a link that drops, duplicates and reorders a fifth of its datagrams."""

from collections.abc import Callable

from system_harness import RunningService

from autopilot.client.client_session import VehicleConnection
from autopilot.client.plan_client import same_on_the_wire
from autopilot.core.plan import PlanKind
from autopilot.mission.paper import paper_plan
from autopilot.run.children import free_port
from tests.lossy_link import LinkConditions, proxied

BAD = LinkConditions(loss=0.2, duplicate=0.2, reorder=0.2, reorder_s=0.01)


def test_mission_over_a_bad_link(service: Callable[..., RunningService]) -> None:
    vehicle, port = service(), free_port()
    with (
        proxied(port, vehicle.port, BAD) as link,
        VehicleConnection(f"udpout:127.0.0.1:{port}", at_work=vehicle.child.at_work) as client,
    ):
        client.connect(60.0)
        plan = paper_plan(1)
        for kind in (PlanKind.FENCE, PlanKind.MISSION):
            client.upload(kind, plan.items(kind))
            assert same_on_the_wire(client.download(kind), plan.items(kind))
        report = link.report()
        assert min(report["lost"], report["duplicated"], report["overtaken"]) > 10
        client.arm()
        client.start_mission()
        while not any(m.get_type() == "MISSION_CURRENT" and (m.mission_state, m.seq) == (3, 1) for m in client.poll()):
            vehicle.keep_waiting(cpu_s=150.0)
