"""The matrix of a suite, on small runs with scores counted by hand."""

import pytest
from tests.metrics.conftest import Case, boxes3d

from fbench.metrics.core.bootstrap import Bootstrap
from fbench.metrics.robustness.matrix import Cell, Matrix, count_pieces, matrix_tables, severity_curves
from fbench.metrics.runs.combine import score_run
from fbench.metrics.runs.detection import Detection
from fbench.metrics.runs.tracking import Tracking
from fbench.replay.data.scores import ScoreOptions, save_scores

OPTIONS = ScoreOptions()
TRUTH = boxes3d((10, 0), label="car", ids=[1])
HIT = boxes3d((10, 0), label="car", score=[0.9], ids=[1])
MISS = boxes3d()


@pytest.fixture
def cell(make_run):
    """Make a cell of one frame a segment, found or missed."""

    def make(pattern, pipeline="lidar3d", condition="clear", severity="", log="a"):
        cases = [Case(HIT if found else MISS, TRUTH, segment=i) for i, found in enumerate(pattern)]
        run = make_run(*cases, num_segments=len(cases))
        save_scores(run.folder / "scores.json", score_run(run, OPTIONS, [Detection(), Tracking()]))
        return Cell(pipeline, condition, severity, log, run)

    return make


def figures(table, name):
    line = next(line for line in table.lines if line.name == name)
    return {column.name: figure for column, figure in zip(table.columns, line.figures, strict=True)}


def test_pieces_are_segments(cell):
    counts = count_pieces(cell([1, 0, 1, 1, 1, 0]).run, OPTIONS)
    assert list(counts.values()) == [
        (1, 0, 0, 1, 0, 0, 0) if hit else (0, 0, 1, 0, 0, 1, 0) for hit in (1, 0, 1, 1, 1, 0)
    ]


def test_changes_by_hand(cell):
    cells = [
        cell([1] * 6), cell([1, 1, 1, 0, 0, 0], condition="fog", severity="1"),
        cell([1, 0, 0, 0, 0, 0], condition="fog", severity="2"),
    ]  # fmt: skip
    matrix = Matrix(cells, OPTIONS, Bootstrap(num=200))
    change, aggregates, f1, by_severity, mota = matrix_tables(matrix)
    # F1 = 2 TP / (2 TP + FN): 6/9 and 2/7
    (curves,) = severity_curves(matrix)
    assert (curves.title, curves.steps) == ("fog", ("clear", "1", "2"))
    assert [f.value for f in curves.lines[0].figures] == pytest.approx([1, 6 / 9, 2 / 7])
    assert all(f.low <= f.value <= f.high for f in curves.lines[0].figures)
    assert figures(f1, "fog 1")["lidar3d"].value == pytest.approx(6 / 9)
    assert figures(by_severity, "fog 2")["lidar3d"].value == pytest.approx(2 / 7 - 1)
    assert figures(change, "lidar3d")["fog"].value == pytest.approx((6 / 9 + 2 / 7) / 2 - 1)
    assert figures(mota, "fog 1")["lidar3d"].value == pytest.approx(-0.5)
    own = figures(aggregates, "lidar3d")
    assert own["mPC"].value == own["mRR"].value == pytest.approx((6 / 9 + 2 / 7) / 2)
    assert own["mCE"].value is None
    assert own["mCE"].reason == "no baseline"


def test_intervals_hold_the_value_and_are_paired(cell):
    cells = [
        cell([1, 0] * 4), cell([1, 0] * 4, condition="fog", severity="1"),
        cell([1, 0, 0, 0] * 2, condition="rain", severity="1"),
    ]  # fmt: skip
    table = matrix_tables(Matrix(cells, OPTIONS, Bootstrap(num=500)))[3]
    same, worse = (figures(table, name)["lidar3d"] for name in ("fog 1", "rain 1"))
    assert (same.value, same.low, same.high) == (0, 0, 0)  # the same segments are drawn on both sides
    assert worse.low < worse.value < worse.high <= 0


