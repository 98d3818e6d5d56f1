"""Latency as tables and bars. Measured on the host's clock, so it differs from run to run."""

from collections.abc import Sequence
from dataclasses import dataclass

from fbench.replay.store import Run
from fbench.reports.html.records import Host, LatencyTable, Stage, read_record
from fbench.reports.html.text import number

_BUDGET_SHARE, _P95_SHARE = 0.85, 0.7
"""Where budget and largest 95th percentile lie at most on the scale; what is slower than its end is cut off."""


@dataclass(frozen=True)
class Bar:
    """One stage on the common scale, positions in percent of its width."""

    stage: Stage
    p50: float
    p95: float
    p99: float
    max: float
    cut: bool
    """The slowest frame lies beyond the scale."""


@dataclass(frozen=True)
class LatencyPanel:
    """The latency of one run."""

    label: str
    table: LatencyTable | None
    host: Sequence[tuple[str, str]]
    bars: Sequence[Bar]
    budget: float
    """Position of the budget in percent."""
    scale_ms: float


def latency_panels(runs: Sequence[Run], labels: Sequence[str]) -> list[LatencyPanel]:
    """Gather latency and host of every run; all bars share one scale."""
    tables = [read_record(run, "latency.json", LatencyTable) for run in runs]
    ends = [end for table in tables if table for end in _ends(table)]
    scale = max(ends, default=1.0) or 1.0
    return [
        _panel(label, table, read_record(run, "host.json", Host), scale)
        for run, label, table in zip(runs, labels, tables, strict=True)
    ]


def _ends(table: LatencyTable) -> list[float]:
    return [table.budget_ms / _BUDGET_SHARE, *((s.p95_ms or 0.0) / _P95_SHARE for s in table.stages)]


def _panel(label: str, table: LatencyTable | None, host: Host | None, scale: float) -> LatencyPanel:
    bars = [_bar(stage, scale) for stage in table.stages] if table else []
    facts = [(name.removesuffix("_s"), _fact(name, value)) for name, value in host.root.items()] if host else []
    budget = min(100.0, 100.0 * table.budget_ms / scale) if table else 0.0
    return LatencyPanel(label, table, facts, bars, round(budget, 2), scale)


def _bar(stage: Stage, scale: float) -> Bar:
    def at(value: float | None) -> float:
        return round(min(100.0, 100.0 * (value or 0.0) / scale), 2)

    cut = (stage.max_ms or 0.0) > scale
    return Bar(stage, at(stage.p50_ms), at(stage.p95_ms), at(stage.p99_ms), at(stage.max_ms), cut)


def _fact(name: str, value: str | float | bool | None) -> str:
    if isinstance(value, float):
        return number(value, 2) + (" s" if name.endswith("_s") else "")
    return str(value)
