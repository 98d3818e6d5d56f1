"""What became of one box, and why."""

from dataclasses import asdict, dataclass
from typing import Literal

Outcome = Literal["hit", "missed", "false alarm", "ignored", "invalid"]


@dataclass(frozen=True)
class Verdict:
    """One truth box, detection or track in one frame, or in one image of it."""

    side: Literal["truth", "detection", "track"]
    number: int
    """Counted from 0 on in its frame or image and side, in an order that depends on the boxes alone."""
    camera: str
    """Empty in 3D."""
    class_: str
    """Its label; empty where there is none."""
    outcome: Outcome
    reason: str
    track_id: int | None
    score: float | None
    """Of estimates; `None` where it isn't finite."""
    range_m: float | None
    """From the body in the ground plane in 3D; as the results tell it in images; `None` where unknown."""
    partner: int | None
    """Number of the box of the other side that it was matched with."""
    partner_id: int | None
    likeness: float | None
    """Distance [m] or intersection over union of the two."""


@dataclass(frozen=True)
class Table:
    """Truth beside detections, or beside tracks."""

    judged: Literal["detection", "track"]
    truth: tuple[Verdict, ...]
    estimates: tuple[Verdict, ...]


@dataclass(frozen=True)
class Explanation:
    """One frame of a run."""

    frame: int
    stamp_ns: int
    class_: str
    matching: str
    num_invalid_truth: int
    """Truth boxes of the frame that aren't finite: left out and counted (GT004)."""
    tables: tuple[Table, ...]
    """Of detections, then of tracks."""

    def content(self) -> dict[str, object]:
        """Return it as plain data, for JSON."""
        rows = asdict(self)
        for table in rows["tables"]:
            for side in ("truth", "estimates"):
                table[side] = [{("class" if k == "class_" else k): v for k, v in row.items()} for row in table[side]]
        return {("class" if key == "class_" else key): value for key, value in rows.items()}
