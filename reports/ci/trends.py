"""Numbers of the head for dashboards that follow them over time: Bencher, and github-action-benchmark."""

import json

from fbench.replay.data.comparison import Comparison, Row


def metric_format(comparison: Comparison) -> str:
    """Return Bencher Metric Format: a benchmark for each class and slice, a measure for each metric. The ends are those
    of the interval of the change, around the head's number.
    """
    found: dict[str, dict[str, dict[str, float]]] = {}
    for row in comparison.rows:
        if row.head is not None:
            value = {"value": row.head}
            if row.low is not None and row.high is not None and row.delta is not None:
                half = max(row.delta - row.low, row.high - row.delta, 0.0)
                value |= {"lower_value": row.head - half, "upper_value": row.head + half}
            found.setdefault(_benchmark(row), {})[row.metric] = value
    return json.dumps(found, indent=1) + "\n"


def _benchmark(row: Row) -> str:
    return f"{row.pipeline}/{row.condition}/{row.class_}/{row.slice}/{row.matching}"


def benchmark_json(comparison: Comparison) -> str:
    """Return what github-action-benchmark takes as `customBiggerIsBetter`: numbers of which more is better."""
    rows = [row for row in comparison.rows if row.head is not None and row.better == "higher"]
    entries = [
        {"name": f"{_benchmark(row)}/{row.metric}", "unit": row.unit, "value": row.head, "extra": row.verdict}
        for row in rows
    ]
    return json.dumps(entries, indent=1) + "\n"