def test_a_baseline_against_itself(cell):
    cells = [cell([1] * 5 + [0]), cell([1, 0, 0, 0, 0, 0], condition="fog", severity="1")]
    own = figures(matrix_tables(Matrix(cells, OPTIONS, Bootstrap(num=50)), "lidar3d")[1], "lidar3d")
    assert own["mCE"].value == own["relative mCE"].value == pytest.approx(1)
    assert own["mRRA"].value == pytest.approx(0)


def test_short_runs_have_no_intervals_and_say_so(cell):
    matrix = Matrix([cell([1, 1]), cell([1, 0], condition="fog", severity="1")], OPTIONS, Bootstrap(num=50))
    change = matrix_tables(matrix)[0]
    assert figures(change, "lidar3d")["fog"].low is None
    assert "No intervals" in change.notes[1]


def test_a_cell_without_a_run_is_null_with_a_reason(cell):
    cells = [
        cell([1] * 6), cell([1] * 6, condition="fog", severity="1"), cell([1] * 6, pipeline="radar3d"),
    ]  # fmt: skip
    change = matrix_tables(Matrix(cells, OPTIONS, Bootstrap(num=50)))[0]
    figure = figures(change, "radar3d")["fog"]
    assert figure.value is None
    assert figure.reason == "none in fog: no run"


def test_a_cell_that_failed_has_its_reason_and_spoils_what_it_is_part_of(cell):
    """Defect 8: a condition that fails is scored as clear weather; nor is what is left of it compared with all logs."""
    cells = [
        cell([1] * 6), cell([0] * 6, log="b"), cell([1] * 6, condition="fog", severity="1"),
        Cell("lidar3d", "fog", "1", "b", None, "ValueError: no"), Cell("lidar3d", "rain", "1", "a", None, "crashed"),
        cell([1] * 6, condition="rain", severity="1", log="b"),
    ]  # fmt: skip
    change, aggregates, f1, by_severity, _ = matrix_tables(Matrix(cells, OPTIONS, Bootstrap(num=50)))
    for table, name, column in ((f1, "fog 1", "lidar3d"), (f1, "rain 1", "lidar3d"), (by_severity, "fog 1", "lidar3d"),
                                (change, "lidar3d", "fog"), (aggregates, "lidar3d", "mRR")):  # fmt: skip
        figure = figures(table, name)[column]
        assert (figure.value, figure.low, figure.high) == (None, None, None)
    assert figures(f1, "fog 1")["lidar3d"].reason == "failed on b: ValueError: no"
    assert figures(by_severity, "rain 1")["lidar3d"].reason == "none in rain: failed on a: crashed"


def test_a_condition_that_does_not_fit_all_logs_is_compared_on_those_it_fits(cell):
    """Such as one of cameras, where one of two logs has none; on the other, nothing is ever found."""
    cells = [
        cell([1] * 6), cell([0] * 6, log="b"), cell([1] * 3 + [0] * 3, condition="fog", severity="1"),
        cell([0] * 6, condition="fog", severity="1", log="b"), cell([1] * 6, condition="camera.jpeg", severity="1"),
    ]  # fmt: skip
    change, aggregates, _, by_severity, _ = matrix_tables(Matrix(cells, OPTIONS, Bootstrap(num=200)))
    same = figures(by_severity, "camera.jpeg 1")["lidar3d"]
    assert (same.value, same.low, same.high) == (0, 0, 0)
    assert figures(change, "lidar3d")["fog"].value == pytest.approx((6 / 15) / (12 / 18) - 1)  # 2 TP / (2 TP + FN)
    assert "Of F1 over fog, severities 1;" in aggregates.notes[0]


def test_logs_are_pooled_by_counts(cell):
    cells = [
        cell([1] * 6), cell([1] * 2, log="b"), cell([0] * 6, condition="fog", severity="1"),
        cell([1] * 2, condition="fog", severity="1", log="b"),
    ]  # fmt: skip
    table = matrix_tables(Matrix(cells, OPTIONS, Bootstrap(num=50)))[2]
    assert figures(table, "fog 1")["lidar3d"].value == pytest.approx(4 / (4 + 6))
