"""Tables of a report, read back by the readers of others."""

import csv
import json
import math
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import pandas as pd
import pytest
from tests.reports.conftest import LATENCY, Plan, score
from tests.reports.test_safety import HOSTILE, SHOWN, hostile_plan

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.criticality import CriticalError, save_critical_errors
from fbench.replay.runs.folder import Run
from fbench.reports.html.page import page
from fbench.reports.tables import write_suite_tables, write_tables

MakeRun = Callable[[Plan], Run]


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_numbers_are_those_of_scores_json(make_run: MakeRun, tmp_path: Path) -> None:
    whole = replace(score("f1", 1 / 3), low=0.1, high=0.7, interval="95 % of 1000 bootstrap resamples of 5 segments")
    run = make_run(Plan(scores=[whole, score("mota", None, "truth has no track ids"), score("mota", -0.25)]))
    write_tables([run], tmp_path / "t")
    expected = json.loads((run.folder / "scores.json").read_text())
    parquet = pd.read_parquet(tmp_path / "t" / "scores.parquet").to_dict("records")
    rows = read_csv(tmp_path / "t" / "scores.csv")
    for want, typed, text in zip(expected, parquet, rows, strict=True):
        for name in ("metric", "class", "slice", "matching", "unit"):
            assert want[name] == typed[name] == text[name]
        for name in ("value", "low", "high"):
            value = want.get(name)
            assert (math.isnan(typed[name]) and text[name] == "") if value is None else typed[name] == value
            assert value is None or float(text[name]) == value
        assert json.loads(typed["counts"]) == want["counts"]
    assert rows[1]["reason"] == "truth has no track ids"


def test_every_table_is_there_in_every_form(make_run: MakeRun, tmp_path: Path) -> None:
    runs = [make_run(Plan(missing={"radar": "no message"}, failed="x")), make_run(Plan(name="b", pipeline="lidar3d"))]
    paths = write_tables(runs, tmp_path / "t")
    names = {path.relative_to(tmp_path / "t").as_posix() for path in paths}
    stable, timed = ("runs", "scores", "frames", "faults", "what_ran"), ("latency", "host")
    assert names == {
        *(f"{name}.{form}" for name in stable for form in ("csv", "parquet")), "tables.md", "timing/tables.md",
        *(f"timing/{name}.{form}" for name in timed for form in ("csv", "parquet")),
    }  # fmt: skip
    assert all(path.is_file() for path in paths)
    for name in stable:
        typed = pd.read_parquet(tmp_path / "t" / f"{name}.parquet")
        assert list(typed.columns) == list(read_csv(tmp_path / "t" / f"{name}.csv")[0])
        assert set(typed["run"]) <= {"late3d", "lidar3d"}
    frames = pd.read_parquet(tmp_path / "t" / "frames.parquet")
    assert frames["detections"].tolist() == [1, 1, 0, 1, 1, 1, 1, 1]
    assert json.loads(frames["missing"][1]) == {"radar": "no message"}
    text = (tmp_path / "t" / "tables.md").read_text("utf-8")
    assert "## scores\n\n| run | metric | class |" in text
    assert "\n| late3d | f1 | vehicle | all | bev 2 m | 0.8571 |" in text
    assert "p95_ms" not in text
    assert "| late3d | total | 4 | 82.0 | 75.5 |  | 130.0 |" in (tmp_path / "t/timing/tables.md").read_text("utf-8")


def test_what_the_report_shows_of_errors_and_times_is_there(make_run: MakeRun, tmp_path: Path) -> None:
    stage = {"stage": "total", "count": 9, "p90_ms": 4.5, "p999_ms": None, "cpu_mean_ms": 3.25}
    run = make_run(Plan(latency={**LATENCY, "stages": [stage]}))
    (run.folder / "host.json").write_text('{"cpu": "Example CPU", "governor": null}')
    error = CriticalError("miss", "tracks", "car", None, 5, 0.5, 0.75, 5, 7, 3, 12.5, 2.25, 4.5, 0.125)
    save_critical_errors(run.folder, [error])
    write_tables([run], tmp_path / "t")
    (row,) = pd.read_parquet(tmp_path / "t/criticality.parquet").to_dict("records")
    assert {name: value for name, value in row.items() if name not in ("run", "track_id")} == {
        name: value for name, value in asdict(error).items() if name != "track_id"
    }
    assert pd.isna(row["track_id"])
    (times,) = read_csv(tmp_path / "t/timing/latency.csv")
    assert [times[name] for name in ("p90_ms", "p999_ms", "cpu_mean_ms")] == ["4.5", "", "3.25"]
    assert [row["value"] for row in read_csv(tmp_path / "t/timing/host.csv")] == ["Example CPU", ""]
    assert "<b>governor</b>" not in page([run])  # unknown here


