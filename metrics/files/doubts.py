"""What is odd about files of results without being a fault: tools would refuse them, or it can't be meant so."""

from collections.abc import Iterable
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Doubt:
    """One kind of oddity in one sequence."""

    what: str
    """Of one: `box without a velocity`."""
    num: int
    where: str
    """The first of them; empty where that says nothing."""


@dataclass
class Doubts:
    """Those of all sequences, by their kind."""

    nums: dict[str, int] = field(default_factory=dict)
    places: dict[str, str] = field(default_factory=dict)

    def add(self, doubts: Iterable[Doubt]) -> None:
        """Count some."""
        for doubt in doubts:
            if doubt.num:
                self.nums[doubt.what] = self.nums.get(doubt.what, 0) + doubt.num
                self.places.setdefault(doubt.what, doubt.where)

    def lines(self) -> list[str]:
        """Return a line a kind, with the first place."""
        places = {what: f": {where}{' ...' if self.nums[what] > 1 else ''}" for what, where in self.places.items()}
        return [f"{num} x {what}{places[what] if self.places[what] else ''}" for what, num in self.nums.items()]
