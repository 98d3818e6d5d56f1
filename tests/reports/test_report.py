"""What stands in a report."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from tests.reports.conftest import LATENCY, Page, Plan, boxes2d, score

from fbench.replay.contracts.entry_points import load
from fbench.replay.contracts.errors import ConfigError, RunError
from fbench.replay.contracts.faults import FAULTS
from fbench.replay.runs.folder import Run
from fbench.replay.runs.manifest import ConditionEntry
from fbench.reports.html import HtmlReport

MakeRun = Callable[[Plan], Run]
Write = Callable[..., Page]


def test_report_comes_in_by_its_entry_point() -> None:
    assert load("reports", "html") is HtmlReport


def test_head_says_what_ran(make_run: MakeRun, report: Write) -> None:
    text = report(make_run(Plan())).text
    assert "Pipeline late3d Frames 4 Segments 2 With truth 4 of 4 Failed 0" in text
    assert "Log digest aabbccddeeff Run digest 998877665544 fbench 0.1.0" in text


def test_scores_are_shown_with_matching_unit_and_counts(make_run: MakeRun, report: Write) -> None:
    text = report(make_run(Plan())).text
    assert "vehicle matched by bev 2 m F1 0.857 tp 6 · fp 1 · fn 1" in text
    assert "MOTP 0.250 m" in text
    assert "ID switches 3" in text
    assert "vehicle matched by iou 0.5 F1 0.500" in text
    assert "f1 pedestrian all bev 2 m 0.250" in text
    assert "coverage vehicle all 0.750" in text


def test_slices_stand_in_one_table_a_metric(make_run: MakeRun, report: Write) -> None:
    near = [replace(score(m, v), slice="range 0-10 m") for m, v in (("f1", 0.5), ("precision", 0.4), ("recall", 0.6))]
    seen = [replace(score("recall", 0.7), slice="visibility 80-100 %")]
    nothing = [replace(score("recall", None, "no truth boxes"), slice="range 30-50 m")]
    text = report(make_run(Plan(scores=[score("f1", 0.5), *near, *nothing, *seen]))).text
    assert "F1 late3d class vehicle 0.500 range 0-10 m 0.500 Recall late3d" in text
    assert "Recall late3d range 0-10 m 0.600 visibility 80-100 % 0.700 Precision late3d range 0-10 m 0.400" in text


def test_slices_of_several_runs_stand_side_by_side_and_missing_ones_are_empty(make_run: MakeRun, report: Write) -> None:
    rows = [score("f1", 0.5), replace(score("recall", 0.6), slice="range 0-10 m")]
    page = report(make_run(Plan(scores=rows)), make_run(Plan(name="b", pipeline="lidar3d", scores=rows[:1])))
    assert "Recall late3d lidar3d range 0-10 m 0.600 In each run’s own space" in page.text


def test_classes_of_a_run_are_those_of_its_own_space(make_run: MakeRun, report: Write) -> None:
    """A 3D run is scored in images, too; what a 2D run has in images isn't to be compared with that."""
    flat = Plan(name="b", pipeline="camera2d", scores=[score("f1", 0.75, matching="iou 0.5")])
    solid = Plan(scores=[score("f1", 0.5), score("f1", 0.25, matching="iou 0.5")])
    assert "F1 camera2d late3d class vehicle 0.750 0.500" in report(make_run(flat), make_run(solid)).text


def test_null_score_is_a_dash_with_its_reason(make_run: MakeRun, report: Write) -> None:
    page = report(make_run(Plan()))
    assert "MOTA – truth has no track ids" in page.text
    assert "null" not in page.text


def test_board_without_values_is_one_line(make_run: MakeRun, report: Write) -> None:
    rows = [score(metric, None, "no cameras") for metric in ("f1", "precision", "mota")]
    assert "– F1, Precision, MOTA: no cameras" in report(make_run(Plan(scores=rows))).text


