"""Dictionary with a maximum number of entries, for keys that clients choose."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


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
