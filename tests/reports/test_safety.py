"""Names from logs are untrusted: they are shown, and never act."""

import base64
import hashlib
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.reports.chromium import Chromium
from tests.reports.conftest import LATENCY, Page, Plan, boxes2d, boxes3d, score

from fbench.replay.data.comparison import ComparedCell, Comparison, Divergence, ObjectChange, Row, WorstFrame
from fbench.replay.data.details import Details, FrameErrors, ObjectTrack, ScoreCurve, Span
from fbench.replay.runs.folder import Run
from fbench.reports.html.comparison import Links, write_comparison

MakeRun = Callable[[Plan], Run]
Write = Callable[..., Page]

HOSTILE = "</script><img src=x onerror=alert(1)>'\"&{{ 7*7 }}${1}\u2028\u2029\x1b[31m\u202e" + "x" * 300
SHOWN = "</script><img src=x onerror=alert(1)>'\"&{{ 7*7 }}${1}\\u2028\\u2029\\x1b[31m\\u202e" + "x" * 300


def hostile_plan(name: str = "run") -> Plan:
    stage = {**LATENCY["stages"][0], "stage": HOSTILE}
    return Plan(
        name=name, log=HOSTILE, pipeline=HOSTILE, label=HOSTILE[:60], missing={HOSTILE: HOSTILE}, failed=HOSTILE,
        complete=False, faults={"DEC001": HOSTILE}, parameters={HOSTILE: {HOSTILE: HOSTILE}},
        latency={**LATENCY, "stages": [stage], "excluded": HOSTILE, "percentile_method": HOSTILE},
        details=Details(
            (ScoreCurve(HOSTILE, HOSTILE, (0.5,), (1.0,), (0.5,), (0.7,)),),
            (ObjectTrack(HOSTILE, 1, HOSTILE, 2, 1, 0, 0, 3.0, (Span(0, 0, None), Span(1, 1, 7))),),
            FrameErrors((0, 1), (0, 1), (0, 0), (1, 0)),
        ),
        scores=[
            score("f1", None, HOSTILE, class_=HOSTILE, matching=HOSTILE, counts={HOSTILE: 1}),
            score(HOSTILE, 1.0, unit=HOSTILE),
        ],
    )  # fmt: skip


@pytest.fixture
def page(make_run: MakeRun, report: Write) -> Page:
    run = make_run(hostile_plan())
    (run.folder / "host.json").write_text('{"cpu": "</script><img src=x onerror=alert(1)>"}')
    return report(run)


def test_hostile_names_make_no_elements(page: Page, make_run: MakeRun, report: Write) -> None:
    plan = Plan(
        name="plain", failed="no", missing={"a": "b"}, complete=False, faults={"DEC001": "x"}, details=Details()
    )
    plain = report(make_run(plan))
    assert "img" not in page.tags
    assert page.tags.count("script") == plain.tags.count("script") == 5
    assert not [name for name, _ in page.attributes if name.startswith("on")]


def test_hostile_names_are_shown(page: Page) -> None:
    assert page.text.count(SHOWN) >= 10


def test_hostile_names_reach_the_scripts_as_data(page: Page) -> None:
    run = page.data["runs"][0]
    assert run["label"] == SHOWN
    assert run["timeline"]["missing"] == [[1, SHOWN, SHOWN]]
    assert run["timeline"]["failed"] == [[2, SHOWN]]
    assert page.frames()[0]["tracks"][0]["label"].startswith("</script><img src=x onerror=alert(1)>'\"&{{ 7*7 }}")


def test_no_invisible_characters_are_in_the_file(page: Page) -> None:
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]", page.html)


@pytest.mark.parametrize("boxes", [boxes2d, boxes3d])
def test_hostile_runs_side_by_side(make_run: MakeRun, report: Write, boxes: Callable[..., object]) -> None:
    page = report(make_run(hostile_plan("a")), make_run(hostile_plan("b")))
    assert "img" not in page.tags
    assert [run["label"] for run in page.data["runs"]] == ["a", "b"]


def digest_of(content: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()}'"


def test_page_allows_no_request(page: Page) -> None:
    policy = next(value for name, value in page.attributes if name == "content" and value and "default-src" in value)
    script, style = (page.html.partition(f"<{tag}>")[2].partition(f"</{tag}>")[0] for tag in ("script", "style"))
    assert policy == (
        f"default-src 'none'; style-src {digest_of(style)}; script-src {digest_of(script)}; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    targets = [value or "" for name, value in page.attributes if name in ("src", "href", "action", "srcset", "data")]
    assert all(target.startswith(("#", "data:")) for target in targets)
    assert "url(" not in page.html
    assert "@import" not in page.html


def test_scripts_write_text_only(page: Page) -> None:
    script = page.html.rpartition("<script>")[2]
    assert not re.search(
        r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b|new Function|fetch\(", script
    )


def test_hostile_comparison(make_run: MakeRun, tmp_path: Path, chromium: Chromium) -> None:
    names = {"pipeline": HOSTILE, "condition": HOSTILE}
    numbers = dict.fromkeys(("metric", "class_", "slice", "matching", "unit", "gate", "reason"), HOSTILE)
    row = Row(**names, **numbers, base=0.5, head=0.25, delta=-0.25, verdict="REGRESSED")
    times = {"from_s": 0.0, "to_s": 1.0, "frames": (0, 1), "num_frames": 2, "range_m": None}
    changed = ObjectChange("LOST", HOSTILE, HOSTILE, 1, **times, why=HOSTILE)
    found = Comparison(
        (row,), 0.0, "failed", (HOSTILE,), (HOSTILE,), (Divergence(HOSTILE, 0, 0.0, HOSTILE, HOSTILE, 1),), (changed,),
        (WorstFrame(HOSTILE, 0, 0.0, 1, 2),), cells=(ComparedCell(HOSTILE, HOSTILE, HOSTILE),),
    )  # fmt: skip
    out, strange = tmp_path / "comparison.html", tmp_path / 'a b"><img src=x>.html'
    runs = (make_run(hostile_plan("a")), make_run(hostile_plan("b")))
    write_comparison(found, {HOSTILE: runs}, (HOSTILE, HOSTILE), Links(strange, None), out)
    page = Page(out.read_text("utf-8"))
    assert "img" not in page.tags
    assert page.text.count(SHOWN) >= 12
    assert ("href", "a%20b%22%3E%3Cimg%20src%3Dx%3E.html") in page.attributes
    tab = chromium.tab()
    tab.open(out)
    assert not tab.run("document.images.length")
    assert (tab.console, tab.asked) == ([], [])
