"""Rate limits and duplicate detection: keys with the time of their last use."""

from collections import OrderedDict
from collections.abc import Hashable
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)

MAX_RECENT = 256
"""Maximum number of keys; the oldest is dropped first. Bounds the memory that a client can use."""


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
