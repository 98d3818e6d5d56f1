"""What CI servers read: JUnit XML, comments, annotations, and numbers for dashboards."""

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.comparison import (
    ComparedCell,
    Comparison,
    Divergence,
    ObjectChange,
    Row,
    State,
    Verdict,
    schema,
)
from fbench.reports.ci import FORMATS, check_link, parse_target, write_comparison

ROOT = Path(__file__).resolve().parents[2]
ALLOWED = {
    "testsuites": ({"name", "time", "tests", "failures", "errors"}, {"testsuite"}, set()),
    "testsuite": (
        {"name", "tests", "failures", "errors", "group", "time", "skipped", "timestamp", "hostname", "id", "package"},
        {"testsuite", "properties", "testcase", "system-out", "system-err"},
        {"name", "tests", "failures", "errors"},
    ),
    "testcase": (
        {"name", "time", "classname", "group"},
        {"skipped", "error", "failure", "system-out", "system-err"},
        {"name"},
    ),
    "failure": ({"type", "message"}, set(), set()),
    "skipped": ({"type", "message"}, set(), set()),
}  # fmt: skip
"""Attributes, children and required attributes, as in the schema of Jenkins' xUnit plug-in (junit-10.xsd)."""


def row(verdict: Verdict = "same", metric: str = "f1", gate: str = "statistical, tolerance 0.01") -> Row:
    names = ("late3d", "clear", metric, "vehicle", "all", "bev 2 m, within 50 m", "1")
    return Row(*names, 0.8, 0.7, -0.1, verdict, gate, "p = 0.001 after correction", -0.15, -0.05, 0.04, 0.001, 20)


def found(state: State, *rows: Row, failures: tuple[str, ...] = ()) -> Comparison:
    lost = ObjectChange(
        "LOST", "log through late3d", "car", 17, 41.2, 42.9, (412, 429), 18, 38.0, "no lidar (never came)"
    )
    first = Divergence("log through late3d", 412, 41.2, "lidar", "its result differs", 18)
    cells = (ComparedCell("log through late3d", "late3d", "clear"),)
    return Comparison(rows, 0.0, state, failures, (), (first,), (lost,), cells=cells)


FAILED = found("failed", row("REGRESSED"), row("INCONCLUSIVE", "mota"), row("improved", "idf1", ""))


def require_valid(element: ElementTree.Element) -> None:
    attributes, children, required = ALLOWED[element.tag]
    assert set(element.attrib) <= attributes
    assert required <= set(element.attrib)
    for child in element:
        assert child.tag in children
        require_valid(child)


@pytest.mark.parametrize(
    ("comparison", "tests", "failures", "skipped"),
    [
        (FAILED, 3, 1, 1),
        (found("passed", row()), 2, 0, 0),
        (found("inconclusive", row("INCONCLUSIVE")), 2, 0, 1),
        (found("failed", row("INCONCLUSIVE")), 2, 1, 0),  # the policy fails what is inconclusive
        (found("failed", row(), failures=("2 faults LOG001, 1 may be",)), 2, 1, 0),
    ],
)
def test_junit_counts_and_is_valid(comparison: Comparison, tests: int, failures: int, skipped: int) -> None:
    root = ElementTree.fromstring(FORMATS["junit"](comparison))  # noqa: S314  # our own
    require_valid(root)
    assert (root.get("tests"), root.get("failures")) == (str(tests), str(failures))
    assert len(root.findall(".//testcase")) == tests
    assert len(root.findall(".//failure")) == failures
    assert len(root.findall(".//skipped")) == skipped


def test_junit_holds_any_text() -> None:
    odd = replace(row("REGRESSED"), pipeline='<&"\x00\x1b', slice="]]>")
    require_valid(ElementTree.fromstring(FORMATS["junit"](found("failed", odd))))  # noqa: S314  # our own


def test_a_comment_is_written_only_where_something_changed(tmp_path: Path) -> None:
    file = tmp_path / "comment.md"
    write_comparison(FAILED, "markdown", file)
    text = file.read_text(encoding="utf-8")
    assert "| ❌ | late3d: f1, vehicle, bev 2 m, within 50 m | 0.800 | 0.700 | -0.100 |" in text
    assert "LOST car \u0023\u200b17 41.2-42.9 s at 38 m: no lidar (never came)" in text
    assert "[" in text.split("```")[1]
    write_comparison(found("identical", row("identical")), "markdown", file)
    assert not file.exists()