def test_cards_show_the_counts_of_the_value_and_the_table_all(make_run: MakeRun, report: Write) -> None:
    counts = {"tp": 6, "fp": 1, "fn": 1, "ignored": 9, "similarity_sum": -2.5}
    text = report(make_run(Plan(scores=[score("f1", 0.5, counts=counts)]))).text
    assert "F1 0.500 tp 6 · fp 1 · fn 1 Coverage" in text
    assert "0.500 tp 6 · fp 1 · fn 1 · ignored 9 · similarity_sum −2.500" in text


def test_frames_that_the_latency_table_leaves_out_are_marked(make_run: MakeRun, report: Write) -> None:
    page = report(make_run(Plan(latency={**LATENCY, "frames": 3})))
    assert json.loads(page.islands["times"])[0]["warm_up"] == 1


def test_negative_score_has_a_minus_sign(make_run: MakeRun, report: Write) -> None:
    assert "MOTA −0.500" in report(make_run(Plan(scores=[score("mota", -0.5)]))).text


def test_unscored_run_says_so(make_run: MakeRun, report: Write) -> None:
    text = report(make_run(Plan(scores=None, latency=None))).text
    assert "late3d: not scored." in text
    assert "No latency table" in text


def test_empty_scores_say_so(make_run: MakeRun, report: Write) -> None:
    assert "The list of scores is empty." in report(make_run(Plan(scores=[]))).text


def test_complete_run_has_no_banner(make_run: MakeRun, report: Write) -> None:
    page = report(make_run(Plan()))
    assert ("class", "banner bad") not in page.attributes
    assert "Data was lost" not in page.text


def test_incomplete_run_shows_what_was_lost(make_run: MakeRun, report: Write) -> None:
    faults = {"LOG004": "chunk at byte 4096", "TIM007": "gap of 5 s"}
    page = report(make_run(Plan(complete=False, faults=faults)))
    assert ("class", "banner bad") in page.attributes
    assert "Data was lost: 1 fault. The run is not complete" in page.text
    assert "1 × LOG004 damaged chunk skipped · first at chunk at byte 4096" in page.text


def test_a_log_without_checksums_is_said(make_run: MakeRun, report: Write) -> None:
    text = report(make_run(Plan(faults={"LOG006": "drive.bag: ROS 1 bags have no checksums"}))).text
    assert "The log has no checksums. Flipped bits would go unnoticed. fbench log convert writes" in text
    assert "The log has no checksums" not in report(make_run(Plan(name="sealed"))).text


def test_tolerated_loss_is_said(make_run: MakeRun, report: Write) -> None:
    text = report(make_run(Plan(faults={"DEC001": "/lidar stamp 7"}))).text
    assert "Data was lost, and tolerated: 1 fault." in text


def test_failed_frames_and_missing_truth_are_said(make_run: MakeRun, report: Write) -> None:
    text = report(make_run(Plan(truth=False, failed="ValueError: no points"))).text
    assert "The pipeline failed on 1 of 4 frames." in text
    assert "No truth." in text


def test_every_fault_code_is_shown_also_when_zero(make_run: MakeRun, report: Write) -> None:
    text = report(make_run(Plan(faults={"TIM007": "gap of 5 s"}))).text
    for code, kind in FAULTS.items():
        assert f"{code} {kind.text}" in text
    assert "TIM007 gap, new segment flagged 1 gap of 5 s" in text
    assert "DEC002 image is corrupt data lost 0" in text


def test_fault_of_another_version_is_shown(make_run: MakeRun, report: Write) -> None:
    run = make_run(Plan())
    row = '{"code": "NEW001", "behaviour": "count", "text": "something new", "count": 2, "places": ["there"]}'
    (run.folder / "faults.json").write_text(f'{{"lost": 2, "rows": [{row}]}}')
    text = report(run).text
    assert "NEW001 something new data lost 2 there" in text
    assert "DEC002 image is corrupt data lost –" in text


def test_run_without_fault_table_says_so(make_run: MakeRun, report: Write) -> None:
    run = make_run(Plan())
    (run.folder / "faults.json").unlink()
    assert "late3d: faults unknown." in report(run).text


