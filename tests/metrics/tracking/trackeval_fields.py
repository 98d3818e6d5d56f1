"""Rows beside TrackEval's fields."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from fbench.metrics.profiles.trackeval.fields import LABELS
from fbench.replay.data.scores import Score

# Where TrackEval prints a conventional number for what is undefined, a row is null: with no truth, the first; with no
# results, the second; with no match, the third; without any of them, or without truth tracks, the others.
UNDEFINED = {
    "mota", "moda", "motal", "smota", "clr_re", "idr", "detre", "owta",
    "clr_pr", "idp", "detpr",
    "motp", "assa", "assre", "asspr", "loca", "loca_0", "hotaloca_0",
    "clr_f1", "idf1", "deta", "hota", "hota_0", "mtr", "ptr", "mlr", "fp_per_frame",
}  # fmt: skip

Key = tuple[str, str, str]


def table(rows: list[Score]) -> dict[Key, Score]:
    """Rows by metric, class and slice; no two have the same."""
    found = {(row.metric, row.class_, row.slice): row for row in rows}
    assert len(found) == len(rows)
    return found


def expected(class_: str, part: str, fields: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[Key, float]]:
    """What TrackEval says, by the key of the row."""
    for of_metric in fields.values():
        for field, value in of_metric.items():
            metric = field.lower().replace("(0)", "_0")
            yield (metric, class_, part), float(np.mean(value))
            for label, one in zip(LABELS, value, strict=True) if np.ndim(value) else ():
                yield (metric, class_, f"alpha {label}" if part == "all" else f"{part}, alpha {label}"), float(one)


def compare(found: dict[Key, Score], key: Key, value: float) -> None:
    """Counts are equal, floats within 1e-9, and what is null is a convention that the reason states."""
    row = found.pop(key)
    if row.value is None:
        assert key[0] in UNDEFINED, key
        assert "TrackEval prints" in row.reason, row
        assert value in (0, 1) or f"{value:g} for sums" in row.reason, (key, value, row.reason)
        return
    whole = float(value).is_integer() and float(row.value).is_integer()
    assert (row.value == value) if whole else abs(row.value - value) < 1e-9 * max(1, abs(value)), (key, value, row)
