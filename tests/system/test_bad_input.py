"""Rubbish on the links of the whole service: counted, and nothing else changes."""

import random
from typing import Any

from pymavlink.dialects.v20 import development as mav
from system_harness import OpenSession
from wire_client import Harbour, WireClient

from autopilot.core.messages import Outputs
from autopilot.core.plan import MissionResult, PlanKind
from autopilot.mission.paper import paper_plan
from autopilot.sitl.operator import ScriptedOperator

PLAN = paper_plan(1)


class Vandal:
    """Fills a link with rubbish: noise, headers without frames, damaged frames, frames for nobody."""

    def __init__(self, seed: int) -> None:
        self._rng = random.Random(seed)
        self._mav = mav.MAVLink(None, srcSystem=66, srcComponent=66)
        self.frames_heard = 0
        self.bad_texts = 0

    def step(self, _t_us: int, received: Any) -> list[bytes]:
        for data in received:
            for message in self._mav.parse_buffer(data) or ():
                self.frames_heard += 1
                self.bad_texts += message.get_type() == "STATUSTEXT" and message.severity <= mav.MAV_SEVERITY_WARNING
        return [self._rubbish() for _ in range(self._rng.randrange(3))]

    def _rubbish(self) -> bytes:
        rng = self._rng
        kind = rng.randrange(6)
        if kind == 0:
            return rng.randbytes(rng.choice((1, 7, 40, 280, 2048)))
        if kind == 1:
            return bytes((rng.choice((0xFD, 0xFE)), rng.randrange(256))) + rng.randbytes(rng.randrange(40))
        message: Any = rng.choice(
            (
                mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0, 21196, 0, 0, 0, 0, 0),
                mav.MAVLink_mission_clear_all_message(1, 1, 255),
                mav.MAVLink_mission_count_message(1, 1, 3, 0),
                mav.MAVLink_param_set_message(1, 1, b"SPD_CRUISE", 0.01, 9),
            )
        )
        frame = bytearray(message.pack(self._mav))
        if kind in (2, 3):  # one bit wrong behind the marker
            frame[rng.randrange(1, len(frame))] ^= 1 << rng.randrange(8)
            return bytes(frame)
        if kind == 4:
            return bytes(frame[: rng.randrange(1, len(frame))])
        return bytes(self._for_somebody_else())

    def _for_somebody_else(self) -> bytes:
        other = mav.MAVLink_command_long_message(9, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0, 21196, 0, 0, 0, 0, 0)
        return bytes(other.pack(self._mav))


def _flight(session: OpenSession, *others: Any) -> tuple[list[Outputs], Any]:
    outputs: list[Outputs] = []
    operator = ScriptedOperator(1)
    run = session(sensors="pose", peers=(operator, *others), on_tick=outputs.append)
    for kind in (PlanKind.FENCE, PlanKind.MISSION):
        assert run.parts.plans.replace(kind, PLAN.items(kind)) is None
    harbour = Harbour(run)
    harbour.run(8.0)
    assert operator.started
    return outputs, run


def test_garbage_while_flying_is_counted_and_nothing_else(session: OpenSession) -> None:
    """The flight with a vandal on a second link is the flight without him, bit for bit."""
    vandal = Vandal(seed=4)
    quiet, _ = _flight(session)
    noisy, run = _flight(session, vandal)
    assert run.parts.server.dropped_rx > 130
    assert vandal.frames_heard > 100  # telemetry goes on
    assert vandal.bad_texts == 0
    assert any(abs(n) > 0.5 for n in noisy[-1].command.thrust_n)
    for a, b in zip(quiet, noisy, strict=True):
        assert a.command.pwm_us == b.command.pwm_us
        assert (a.mode.armed, a.mode.custom_mode) == (b.mode.armed, b.mode.custom_mode)
        assert [event.text for event in a.events] == [event.text for event in b.events]


def test_good_messages_between_garbage_are_heard(session: OpenSession) -> None:
    client = WireClient()
    made = Harbour(session(sensors="pose", peers=(client,)))
    made.run(0.5)
    for kind in (PlanKind.FENCE, PlanKind.MISSION):
        assert made.offer(client, kind, PLAN.items(kind)) == MissionResult.ACCEPTED
    rng = random.Random(8)
    for _ in range(40):
        client.send_bytes(rng.randbytes(rng.randrange(1, 300)))
        made.tick()
    made.run(1.0)
    assert made.command(client, mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == mav.MAV_RESULT_ACCEPTED
    assert client.texts() == []
    made.run(2.1)
    counted = made.session.parts.server.dropped_rx
    assert counted > 0
    assert client.received("SYS_STATUS")[-1].errors_comm == counted
