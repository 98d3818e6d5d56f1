"""Keeping evenly spread items of a stream whose length isn't known."""

from collections.abc import Sequence
from typing import Generic, TypeVar

T = TypeVar("T")


class Spread(Generic[T]):
    """Keeps up to 2 `num` items, whatever the length of the stream; the first one always.

    Every `stride`-th item is kept; when there are too many, the stride doubles and every second one goes.
    """

    def __init__(self, num: int) -> None:
        self._num, self._stride, self._num_offered = num, 1, 0
        self._kept: list[T] = []

    def offer(self, item: T) -> None:
        """Keep the item if its turn has come."""
        self._num_offered += 1
        if (self._num_offered - 1) % self._stride:
            return
        self._kept.append(item)
        if len(self._kept) > 2 * self._num:
            self._kept, self._stride = self._kept[::2], self._stride * 2

    @property
    def kept(self) -> Sequence[T]:
        """All that is kept."""
        return self._kept

    @property
    def chosen(self) -> Sequence[T]:
        """At most `num` of what is kept, from the first to the last one, evenly spread."""
        last = len(self._kept) - 1
        if last < self._num:
            return self._kept
        steps = max(1, self._num - 1)
        return [self._kept[(i * last + steps // 2) // steps] for i in range(self._num)]