def test_latency_is_shown_as_measured(make_run: MakeRun, report: Write) -> None:
    text = report(make_run(Plan())).text
    assert "not part of the deterministic result" in text
    assert "1 of 4 frames took longer than the budget of 100 ms (25.0 %)" in text
    assert "detect.lidar 11.5 18.5 20.2 22.0 – 22.0 12.0 9.5 31.0 4" in text
    assert "whole frame › 75.5 – 130.0 131.0 – 1 131.0 82.0 – 131.0 4" in text
    assert "cpu Example CPU" in text
    assert "wall 1.23 s" in text


def test_parameters_are_shown_by_dotted_name(make_run: MakeRun, report: Write) -> None:
    text = report(make_run(Plan())).text
    assert "lidar.cluster.eps_m 0.6" in text
    assert "timeout_ns 30000000" in text
    assert "numpy 2.4.6" in text


def test_runs_stand_side_by_side(make_run: MakeRun, report: Write) -> None:
    other = Plan(name="b", pipeline="camera2d", make_boxes=boxes2d, scores=[score("f1", 0.25)], parameters={"every": 2})
    page = report(make_run(Plan()), make_run(other))
    assert "Pipeline 3D Image F1 IDSW F1 late3d 0.857 3 0.500 camera2d 0.250" in page.text
    assert "no such score" not in page.text.replace("there is no such score", "").replace("the run has no such", "")
    assert "every 1 2" in page.text
    assert [run["label"] for run in page.data["runs"]] == ["late3d", "camera2d"]


def test_runs_of_one_pipeline_are_named_by_folder(make_run: MakeRun, report: Write) -> None:
    first = make_run(Plan(name="a"))
    page = report(first, make_run(Plan(name="b")))
    assert [run["label"] for run in page.data["runs"]] == ["a", "b"]
    assert [run["label"] for run in report(first, first).data["runs"]] == ["1: a", "2: a"]


def test_runs_of_one_pipeline_are_named_by_condition_and_mapped(make_run: MakeRun, report: Write) -> None:
    fog = ConditionEntry(name="fog", version=1, strength="3", level={})
    runs = [
        make_run(Plan(name=f"{pipeline}{len(conditions)}", pipeline=pipeline, conditions=conditions, scores=[row]))
        for pipeline, conditions, row in (
            ("late3d", [], replace(score("f1", 0.5), low=0.4, high=0.6, interval="95 %")),
            ("late3d", [fog], score("f1", 0.25)),
            ("radar3d", [], score("f1", None, "no truth boxes")),
        )
    ]  # fmt: skip
    page = report(*runs)
    assert [run["label"] for run in page.data["runs"]] == ["late3d · clear", "late3d · fog:3", "radar3d · clear"]
    assert "Pipeline Space clear fog:3 late3d 3D 50.0 (40.0 to 60.0) 25.0 The same as dots" in page.text
    assert ("class", "n h5") in page.attributes
    assert "fbench replay street -p late3d --condition fog:3" in page.text


def test_best_of_a_column_is_marked_unless_all_are_equal(make_run: MakeRun, report: Write) -> None:
    good, bad = (
        [score("f1", f1), score("idsw", switches), score("recall", 0.5)] for f1, switches in ((0.9, 1), (0.5, 2))
    )
    page = report(make_run(Plan(scores=bad)), make_run(Plan(name="b", pipeline="lidar3d", scores=good)))
    assert [value for name, value in page.attributes if name == "class" and value and "best" in value] == ["n best"] * 2


def test_long_values_are_cut(make_run: MakeRun, report: Write) -> None:
    text = report(make_run(Plan(metadata={"regions": "x" * 5000}))).text
    assert f"{'x' * 300}… (5000 characters)" in text


def test_stages_stand_on_top_of_each_other_against_the_budget(make_run: MakeRun, report: Write) -> None:
    text = report(make_run(Plan())).text
    assert "late3d detect.lidar 12.0 ms between stages 70.0 ms 82.0 1 of 4 over" in text
    assert "budget 100 ms" in text


def test_same_notice_is_shared(make_run: MakeRun, report: Write) -> None:
    text = report(make_run(Plan(name="a", truth=False)), make_run(Plan(name="b", truth=False))).text
    assert text.count("No truth.") == 1
    assert "all there is. a, b" in text


