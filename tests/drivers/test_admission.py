"""Who has a place on a shared port: the policy alone, under clients of all sorts in any order, with any times."""

from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.core.clients import ClientRecord
from autopilot.drivers.admission import KEEP_US, Admission, Why

PLACES = 4
STEP_US = 100_000

ACTIONS = st.lists(
    st.tuples(
        st.sampled_from(["enter", "bytes", "valid", "control", "leave", "wait"]),
        st.integers(0, 11),
        st.integers(1, 80),
    ),
    max_size=150,
)


class Port:
    """Clients 0 to 11, what they have said, and the rule that is tried."""

    def __init__(self, grace_us: int) -> None:
        self.t_us = 0
        self.standing: dict[int, ClientRecord] = {}
        self.grace_us = grace_us
        self.entered_us: dict[int, int] = {}
        self.admission: Admission[int] = Admission(PLACES, lambda key: self.standing.get(key, ClientRecord()), grace_us)

    def is_heard(self, key: int) -> bool:
        """Whether something valid came lately."""
        valid_us = self.standing.get(key, ClientRecord()).valid_us
        return valid_us is not None and self.t_us - valid_us < KEEP_US

    def enter(self, key: int) -> bool:
        """Ask for a place, and look at who has to go for it."""
        before = [other for other in range(12) if other in self.admission]
        entry = self.admission.enter(key, self.t_us)
        gone = entry.displaced
        assert len(self.admission) <= PLACES + 1
        assert (gone is None) or (entry.admitted and gone.key in before and gone.key not in self.admission)
        if gone is None:
            assert entry.admitted == (key in self.admission)
            assert entry.admitted or len(before) == PLACES + 1
        else:
            standing = self.standing.get(gone.key, ClientRecord())
            assert not standing.in_control
            young = {other for other in before if self.t_us - self.entered_us[other] < self.grace_us}
            unproven = {other for other in before if self.standing.get(other, ClientRecord()).valid_us is None} - young
            if standing.valid_us is None:
                assert gone.why is Why.UNPROVEN and gone.key not in young
            elif gone.why is Why.SILENT:
                assert not unproven, "who never said anything valid goes first"
                assert not self.is_heard(gone.key)
                silent = [other for other in before if not self.is_heard(other)]
                own = [self.standing.get(o, ClientRecord()) for o in silent]
                longest = min(s.valid_us for s in own if s.valid_us is not None and not s.in_control)
                assert standing.valid_us == longest, "the longest silent"
            else:
                assert len(before) == PLACES + 1 and not unproven, "the kept place is the last that is given away"
        if entry.admitted:
            self.entered_us[key] = self.t_us
        return entry.admitted


@given(actions=ACTIONS, grace_us=st.sampled_from([0, 1_500_000]))
@settings(max_examples=300, deadline=None)
def test_nobody_who_counts_is_displaced_before_one_who_counts_less(
    actions: list[tuple[str, int, int]], grace_us: int
) -> None:
    port = Port(grace_us)
    for what, key, steps in actions:
        port.admission.begin()
        port.t_us += STEP_US
        there = key in port.admission
        if what == "wait":
            port.t_us += steps * STEP_US
        elif what == "enter" and not there:
            room = port.admission.has_place(port.t_us)
            assert port.enter(key) == room
        elif what == "bytes" and there:
            port.admission.note_received(key, port.t_us)
        elif what == "valid" and there:
            port.admission.note_received(key, port.t_us)
            port.standing[key] = ClientRecord(port.t_us, port.standing.get(key, ClientRecord()).in_control)
        elif what == "control" and there:
            port.standing = {other: ClientRecord(s.valid_us) for other, s in port.standing.items()}
            port.standing[key] = ClientRecord(port.t_us, in_control=True)
        elif what == "leave" and there and not port.standing.get(key, ClientRecord()).in_control:
            port.admission.leave(key)
            port.standing.pop(key, None)


@given(
    valid_us=st.lists(st.one_of(st.none(), st.integers(0, 20 * 1_000_000)), min_size=5, max_size=5),
    grace_us=st.sampled_from([0, 1_500_000]),
)
def test_whoever_is_there_a_newcomer_comes_in_within_the_time_to_keep(
    valid_us: list[int | None], grace_us: int
) -> None:
    """Once, whatever the others do; one of them is in control and stays."""
    standing = {key: ClientRecord(0) for key in range(PLACES + 1)}
    admission: Admission[int] = Admission(PLACES, lambda key: standing.get(key, ClientRecord()), grace_us)
    for key in standing:
        admission.enter(key, 0)
    standing = {key: ClientRecord(at_us) for key, at_us in enumerate(valid_us)}
    standing[0] = ClientRecord(0, in_control=True)
    waited_us = 0
    admission.begin()
    while not admission.enter(99, 20_000_000 + waited_us).admitted:
        admission.begin()
        waited_us += STEP_US
        standing = {k: ClientRecord(20_000_000 + waited_us, s.in_control) for k, s in standing.items()}
    assert waited_us <= KEEP_US and 0 in admission and 99 in admission


def test_who_is_expected_is_let_in_and_stays() -> None:
    admission: Admission[str] = Admission(1, lambda key: ClientRecord(valid_us=0))
    assert admission.enter("a", 0).admitted and admission.enter("b", 0).admitted
    assert not admission.enter("c", 0).admitted
    assert admission.enter("target", 0, always=True).admitted
    for n in range(9):
        admission.begin()
        admission.enter(f"other {n}", KEEP_US * (n + 1))
    assert "target" in admission


def test_those_who_never_said_anything_are_forgotten_sooner() -> None:
    said: dict[str, ClientRecord] = {"station": ClientRecord(valid_us=5)}
    admission: Admission[str] = Admission(4, lambda key: said.get(key, ClientRecord()))
    for key in ("station", "silent"):
        admission.enter(key, 0)
    assert admission.idle(10, 10, 100) == []
    assert admission.idle(11, 10, 100) == ["silent"]
    assert admission.idle(101, 10, 100) == ["station", "silent"]
