"""Tables with a maximum number of entries, for keys that clients choose."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")
MAX_RECENT = 256
"""Maximum number of keys; the oldest is dropped first. Bounds the memory that a client can use."""


class LatestUsed(OrderedDict[K, V]):
    """Least recently used table: beyond ``most`` entries the one set or touched longest ago is evicted, and
    ``let_go`` is called with it. Lookup does not count as use.
    """

    def __init__(self, most: int, let_go: Callable[[V], None] = lambda value: None) -> None:
        super().__init__()
        self._most, self._let_go = most, let_go

    def __setitem__(self, key: K, value: V) -> None:
        super().__setitem__(key, value)
        self.move_to_end(key)
        if len(self) > self._most:
            self._let_go(self.popitem(last=False)[1])

    def touch(self, key: K, make: Callable[[], V]) -> V:
        """The entry of a key, created if it is missing."""
        value = self[key] if key in self else make()
        self[key] = value
        return value


class RecentKeys(Generic[K]):
    """Set of keys that expire after ``keep_us``; O(1) per lookup."""

    def __init__(self, keep_us: float) -> None:
        self._keep_us = keep_us
        self._since_us: OrderedDict[K, int] = OrderedDict()
        """The oldest first: keys are only ever added with the present time."""

    def __len__(self) -> int:
        return len(self._since_us)

    def knows(self, key: K, t_us: int) -> bool:
        """Whether a key has been added within the time before ``t_us``."""
        while self._since_us and not 0 <= t_us - next(iter(self._since_us.values())) < self._keep_us:
            self._since_us.popitem(last=False)
        return key in self._since_us

    def add(self, key: K, t_us: int) -> None:
        self._since_us[key] = t_us
        self._since_us.move_to_end(key)
        if len(self._since_us) > MAX_RECENT:
            self._since_us.popitem(last=False)

    def clear(self) -> None:
        self._since_us.clear()