def test_different_logs_are_not_silently_compared(make_run: MakeRun, report: Write) -> None:
    text = report(make_run(Plan(name="a")), make_run(Plan(name="b", log_digest="00"))).text
    assert "These runs replayed different data." in text


def test_run_without_frames(make_run: MakeRun, report: Write) -> None:
    page = report(make_run(Plan(num_frames=0, scores=None, latency=None)))
    assert "there are no frames to look at" in page.text
    assert page.data["runs"][0]["timeline"]["detections"] == []


def test_no_runs(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"^report: no runs given"):
        HtmlReport().write([], tmp_path / "report.html")


@pytest.mark.parametrize("out", ["file/report.html", "folder"])
def test_unwritable_out(make_run: MakeRun, tmp_path: Path, out: str) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    with pytest.raises(ConfigError, match=rf"{out}: can't be written \(.+\)"):
        HtmlReport().write([make_run(Plan())], tmp_path / out)
    assert not list(tmp_path.rglob(".*partial*"))


def test_report_replaces_an_older_one_and_leaves_nothing_beside(make_run: MakeRun, tmp_path: Path) -> None:
    out = tmp_path / "out" / "report.html"
    run = make_run(Plan())
    HtmlReport().write([run], out)
    out.write_text("old")
    HtmlReport().write([run], out)
    assert out.read_text("utf-8").startswith("<!doctype html>")
    assert list(out.parent.iterdir()) == [out]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("latency.json", '{"budget_ms": 100}', r"latency\.json: frames: Field required"),
        ("latency.json", "[]", r"latency\.json: content: "),
        ("faults.json", "{", r"faults\.json: can't be read"),
        ("host.json", '{"cpu": []}', r"host\.json: cpu"),
        ("scores.json", "[1]", r"scores\.json: not a list of scores"),
    ],
)
def test_damaged_run(make_run: MakeRun, report: Write, name: str, content: str, message: str) -> None:
    run = make_run(Plan())
    (run.folder / name).write_text(content)
    with pytest.raises(RunError, match=message):
        report(run)


def test_equal_inputs_give_equal_bytes(make_run: MakeRun, tmp_path: Path) -> None:
    run = make_run(Plan(missing={"radar": "timeout"}))
    HtmlReport().write([run], tmp_path / "a.html")
    HtmlReport().write([Run(run.folder)], tmp_path / "elsewhere" / "b.html")
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "elsewhere" / "b.html").read_bytes()


def test_measured_time_stands_in_one_section(make_run: MakeRun, report: Write) -> None:
    def parts(page: Page) -> tuple[str, str, str]:
        before, _, rest = page.html.partition('<section id="timing">')
        timing, _, after = rest.partition("</section>")
        return before, timing, after

    fast = parts(report(make_run(Plan(name="a", total_ms=10.0))))
    slow = parts(report(make_run(Plan(name="b", total_ms=250.0, latency=None))))
    assert fast[0] == slow[0]
    assert fast[1] != slow[1]
    assert fast[2] == slow[2]


def test_size_stays_small_without_media(make_run: MakeRun, report: Write) -> None:
    assert len(report(make_run(Plan())).html) < 220_000


def test_ambiguous_radar_velocities_are_said(make_run: MakeRun, report: Write) -> None:
    key = "radar.velocity_period_mps"
    runs = [make_run(Plan(name=text, metadata={key: text})) for text in ("10.3936", "5", "10.39360")]
    assert "Radial velocities alias with a period of 10.39 m/s:" in report(runs[0]).text
    assert "Radial velocities alias with a period of 10.39 or 5.00 m/s:" in report(*runs).text


@pytest.mark.parametrize("text", ["", "x", "nan", "inf", "-1", "0"])
def test_periods_that_are_no_numbers_are_not_said(make_run: MakeRun, report: Write, text: str) -> None:
    assert "alias" not in report(make_run(Plan(metadata={"radar.velocity_period_mps": text}))).text