def test_equal_runs_give_equal_bytes(make_run: MakeRun, tmp_path: Path) -> None:
    run = make_run(Plan())
    for name in ("a", "b"):
        write_tables([run], tmp_path / name)
    first = sorted((tmp_path / "a").rglob("*.*"))
    assert len(first) > 10
    for path in first:
        assert path.read_bytes() == (tmp_path / "b" / path.relative_to(tmp_path / "a")).read_bytes()


@pytest.mark.parametrize(
    "text", ["=cmd|' /C calc'!A0", "+1", "-1+1", "@SUM(A1)", "  =1", "\t=1", "\r=1", "＝1", "|x", "%0"]
)
def test_formulas_are_text_in_csv(make_run: MakeRun, tmp_path: Path, text: str) -> None:
    run = make_run(Plan(pipeline=text, scores=[score(text, -0.5)]))
    write_tables([run], tmp_path / "t")
    for path in (tmp_path / "t").rglob("*.csv"):
        for row in read_csv(path):
            for cell in row.values():
                head = cell.lstrip()[:1]
                assert head not in tuple("=+@|%＝\t\r") and (head != "-" or float(cell) < 0), (path.name, cell)  # noqa: PT018
    assert read_csv(tmp_path / "t" / "scores.csv")[0]["value"] == "-0.5"


def test_hostile_text_is_shown_and_does_nothing(make_run: MakeRun, tmp_path: Path) -> None:
    plan = hostile_plan()
    plan = replace(plan, parameters={**plan.parameters, "note": f"a\n# b|c\r![x](http://x/y.png){HOSTILE}"})
    write_tables([make_run(plan)], tmp_path / "t")
    for path in (tmp_path / "t").rglob("*.*"):
        if path.suffix in (".csv", ".md"):
            text = path.read_bytes().decode("utf-8")
            assert all(character.isprintable() or character == "\n" for character in text), path.name
    rows = read_csv(tmp_path / "t" / "runs.csv")
    assert rows[0]["pipeline"] == SHOWN
    assert [len(read_csv(tmp_path / "t" / f"{name}.csv")) for name in ("runs", "scores", "frames")] == [1, 2, 4]
    markdown = (tmp_path / "t" / "tables.md").read_text("utf-8")
    assert "<" not in markdown
    assert "![" not in markdown.replace("\\[", "")
    for line in markdown.splitlines():
        assert not line or line.startswith(("| ", "## "))
    widths = {
        len(line.replace("\\|", "").split("|"))
        for line in markdown.partition("## scores")[2].partition("##")[0].splitlines()
        if line
    }
    assert widths == {14}


def test_tables_of_a_suite(tmp_path: Path) -> None:
    rows = [{"name": "fog 3", "space": "", "column": "late3d", "value": 0.5, "reason": None, "published": None,
             "counts": {"tp": 3}, "low": 0.25, "high": 0.75},
            {"name": "=x", "space": "3D", "column": "late3d", "value": None, "reason": "no run", "published": 0.1,
             "counts": {}}]  # fmt: skip
    (tmp_path / "results.json").write_text(json.dumps({"tables": {"robustness_f1": rows, "../evil/name": rows}}))
    paths = write_suite_tables(tmp_path / "results.json", tmp_path / "t")
    assert all(path.resolve().is_relative_to(tmp_path / "t") for path in paths)
    first, second = read_csv(tmp_path / "t" / "robustness_f1.csv")
    assert (first["value"], first["low"], json.loads(first["counts"])) == ("0.5", "0.25", {"tp": 3})
    assert (second["name"], second["value"], second["reason"], second["published"]) == ("'=x", "", "no run", "0.1")


@pytest.mark.parametrize("content", ["{", "[]", '{"tables": 1}', '{"tables": {"a": [{"value": "x"}]}}'])
def test_results_that_are_none_are_an_error(tmp_path: Path, content: str) -> None:
    (tmp_path / "results.json").write_text(content)
    with pytest.raises(ConfigError, match="not the results of a suite"):
        write_suite_tables(tmp_path / "results.json", tmp_path / "t")
