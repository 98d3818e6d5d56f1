"""Latency as the page shows it: stages on top of each other, percentiles, and the host. None of it is deterministic."""

from collections.abc import Sequence
from typing import Any

from fbench.replay.runs.folder import Run
from fbench.reports.html import records
from fbench.reports.html.records import number, read_record

_BUDGET_SHARE, _P95_SHARE = 0.85, 0.7
"""Where budget and largest 95th percentile lie at most on the scale; what is slower than its end is cut off."""


def latency_panels(runs: Sequence[Run], labels: Sequence[str]) -> list[dict[str, Any]]:
    """Gather latency and host of every run: `label`, `table`, `host`, `scale_ms`, and in percent of that scale, which
    is common to all, the `budget` and for each stage a bar; `cut` where the slowest frame lies beyond the scale.
    """
    tables = [read_record(run, "latency.json", records.LatencyTable) for run in runs]
    ends = [table.budget_ms / _BUDGET_SHARE for table in tables if table]
    ends += [(stage.p95_ms or 0.0) / _P95_SHARE for table in tables if table for stage in table.stages]
    scale = max(ends, default=1.0) or 1.0

    def at(value_ms: float | None) -> float:
        return round(min(100.0, 100.0 * (value_ms or 0.0) / scale), 2)

    panels = []
    for run, label, table in zip(runs, labels, tables, strict=True):
        bars = []
        for stage in table.stages if table else ():
            places = {name: at(getattr(stage, f"{name}_ms")) for name in ("p50", "p95", "p99", "max")}
            bars.append({"stage": stage, "cut": (stage.max_ms or 0.0) > scale, **places})
        facts, host = [], read_record(run, "host.json", records.Host)
        for name, value in host.root.items() if host else ():
            if value is None:  # unknown here; an energy has its reason beside it
                continue
            unit = " s" if name.endswith("_s") else ""
            facts.append((name.removesuffix("_s"), number(value, 2) + unit if isinstance(value, float) else str(value)))
        panel = {"label": label, "table": table, "host": facts, "bars": bars, "scale_ms": scale}
        panels.append({**panel, "budget": at(table.budget_ms) if table else 0.0})
    return panels


STAGE_COLORS = 8


def latency_stacks(runs: Sequence[Run], labels: Sequence[str]) -> dict[str, Any] | None:
    """Return mean times of stages on top of each other, as `rows` with `parts`, places in percent of one scale that
    also holds the `budgets`; `None` where no run was timed.
    """
    tables = [read_record(run, "latency.json", records.LatencyTable) for run in runs]
    timed = [(label, table) for label, table in zip(labels, tables, strict=True) if table and table.frames]
    if not timed:
        return None
    names = list(dict.fromkeys(s.stage for _, table in timed for s in table.stages if s.stage != "total"))
    means = [{s.stage: s.mean_ms or 0.0 for s in table.stages} for _, table in timed]
    totals = [own.get("total", sum(own.values())) for own in means]
    budgets = list(dict.fromkeys(table.budget_ms for _, table in timed))
    ends = [sum(ms for name, ms in own.items() if name != "total") for own in means]  # parallel stages may sum to more
    scale = max(*totals, *ends, *budgets, 1e-9) * 1.06
    rows = []
    for (label, table), own, total in zip(timed, means, totals, strict=True):
        parts, start = [], 0.0
        for color, name in enumerate(names):
            if ms := own.get(name, 0.0):
                place = {"x": round(100 * start / scale, 2), "width": round(100 * ms / scale, 2)}
                parts.append({**place, "color": color % STAGE_COLORS, "text": f"{name} {number(ms, 1)} ms"})
                start += ms
        rest = total - start
        if rest > 0.005 * total:
            place = {"x": round(100 * start / scale, 2), "width": round(100 * rest / scale, 2)}
            parts.append({**place, "color": "rest", "text": f"between stages {number(rest, 1)} ms"})
        late = f"{table.over_budget} of {table.frames}" if table.over_budget else ""
        rows.append({"label": label, "parts": parts, "total": number(total, 1), "late": late})
    return {
        "stages": [(name, color % STAGE_COLORS) for color, name in enumerate(names)],
        "rows": rows,
        "budgets": [(round(100 * ms / scale, 2), ms) for ms in budgets],
        "scale": scale,
    }


def frame_times(run: Run) -> list[float | None]:
    """Wall time of each frame [ms], `None` where it was dropped; empty where it wasn't measured for every other."""
    total = run.frame_times.get("total", {})
    if any(frame.index not in total for frame in run.frames if not frame.is_dropped):
        return []
    return [total[frame.index] / 1e6 if frame.index in total else None for frame in run.frames]
