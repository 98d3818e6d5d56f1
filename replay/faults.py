"""The fault table: what can be wrong with data, how fbench behaves, and how it is counted."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Literal

Behaviour = Literal["count", "degrade"]


@dataclass(frozen=True)
class FaultKind:
    """One row of the table; fatal faults are raised as errors and don't appear here."""

    behaviour: Behaviour
    """`count`: data was skipped, exit 4 unless tolerated; `degrade`: went on with less, flagged only."""
    text: str


FAULTS: dict[str, FaultKind] = {
    "LOG002": FaultKind("count", "log is truncated"),
    "LOG003": FaultKind("degrade", "no index, read in file order"),
    "LOG004": FaultKind("count", "damaged chunk skipped"),
    "LOG006": FaultKind("degrade", "chunk without checksum, integrity unverified"),
    "LOG008": FaultKind("count", "topic with an unknown schema skipped"),
    "DEC001": FaultKind("count", "message can't be decoded"),
    "DEC002": FaultKind("count", "image is corrupt"),
    "DAT001": FaultKind("count", "cloud with mostly non-finite points skipped"),
    "DAT002": FaultKind("degrade", "empty point cloud"),
    "DAT004": FaultKind("degrade", "non-finite points dropped"),
    "LIM003": FaultKind("count", "image isn't of the size that its camera is calibrated for"),
    "TIM001": FaultKind("degrade", "reference message out of order, no frame"),
    "TIM005": FaultKind("degrade", "clock jumped back, new segment"),
    "TIM007": FaultKind("degrade", "gap, new segment"),
    "GT006": FaultKind("degrade", "truth that belongs to no frame"),
    "PRD001": FaultKind("count", "pipeline gave a non-finite box or score"),
    "PRD002": FaultKind("count", "pipeline failed on a frame"),
}
"""Codes follow the fault matrix of docs/faults.md."""


@dataclass
class FaultLog:
    """Counts faults by code and keeps the first places of each."""

    keep: int = 10
    counts: Counter[str] = field(default_factory=Counter)
    places: dict[str, list[str]] = field(default_factory=dict)

    def add(self, code: str, where: str, num: int = 1) -> None:
        """Count `num` faults of `code`, met at `where` (topic, stamp, offset)."""
        self.counts[code] += num
        kept = self.places.setdefault(code, [])
        if len(kept) < self.keep:
            kept.append(where)

    @property
    def lost(self) -> int:
        """How many faults lost data."""
        return sum(n for code, n in self.counts.items() if FAULTS[code].behaviour == "count")

    def rows(self) -> list[dict[str, object]]:
        """All codes with behaviour, text, count (also when zero) and first places, in the order of the table."""
        return [
            {
                "code": code, "behaviour": kind.behaviour, "text": kind.text, "count": self.counts[code],
                "places": self.places.get(code, []),
            }
            for code, kind in FAULTS.items()
        ]  # fmt: skip
