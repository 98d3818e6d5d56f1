"""Critical errors where people see them: in the run folder and at the head of the report."""

from pathlib import Path

from tests.metrics.criticality.test_criticality import OPTIONS, drive

from fbench.api.scores import score_folder
from fbench.replay.data.criticality import load_critical_errors
from fbench.reports.html.page import page


def test_scoring_writes_them_and_the_report_begins_with_them(tmp_path: Path) -> None:
    run = drive(tmp_path / "run")
    assert load_critical_errors(run.folder) is None
    assert "Critical errors" not in page([run])
    scored = score_folder(run.folder, OPTIONS)
    errors = load_critical_errors(run.folder)
    assert errors is not None
    assert len(errors) == 4
    assert {row.metric: row.value for row in scored.scores if row.class_ == "vehicle"}["critical_misses"] == 3
    html = page([scored])
    assert html.index("<h2>Critical errors</h2>") < html.index("<h2>Frames</h2>")
    assert "car #1" in html
    assert "0.5-0.7 s, frame 5-7" in html
