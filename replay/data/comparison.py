"""Results of a comparison of two runs or suites: numbers with verdicts, changes of objects, and the JSON schema."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, TypeAlias

FORMAT = 1
Verdict: TypeAlias = Literal[
    "identical", "improved", "same", "REGRESSED", "INCONCLUSIVE", "changed", "gone", "new", "null"
]
"""`identical`: outputs of equal digests. `changed`: of a number that is neither good nor bad. `gone`, `new`, `null`:
only base, only head, or not both have a value."""
State: TypeAlias = Literal["identical", "passed", "inconclusive", "failed"]


@dataclass(frozen=True)
class Row:
    """A number of base and head, with its verdict, of one pipeline under one condition."""

    pipeline: str
    condition: str
    metric: str
    class_: str
    slice: str
    matching: str
    unit: str
    base: float | None
    head: float | None
    delta: float | None  # `head - base`, where both have a value
    verdict: Verdict
    gate: str  # The rule that it must keep; empty: it only informs
    reason: str  # Why this verdict
    low: float | None = None  # 95 % interval of `delta`
    high: float | None = None
    smallest: float | None = None  # Smallest difference that this much data would show with 90 %
    p: float | None = None  # Adjusted for all that is judged together
    num_units: int = 0  # Stretches or scenes that were resampled
    better: Literal["higher", "lower", "neither"] = "higher"

    @property
    def primary(self) -> bool:
        """Whether it gates."""
        return bool(self.gate)

    @property
    def values(self) -> str:
        """Both values, for people: `0.395 -> 0.369`."""
        return " -> ".join("none" if value is None else f"{value:.4g}" for value in (self.base, self.head))

    @property
    def name(self) -> str:
        """What it is about, in one line."""
        parts = (self.metric, self.class_, *([self.slice] if self.slice != "all" else []), self.matching)
        where = (self.pipeline, *([self.condition] if self.condition != "clear" else []))
        return f"{' '.join(where)}: {', '.join(parts)}" if self.pipeline else ", ".join(parts)


@dataclass(frozen=True)
class ObjectChange:
    """An object or false alarm that only base or only head has, over some frames; or a switch of identity."""

    kind: Literal["LOST", "FOUND", "NEW FALSE ALARM", "NEW SWITCH"]
    cell: str
    label: str
    track_id: int | None
    from_s: float  # Since the first frame
    to_s: float
    frames: tuple[int, int]  # First and last
    num_frames: int
    range_m: float | None  # Mean, in the ground plane
    why: str
    xy_m: tuple[float, float] | None = None  # Where it is in the first of the frames, in body coordinates
    weight: float | None = None  # Without labels: how much it matters, in frames of a near object

    def __str__(self) -> str:
        name = f"{self.label or 'object'}{'' if self.track_id is None else f' #{self.track_id}'}"
        when = f"{self.from_s:.1f}-{self.to_s:.1f} s" if self.to_s > self.from_s else f"{self.from_s:.1f} s"
        where = "" if self.range_m is None else f" at {self.range_m:.0f} m"
        return f"{self.kind} {name} {when}{where}: {self.why}"


@dataclass(frozen=True)
class Divergence:
    """Where the outputs of two runs differ first."""

    cell: str
    frame: int
    time_s: float  # Since the first frame
    stage: str
    what: str
    num_frames: int  # That differ

    def __str__(self) -> str:
        return f"frame {self.frame} ({self.time_s:.1f} s), {self.stage}: {self.what}; {self.num_frames} frames differ"


@dataclass(frozen=True)
class WorstFrame:
    """A frame with more errors than before."""

    cell: str
    frame: int
    time_s: float
    base_errors: int  # Misses and false alarms of detections
    head_errors: int

    def __str__(self) -> str:
        return f"frame {self.frame} ({self.time_s:.1f} s): {self.base_errors} -> {self.head_errors} errors"


@dataclass(frozen=True)
class ComparedCell:
    """A cell that both sides have."""

    name: str  # As changes in it name it
    pipeline: str
    condition: str


@dataclass(frozen=True)
class Comparison:
    """A whole comparison; in each list the most important comes first."""

    rows: tuple[Row, ...]
    tolerance: float
    state: State
    failures: tuple[str, ...] = ()  # Budgets that were exceeded, and cells without a run
    notes: tuple[str, ...] = ()  # What else differs
    divergences: tuple[Divergence, ...] = ()
    objects: tuple[ObjectChange, ...] = ()
    worst: tuple[WorstFrame, ...] = ()
    without_labels: bool = False  # The base stands for truth: nothing is better or worse, only changed
    cells: tuple[ComparedCell, ...] = ()

    def changes_of(self, row: Row) -> tuple[tuple[Divergence, ...], tuple[ObjectChange, ...]]:
        """Return first differences and changes of objects in the cells whose number a row is."""
        own = {cell.name for cell in self.cells if (cell.pipeline, cell.condition) == (row.pipeline, row.condition)}
        return tuple(d for d in self.divergences if d.cell in own), tuple(o for o in self.objects if o.cell in own)

    @property
    def places(self) -> Mapping[str, str]:
        """What stands before a change in a cell, for people: `CELL: `; nothing where all are of one cell."""
        found: list[ObjectChange | Divergence | WorstFrame] = [*self.objects, *self.divergences, *self.worst]
        cells = sorted({item.cell for item in found})
        return {cell: f"{cell}: " if len(cells) > 1 else "" for cell in cells}

    @property
    def is_worse(self) -> bool:
        """Whether the gate fails."""
        return self.state == "failed"

    @property
    def gating(self) -> tuple[Row, ...]:
        """Rows that decide, failing ones first."""
        rank = {"REGRESSED": 0, "gone": 0, "null": 1, "INCONCLUSIVE": 2}
        return tuple(sorted((row for row in self.rows if row.gate), key=lambda row: rank.get(row.verdict, 3)))

    @property
    def headline(self) -> str:
        """The verdict in one line."""
        if self.state == "identical":
            return "identical: all outputs have equal digests"
        bad = [row for row in self.gating if row.verdict in ("REGRESSED", "gone")]
        if self.state == "failed" and bad:
            more = f" and {len(bad) - 1} more" if len(bad) > 1 else ""
            return f"REGRESSED: {bad[0].name}{more}"
        if self.state == "failed":
            return f"FAILED: {self.failures[0] if self.failures else 'inconclusive, which the policy fails'}"
        open_ = [row for row in self.gating if row.verdict == "INCONCLUSIVE"]
        others = sum(row.verdict == "REGRESSED" and not row.gate for row in self.rows)
        more = f"; {others} without a gate REGRESSED" if others else ""
        if self.state == "inconclusive":
            return f"INCONCLUSIVE: {len(open_)} of {len(self.gating)} gating numbers need more data{more}"
        if self.without_labels:
            return "changed, which is neither better nor worse without labels"
        return f"no regression of what gates{more}" if others else "no regression"

    def content(self) -> dict[str, Any]:
        """Return it as plain data for JSON: equal comparisons give equal bytes."""
        rows = [
            {("class" if k == "class_" else k): v for k, v in asdict(row).items()} | {"primary": row.primary}
            for row in self.rows
        ]
        found = asdict(self) | {"rows": rows}
        return {"format": FORMAT, "regressed": self.is_worse, "headline": self.headline, **found}


def schema() -> Mapping[str, Any]:
    """Return the JSON schema of `Comparison.content`."""
    from pydantic import TypeAdapter

    found = TypeAdapter(Comparison).json_schema(mode="serialization")
    row = found["$defs"]["Row"]
    row["properties"] = {("class" if k == "class_" else k): v for k, v in row["properties"].items()}
    row["properties"]["primary"] = {"type": "boolean"}
    row["required"] = [("class" if k == "class_" else k) for k in row["required"]]
    head = {"format": {"const": FORMAT}, "regressed": {"type": "boolean"}, "headline": {"type": "string"}}
    found["properties"] = {**head, **found["properties"]}
    found["required"] = [*head, *found["required"]]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "fbench compare --json", **found}
