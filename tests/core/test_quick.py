"""Frozen dataclasses with a cheap ``__init__`` are as others in everything else."""

import inspect
from dataclasses import FrozenInstanceError, dataclass, field, fields, is_dataclass, replace

import pytest

from autopilot.core import messages, samples
from autopilot.core.quick import quick


@dataclass(frozen=True, slots=True, eq=False)
class _Plain:
    a: int
    b: str = "b"
    c: list[int] = field(default_factory=list, kw_only=True)
    d: float = field(default=1.5, kw_only=True)

    def __post_init__(self) -> None:
        if self.a < 0:
            raise ValueError("a is negative")


@quick
@dataclass(frozen=True, slots=True, eq=False)
class _Quick:
    a: int
    b: str = "b"
    c: list[int] = field(default_factory=list, kw_only=True)
    d: float = field(default=1.5, kw_only=True)

    def __post_init__(self) -> None:
        if self.a < 0:
            raise ValueError("a is negative")


@quick
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _More(_Quick):
    e: int


def _values(one: object) -> list[object]:
    return [getattr(one, each.name) for each in fields(one)]  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", [_Plain, _Quick])
def test_that_both_kinds_behave_alike(kind: type[_Quick]) -> None:
    assert _values(kind(3)) == [3, "b", [], 1.5]
    assert _values(kind(3, "x", d=2.0, c=[7])) == [3, "x", [7], 2.0]
    assert kind(3).c is not kind(3).c
    assert _values(replace(kind(3, c=[1]), a=4)) == [4, "b", [1], 1.5]
    for wrong in ({}, {"a": 1, "z": 2}):
        with pytest.raises(TypeError):
            kind(**wrong)
    with pytest.raises(TypeError):
        kind(1, "b", [])  # type: ignore[misc]
    with pytest.raises(ValueError, match="negative"):
        kind(-1)
    with pytest.raises(FrozenInstanceError):
        kind(1).a = 2  # type: ignore[misc]


def test_that_the_signature_and_the_inherited_fields_stay() -> None:
    plain, fast = (inspect.signature(kind.__init__).parameters for kind in (_Plain, _Quick))
    assert [(each.name, each.kind) for each in plain.values()] == [(each.name, each.kind) for each in fast.values()]
    assert _values(_More(1, e=5)) == [1, "b", [], 1.5, 5]


def test_that_it_wants_slots() -> None:
    with pytest.raises(TypeError, match="slots"):

        @quick
        @dataclass(frozen=True)
        class _Loose:
            a: int


def test_that_all_messages_are_made_so() -> None:
    kinds = [kind for module in (messages, samples) for kind in vars(module).values() if is_dataclass(kind)]
    mine = [kind for kind in kinds if kind.__module__ in (messages.__name__, samples.__name__)]  # type: ignore[union-attr]
    assert len(mine) > 25
    for kind in mine:
        assert "__setattr__" not in kind.__init__.__code__.co_names, kind  # type: ignore[misc]
