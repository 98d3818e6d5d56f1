"""Outcomes of boxes in a run folder."""

from pathlib import Path

import pyarrow as pa
import pytest

from fbench.replay.contracts.errors import RunError
from fbench.replay.runs.outcomes import FILE, load_outcomes, save_outcomes
from fbench.replay.runs.tables import write_table

OUTCOMES = {
    "truth_2d": {(10, "left"): "missed", (2, "right"): "hit", (2, "left"): "ignored"},
    "detections": {(0, ""): "false alarm"},
    "tracks": {},
}


def test_round_trip_with_equal_bytes(tmp_path: Path) -> None:
    assert load_outcomes(tmp_path) == {}
    save_outcomes(tmp_path, OUTCOMES)
    first = (tmp_path / FILE).read_bytes()
    assert load_outcomes(tmp_path) == {name: rows for name, rows in OUTCOMES.items() if rows}
    save_outcomes(tmp_path, {name: dict(reversed(rows.items())) for name, rows in reversed(OUTCOMES.items())})
    assert (tmp_path / FILE).read_bytes() == first
    save_outcomes(tmp_path, {})
    assert load_outcomes(tmp_path) == {}
    assert [path.name for path in tmp_path.iterdir()] == [FILE]


@pytest.mark.parametrize("columns", [{}, {"table": pa.array(["truth"]), "row": pa.array([1])}])
def test_other_tables_are_refused(tmp_path: Path, columns: dict[str, pa.Array]) -> None:
    write_table(tmp_path / FILE, columns)
    with pytest.raises(RunError, match="not a table of outcomes"):
        load_outcomes(tmp_path)


def test_damage_is_reported(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"PAR1 no")
    with pytest.raises(RunError, match="can't be read"):
        load_outcomes(tmp_path)