def test_a_comment_leads_to_its_job(tmp_path: Path) -> None:
    file = tmp_path / "comment.md"
    write_comparison(FAILED, "markdown", file, "https://ci.example/jobs/17?tab=files")
    last = file.read_text(encoding="utf-8").splitlines()[-1]
    assert last.startswith("[Report and files of this run](https://ci.example/jobs/17?tab=files) · [How to read")
    write_comparison(FAILED, "junit", tmp_path / "gate.xml", "https://ci.example/jobs/17")
    assert "ci.example" not in (tmp_path / "gate.xml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "text", ["javascript:alert(1)", "https://a b", "https://a.b/)[x](c", "https://a/\n", "//a", "x"]
)
def test_an_address_is_a_plain_one(text: str) -> None:
    with pytest.raises(ConfigError, match="--link"):
        check_link(text)


def test_of_several_cells_changes_and_intervals_say_whose_they_are() -> None:
    lost = replace(FAILED.objects[0], cell="other through late3d")
    foggy = "log through late3d (fog:3)"
    cells = [ComparedCell(name, "late3d", "fog:3" if name == foggy else "clear") for name in (lost.cell, foggy)]
    rows = (*FAILED.rows, replace(FAILED.rows[0], condition="fog:3"))
    gone = replace(lost, cell=foggy, track_id=18)
    two = replace(FAILED, rows=rows, objects=(lost, gone), divergences=(), cells=(*FAILED.cells, *cells))
    text = FORMATS["markdown"](two)
    assert "- other through late3d: LOST car" in text
    assert "f1 vehicle all, late3d fog:3" in text.split("```")[1]
    root = ElementTree.fromstring(FORMATS["junit"](two))  # noqa: S314  # our own
    failed = [case for case in root.iter("testcase") if case.find("failure") is not None]
    said = {case.get("classname"): case.findtext("failure", "").splitlines()[2:] for case in failed}
    why = "at 38 m: no lidar (never came)"
    assert said["late3d (clear)"] == [f"other through late3d: LOST car #17 41.2-42.9 s {why}"]
    assert said["late3d (fog:3)"] == [f"{foggy}: LOST car #18 41.2-42.9 s {why}"]
    assert any("::other through late3d: LOST" in line for line in write_comparison(two, "github", Path("/dev/null")))


def test_markup_in_names_stays_text() -> None:
    text = FORMATS["markdown"](found("failed", replace(row("REGRESSED"), pipeline="a|b<img>@all")))
    assert "a\\|b\\<img\\>@\u200ball" in text


def test_github_gets_annotations_and_a_summary_is_appended(tmp_path: Path) -> None:
    file = tmp_path / "summary.md"
    file.write_text("before\n", encoding="utf-8")
    lines = write_comparison(FAILED, "github", file)
    assert lines[0].startswith("::error title=fbench%3A f1 REGRESSED::late3d: f1, vehicle")
    assert lines[1].startswith("::warning ")
    assert file.read_text(encoding="utf-8").startswith("before\n### fbench: REGRESSED")
    odd = replace(row("REGRESSED"), reason="100 %\n::error::x")
    assert "\n" not in write_comparison(found("failed", odd), "github", file)[0]


def test_numbers_for_dashboards() -> None:
    name = "late3d/clear/vehicle/all/bev 2 m, within 50 m"
    bencher = json.loads(FORMATS["bmf"](FAILED))
    assert bencher[name]["f1"]["value"] == 0.7
    assert bencher[name]["f1"]["lower_value"] == pytest.approx(0.65)
    names = [entry["name"] for entry in json.loads(FORMATS["benchmark-json"](FAILED))]
    assert names == [f"{name}/{metric}" for metric in ("f1", "mota", "idf1")]
    assert 'fbench_f1{pipeline="late3d",condition="clear",class="vehicle"' in FORMATS["gitlab"](FAILED)


def test_json_follows_the_published_schema() -> None:
    published = json.loads((ROOT / "docs/compare.schema.json").read_text(encoding="utf-8"))
    assert published == json.loads(json.dumps(schema()))
    content = json.loads(FORMATS["json"](FAILED))
    assert set(published["required"]) <= set(content) <= set(published["properties"])
    properties = published["$defs"]["Row"]["properties"]
    assert all(set(entry) == set(properties) for entry in content["rows"])


@pytest.mark.parametrize(
    ("text", "said"), [("junit", "FORMAT=FILE"), ("junti=x", "did you mean 'junit'"), ("json=/", "is a folder")]
)
def test_broken_targets_are_refused(text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        parse_target(text)
