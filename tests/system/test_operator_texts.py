"""What operators are told: what they can do something about, in few words, and not again and again."""

import re
from itertools import pairwise

from pymavlink.dialects.v20 import development as mav
from system_harness import PAPER_PLAN, OpenSession
from wire_client import Harbour, WireClient

from autopilot.core.messages import Event, Severity

ARM = mav.MAV_CMD_COMPONENT_ARM_DISARM


def _all(client: WireClient) -> list[str]:
    return client.texts(least=mav.MAV_SEVERITY_DEBUG)


def test_a_reason_is_said_once_and_every_command_is_answered(session: OpenSession) -> None:
    client, other = WireClient(), WireClient(sysid=254)
    harbour = Harbour(session(sensors="pose", peers=(client, other)))
    harbour.tick()  # no position yet
    texts: list[str] = []
    for _ in range(4):
        assert harbour.command(client, ARM, 1.0, 0.0) == mav.MAV_RESULT_DENIED
        texts += [text for text in client.texts() if text.startswith("Arming denied")]
    assert texts
    assert len(texts) == len(set(texts))
    assert harbour.command(other, ARM, 1.0, 0.0) == mav.MAV_RESULT_DENIED
    assert other.texts(), "another link has not been told"


def test_the_same_reason_is_said_again_after_five_seconds(session: OpenSession) -> None:
    client = WireClient()
    harbour = Harbour(session(sensors="pose", peers=(client,)))
    harbour.run(0.5)
    said_s: list[float] = []
    for k in range(120):
        client.inbox.clear()
        client.send(mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_MISSION_START, k % 2, 0, 0, 0, 0, 0, 0, 0))
        harbour.run(0.1)
        said_s += [0.1 * k] * len(client.texts())
    assert len(said_s) == 3
    assert all(after - before > 4.9 for before, after in pairwise(said_s))


FIGURES = re.compile(r"alpha|sampled|violate|Lipschitz")
"""What certificates say."""


def test_a_flight_says_nothing_that_is_for_the_log_only(session: OpenSession) -> None:
    """Certificates and other figures are events of severity DEBUG: logged, and not sent to ground stations."""
    client = WireClient()
    events: list[Event] = []
    flying = session(
        sensors="pose", plan=str(PAPER_PLAN), start=True, peers=(client,), on_tick=lambda out: events.extend(out.events)
    )
    client.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    Harbour(flying).run(6.0)
    logged = [event.text for event in events if event.severity is Severity.DEBUG]
    assert any(FIGURES.search(text) for text in logged)
    said = _all(client)
    assert said
    assert not set(said) & set(logged)
    assert not [text for text in said if FIGURES.search(text)]
    assert not [text for text in said if len(text) > 50]


def test_the_greeting_waits_until_the_station_listens(session: OpenSession) -> None:
    client = WireClient()
    harbour = Harbour(session(sensors="pose", peers=(client,), speed=1.0))
    harbour.run(0.2)
    client.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    harbour.run(1.9)
    assert not [text for text in _all(client) if "Underwater Autopilot" in text]
    harbour.run(0.2)
    (greeting,) = [text for text in _all(client) if "Underwater Autopilot" in text]
    assert len(greeting) <= 50
